"""Scenes with tilted, rolled, distorted and hidden targets against rays refracted and cut with
planes one by one, here.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import qmc

from flflab.image.accuracy import TOLERANCE
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.scatter import Scatter
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, Sensor, Substrate, microlens_centres, pixel_positions
from flflab.targets import Bars, Black, Edge, FourDot, Picture, White

pytestmark = pytest.mark.ci

Array = npt.NDArray[np.float64]

SCATTER = 5e-4  # of the rays
SAMPLES: Array = qmc.Sobol(4, rng=3).random(2**15)
PICTURE = Picture(np.random.default_rng(0).random((60, 80)), 20.0)


def met(plane: Plane, coefficient: float, on_lens: Array, slope: Array) -> Array:
    """Where straight rays cut a plane in space, in coordinates turned back from it by Rodrigues'
    formula.
    """
    if math.isinf(plane.distance):
        return -slope * (1 + coefficient * np.sum(slope**2, axis=1))[:, None]
    flat = on_lens - plane.distance * slope
    flat = flat * (1 + coefficient * np.sum((flat / plane.distance) ** 2, axis=1))[:, None]
    start = np.column_stack([on_lens, np.zeros(len(flat))])
    way = np.column_stack([flat - on_lens, np.full(len(flat), -plane.distance)])
    normal = np.array([*plane.tilt, 1.0])
    centre = np.array([*plane.offset, -plane.distance])
    place = start + (((centre - start) @ normal) / (way @ normal))[:, None] * way - centre
    normal /= np.linalg.norm(normal)
    axis = np.cross([0.0, 0.0, 1.0], normal)
    sin, cos = np.linalg.norm(axis), normal[2]
    axis = axis / sin if sin else axis

    def leant(flat_axis: Array) -> Array:
        return (
            flat_axis * cos
            + np.cross(axis, flat_axis) * sin
            + axis * (axis @ flat_axis) * (1 - cos)
        )

    x = np.array([math.cos(plane.roll), math.sin(plane.roll), 0.0])
    y = np.array([-math.sin(plane.roll), math.cos(plane.roll), 0.0])
    return np.stack([place @ leant(x), place @ leant(y)], axis=1)


def by_rays(scene: Scene, pixels: npt.NDArray[np.int64]) -> Array:
    """Light of pixels (column, row) in units of the white level."""
    camera = scene.camera
    focal, radius = camera.array.focal_lengths[0], camera.array.aperture / 2
    centres = microlens_centres(camera.array)
    rise = centres @ np.array(camera.array.tilt)
    lengths, gaps = camera.optical_distance + rise, camera.optical_gap - rise
    errors = np.zeros((len(centres), 3))
    if scene.scatter:
        errors = np.random.Generator(np.random.Philox(key=scene.scatter.seed)).standard_normal(
            (len(centres), 3)
        )
        errors = errors * [
            scene.scatter.focal_length,
            scene.scatter.position,
            scene.scatter.position,
        ]
    disc = np.sqrt(SAMPLES[:, 2:3]) * np.stack(
        [np.cos(2 * np.pi * SAMPLES[:, 3]), np.sin(2 * np.pi * SAMPLES[:, 3])], axis=1
    )
    coefficient = scene.distortion.coefficient if scene.distortion else 0.0

    def light(
        lens: int,
        focal_length: float,
        centre: Array,
        sensor: Array,
        planes: tuple[Plane, ...],
        falloff: bool,
    ) -> float:
        on_array = centre + radius * disc
        behind = (sensor - on_array) / gaps[lens]
        between = behind + (on_array - centre) / focal_length
        on_lens = on_array - lengths[lens] * between
        slope = between + on_lens / camera.main_lens.focal_length
        left = (np.hypot(*on_lens.T) <= camera.main_lens.aperture / 2) * 1.0
        total = np.zeros(len(left))
        for plane in planes:
            place = met(plane, coefficient, on_lens, slope)
            on = np.all(np.abs(place) <= np.array(plane.size or (math.inf, math.inf)) / 2, axis=1)
            total += left * on * plane.target.radiance(place[:, 0], place[:, 1])
            left = left * ~on
        return (
            float(np.mean(total / (1 + np.sum(behind**2, axis=1)) ** 2 if falloff else total))
            / gaps[lens] ** 2
        )

    scale = 1 + gaps / lengths
    middle = int(np.argmin(np.hypot(*centres.T).round(9)))
    white = light(
        middle,
        focal,
        centres[middle],
        centres[middle] * scale[middle],
        (Plane(White(), 500.0),),
        False,
    )
    moved = centres + errors[:, 1:]
    xs, ys = pixel_positions(camera.sensor)
    image = np.zeros(len(pixels))
    for index, (column, row) in enumerate(pixels):
        place = np.array([xs[column], ys[row]])
        sensor = place + (SAMPLES[:, :2] - 0.5) * camera.sensor.pixel
        for lens in np.flatnonzero(np.hypot(*(moved * scale[:, None] - place).T) < 0.35):
            image[index] += (
                light(
                    int(lens),
                    focal * (1 + errors[lens, 0]),
                    moved[lens],
                    sensor,
                    scene.planes,
                    scene.falloff is not None,
                )
                / white
            )
    return image


@pytest.fixture(scope="module")
def small(camera: Camera) -> Camera:
    return replace(
        camera,
        array=replace(camera.array, count=(5, 5)),
        sensor=Sensor((130, 100), 0.00166, 61.15, (0.1, 0.05)),
    )


def scene_named(name: str, camera: Camera) -> Scene:
    far = replace(camera, sensor=replace(camera.sensor, distance=60.6))
    on_array = 1 / (1 / 50 - 1 / 60)  # the target's image lies on the array: W = 0
    turned = replace(
        camera, array=replace(camera.array, roll=0.2, tilt=(0.01, -0.02), offset=(0.05, 0.02))
    )
    plate = replace(
        camera,
        array=replace(camera.array, substrate=Substrate(0.4, 1.5)),
        sensor=replace(camera.sensor, distance=60.9),
    )
    return {
        "roll": Scene(camera, (Plane(Bars(), 500.0, (0.3, 0.2), roll=0.3),)),
        "roll of dots": Scene(
            camera, (Plane(FourDot(1.0, 2.0), 500.0, roll=0.3),), falloff=Falloff()
        ),
        "distortion": Scene(camera, (Plane(Bars(), 500.0),), distortion=Distortion(2.0)),
        "distortion at infinity": Scene(
            far, (Plane(Edge(0.1), math.inf),), distortion=Distortion(-2.0)
        ),
        "distortion on the array": Scene(
            camera, (Plane(FourDot(3.0, 3.5), on_array, (1.75, 1.75)),), distortion=Distortion(1.0)
        ),
        "tilt": Scene(camera, (Plane(PICTURE, 506.7, (1.0, 2.0), 0.4, (0.3, -0.2)),)),
        "tilt and distortion": Scene(
            camera,
            (Plane(FourDot(1.0, 2.0), 500.0, roll=0.4, tilt=(-0.4, 0.2)),),
            distortion=Distortion(-1.5),
        ),
        "turned array": Scene(
            turned, (Plane(Bars(), 500.0, tilt=(0.0, 0.3)),), distortion=Distortion(0.5)
        ),
        "substrate": Scene(plate, (Plane(Bars(), 500.0),)),
        "scatter": Scene(camera, (Plane(Bars(), 500.0),), scatter=Scatter(0.02, 0.005, seed=4)),
        "card": Scene(
            camera, (Plane(White(), 480.0, (1.5, 0.3), size=(3.0, 4.0)), Plane(Bars(), 506.7))
        ),
        "card through the axis": Scene(
            camera, (Plane(White(), 460.0, (4.0, 0.0), size=(8.0, 8.0)), Plane(PICTURE, 500.0))
        ),
        "card just in front": Scene(
            camera, (Plane(White(), 499.99, (0.5, 1.0), size=(2.0, 1.5)), Plane(Bars(), 500.0))
        ),
        "card before infinity": Scene(
            far, (Plane(Black(), 480.0, (1.5, 0.3), size=(3.0, 4.0)), Plane(Edge(0.1), math.inf))
        ),
        "tilted card": Scene(
            camera,
            (Plane(PICTURE, 506.0, (1.5, 0.3), 0.2, (0.2, 0.1), (3.0, 4.0)), Plane(Edge(), 506.7)),
            falloff=Falloff(),
            distortion=Distortion(-1.0),
        ),
        "two cards": Scene(
            camera,
            (
                Plane(Black(), 450.0, (0.5, 1.0), roll=0.3, size=(1.0, 4.0)),
                Plane(White(), 490.0, (1.5, 0.3), size=(3.0, 4.0)),
                Plane(Bars(), 506.7),
            ),
        ),
    }[name]


NAMES = (
    "roll",
    "roll of dots",
    "distortion",
    "distortion at infinity",
    "distortion on the array",
    "tilt",
    "tilt and distortion",
    "turned array",
    "substrate",
    "scatter",
    "card",
    "card through the axis",
    "card just in front",
    "card before infinity",
    "tilted card",
    "two cards",
)


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_is_pictured_as_rays_draw_it(
    small: Camera, name: str, allowed: Callable[..., float]
) -> None:
    """Over random lit pixels; each is within ten times the tolerance in closed forms."""
    scene = scene_named(name, small)
    image = render(scene)
    places = np.argwhere(image > 0)
    chosen = places[np.random.default_rng(11).integers(0, len(places), 30)]
    apart = image[chosen[:, 0], chosen[:, 1]] - by_rays(scene, chosen[:, ::-1])
    most = allowed(scene)
    assert image.max() > 0.2
    assert np.sqrt(np.mean(apart**2)) < most + SCATTER
    assert most > TOLERANCE or np.abs(apart).max() < 10 * TOLERANCE

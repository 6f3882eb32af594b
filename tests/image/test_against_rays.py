"""The picture against rays refracted one by one, which share no formula with it."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.diffraction import Diffraction
from flflab.image.effects.distortion import Distortion
from flflab.image.effects.falloff import Falloff
from flflab.image.effects.motion import Motion
from flflab.image.effects.scatter import Scatter
from flflab.image.effects.stray_light import StrayLight
from flflab.image.render import render
from flflab.image.scene import Plane, Scene, one_plane
from flflab.optics.camera import Camera, Sensor, Substrate
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

FOCUS = 506.7016
TOLERANCE = 0.002
SQUARES = Picture(np.random.default_rng(0).random((60, 80)), 20.0)
TARGETS: tuple[Target, ...] = (White(), FourDot(1.0, 2.0), Bars(), Chirp(), Edge(), SQUARES)
EFFECTS: dict[str, dict[str, Any]] = {
    "fall-off": {"falloff": Falloff()},
    "distortion": {"distortion": Distortion(2.0)},
    "scatter": {"scatter": Scatter(0.02, 0.005, seed=3)},
    "stray light": {"stray_light": StrayLight(0.1)},
    "stray light and filters": {
        "stray_light": StrayLight(0.1),
        "colour_filter": ColourFilter("gbrg"),
    },
    "drift and vibration": {"motion": Motion((0.1, 0.05), (0.0, 0.08))},
}
SLOWER = pytest.mark.ci
Difference = Callable[..., float]


def cropped(camera: Camera, columns: int = 60, rows: int = 50) -> Camera:
    return replace(
        camera, sensor=replace(camera.sensor, resolution=(columns, rows), offset=(0.05, 0.03))
    )


def name_of(part: object) -> str:
    return part.kind if isinstance(part, Target) else str(part)


@pytest.mark.parametrize("target", TARGETS, ids=name_of)
@pytest.mark.parametrize(
    ("f_number", "distance"), [(4.0, FOCUS), pytest.param(2.8, 490.0, marks=SLOWER)]
)
def test_every_target_is_imaged_as_rays_draw_it(
    with_f_number: Callable[[float], Camera],
    typical_difference: Difference,
    target: Target,
    f_number: float,
    distance: float,
) -> None:
    assert typical_difference(one_plane(with_f_number(f_number), target, distance), 4) < TOLERANCE


@SLOWER
@pytest.mark.parametrize("gap", [1.02, 1.03])
def test_narrow_rims_look_through_the_part_of_the_pupil_that_they_leave(
    trace_pixels: Callable[..., Any], with_gap: Callable[[float], Camera], gap: float
) -> None:
    """An eighth and half a pixel wide, behind a blur of five pixels: no pixel is ten times the
    tolerance off.
    """
    white = render(one_plane(with_gap(gap), White(), 1000.0))
    rim = np.argwhere((white > 0.02) & (white < 0.98))[::40]
    scene = one_plane(with_gap(gap), Bars((0.15, 0.15), 70.0, 70.0), 1000.0)
    traced, _ = trace_pixels(scene, rim[:, ::-1], wanted=1e-4)
    assert len(rim) >= 10
    apart = render(scene, tolerance=1e-3)[rim[:, 0], rim[:, 1]] - traced
    assert np.abs(apart).max() < 10 * 1e-3


@pytest.mark.parametrize("target", [White(), Edge(), Chirp((3.0, 3.0), 40.0, 40.0)], ids=name_of)
def test_the_last_pixels_of_a_wide_rim_are_right_to_the_tolerance(
    trace_pixels: Callable[..., Any], with_f_number: Callable[[float], Camera], target: Target
) -> None:
    """In focus at F/16 the light of the micro-image on the axis falls to nothing as the power 3/2
    of the distance from its end.
    """
    camera = with_f_number(16.0)
    scene = one_plane(
        replace(camera, sensor=replace(camera.sensor, resolution=(101, 101))), target, FOCUS
    )
    pixels = np.array([[54, 91], [53, 92], [46, 91], [92, 50], [8, 53]])
    image = render(scene, tolerance=1e-4)[pixels[:, 1], pixels[:, 0]]
    traced, _ = trace_pixels(scene, pixels, wanted=5e-6)
    assert 0 < traced.max() < 0.02
    assert np.abs(image - traced).max() < 1e-4


@pytest.mark.ci
@pytest.mark.parametrize("target", TARGETS, ids=name_of)
@pytest.mark.parametrize(
    ("f_number", "distance"),
    [
        (1.6, FOCUS),
        (1.6, 525.0),
        (2.8, 500.0),
        (2.8, 525.0),
        (4.0, 500.0),
        (4.0, 525.0),
        (16.0, FOCUS),
        (16.0, 500.0),
    ],
)
def test_every_target_at_every_opening_in_and_out_of_focus(
    with_f_number: Callable[[float], Camera],
    typical_difference: Difference,
    target: Target,
    f_number: float,
    distance: float,
) -> None:
    """At two of three distances each."""
    assert typical_difference(one_plane(with_f_number(f_number), target, distance)) < TOLERANCE


def test_overlapping_micro_images(
    with_f_number: Callable[[float], Camera], typical_difference: Difference
) -> None:
    assert typical_difference(one_plane(with_f_number(1.6), Bars(), 525.0), 4) < TOLERANCE


@pytest.mark.parametrize("distance", [299.9, pytest.param(320.0, marks=SLOWER)])
def test_a_galilean_camera(camera: Camera, typical_difference: Difference, distance: float) -> None:
    galilean = replace(
        camera,
        array=replace(camera.array, distance=55.0),
        sensor=replace(camera.sensor, distance=55.775),
    )
    assert typical_difference(one_plane(galilean, Bars(), distance), 4) < TOLERANCE


@pytest.mark.parametrize("target", TARGETS[1:3], ids=name_of)
def test_a_hexagonal_array_with_three_focal_lengths(
    camera: Camera, typical_difference: Difference, target: Target
) -> None:
    array = replace(
        camera.array,
        layout="hexagonal",
        focal_lengths=(0.917, 0.87, 0.96),
        pattern=((0, 1, 2), (1, 2, 0)),
    )
    assert typical_difference(one_plane(replace(camera, array=array), target, FOCUS), 4) < TOLERANCE


def test_an_array_on_a_glass_plate(camera: Camera, typical_difference: Difference) -> None:
    plate = replace(camera.array, substrate=Substrate(0.1, 1.5))
    assert typical_difference(one_plane(replace(camera, array=plate), Bars(), FOCUS), 4) < TOLERANCE


def test_a_tilted_rolled_array_seen_off_the_axis_with_the_target_moved(
    camera: Camera, typical_difference: Difference
) -> None:
    array = replace(camera.array, tilt=(0.01, -0.005), roll=0.02)
    moved = replace(camera, array=array, sensor=Sensor((200, 160), 0.00166, 61.15, (2.0, 1.5)))
    assert typical_difference(one_plane(moved, Bars(), 495.0, (-15.0, -12.0)), 4) < TOLERANCE


@pytest.mark.parametrize(
    "effect",
    [
        "fall-off",
        "scatter",
        *(
            pytest.param(name, marks=SLOWER)
            for name in list(EFFECTS)
            if name not in ("fall-off", "scatter")
        ),
    ],
)
def test_every_effect_of_the_light(
    camera: Camera, typical_difference: Difference, effect: str
) -> None:
    scene = replace(one_plane(cropped(camera), Bars(), 500.0, (1.0, 0.0)), **EFFECTS[effect])
    assert typical_difference(scene, 4) < TOLERANCE


@pytest.mark.parametrize(
    "target",
    [
        *(pytest.param(target, marks=SLOWER) for target in (FourDot(1.0, 2.0), Bars((0.5, 2.0)))),
        Edge(0.3),
    ],
)
def test_a_target_rolled_and_tilted(
    camera: Camera, typical_difference: Difference, allowed: Difference, target: Target
) -> None:
    plane = Plane(target, FOCUS, (-0.5, -0.5), roll=0.4, tilt=(0.3, -0.2))
    scene = Scene(cropped(camera), (plane,))
    assert typical_difference(scene, 8) < allowed(scene)


@SLOWER
def test_a_card_hides_what_stands_behind_it(camera: Camera, typical_difference: Difference) -> None:
    near = Plane(FourDot(1.0, 2.0), 480.0, (0.5, 0.0), roll=0.2, size=(4.0, 3.0))
    assert typical_difference(Scene(cropped(camera), (near, Plane(Edge(), 530.0))), 4) < TOLERANCE


@SLOWER
@pytest.mark.parametrize("target", [Chirp((0.5, 2.0)), FourDot(1.0, 2.0), SQUARES])
def test_a_moving_target_is_black_beyond_its_own_moving_edges(
    camera: Camera, typical_difference: Difference, target: Target
) -> None:
    card = Plane(target, 490.0, (1.0, 0.5), roll=0.4, size=(2.0, 1.6))
    scene = Scene(
        cropped(camera), (card,), motion=Motion(drift=(0.04, -0.02), vibration=(0.01, 0.02))
    )
    assert typical_difference(scene, 4) < TOLERANCE


@pytest.mark.ci
def test_all_at_once(camera: Camera, typical_difference: Difference) -> None:
    near = Plane(Bars((0.5, 2.0), 6.0, 5.0), 480.0, (0.5, 0.0), 0.2, (0.2, -0.1), (4.0, 4.5))
    far = Plane(SQUARES, 530.0, (0.0, 0.5), -0.1, (-0.1, 0.2))
    small = cropped(
        replace(camera, array=replace(camera.array, tilt=(0.005, -0.01), roll=0.02)), 40, 30
    )
    scene = Scene(
        small,
        (near, far),
        falloff=Falloff(),
        distortion=Distortion(1.0),
        scatter=Scatter(0.01, 0.003, seed=1),
    )
    assert typical_difference(scene, 4, 0.005) < 0.005


def thrown(scene: Scene, place: tuple[float, float], rays: int) -> tuple[float, float]:
    """One pixel's light and its standard error by rays thrown at random through one tilted card
    before a boundless plane, by hand.
    """
    camera, rng = scene.camera, np.random.default_rng(11)
    near, far = scene.planes
    radius = camera.array.aperture / 2 * np.sqrt(rng.random(rays))
    angle = 2 * np.pi * rng.random(rays)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    sx, sy = (at + camera.sensor.pixel * (rng.random(rays) - 0.5) for at in place)
    gap, length = camera.optical_gap, camera.optical_distance
    ax, ay = (sx - x) / gap, (sy - y) / gap
    bx, by = ax + x / camera.array.focal_lengths[0], ay + y / camera.array.focal_lengths[0]
    mx, my = x - length * bx, y - length * by
    weight = (np.hypot(mx, my) <= camera.main_lens.aperture / 2) / (1 + ax**2 + ay**2) ** 2
    cx, cy = bx + mx / camera.main_lens.focal_length, by + my / camera.main_lens.focal_length
    assert scene.distortion is not None
    light, free = np.zeros(rays), np.ones(rays, dtype=bool)
    for plane in (near, far):
        ox, oy = mx - plane.distance * cx, my - plane.distance * cy
        stretch = 1 + scene.distortion.coefficient * (ox**2 + oy**2) / plane.distance**2
        dx, dy = (mx - ox * stretch) / plane.distance, (my - oy * stretch) / plane.distance
        z = (plane.distance + plane.tilt[0] * (mx - plane.offset[0])) / (
            1 + plane.tilt[0] * dx
        )  # only tilted along x, not rolled
        u, v = (
            (mx - z * dx - plane.offset[0]) * math.hypot(1, plane.tilt[0]),
            my - z * dy - plane.offset[1],
        )
        on = (
            free
            if plane.size is None
            else free & (np.abs(u) <= plane.size[0] / 2) & (np.abs(v) <= plane.size[1] / 2)
        )
        light, free = light + on * plane.target.radiance(u, v), free & ~on
    seen = (
        light
        * weight
        / min(
            1.0,
            camera.main_lens.aperture
            / camera.array.aperture
            / abs(1 + length / gap - length / 0.917),
        )
        ** 2
    )
    return float(seen.mean()), float(seen.std() / math.sqrt(rays))


@pytest.mark.parametrize(
    "place",
    [
        pytest.param((0, 30), marks=SLOWER),
        *(pytest.param(place, marks=pytest.mark.full) for place in ((20, -20), (-20, -40))),
    ],
)
def test_the_reference_is_what_single_rays_at_random_give(
    trace_pixels: Callable[..., Any], camera: Camera, place: tuple[int, int]
) -> None:
    one = replace(
        camera,
        array=replace(camera.array, count=(1, 1)),
        sensor=replace(camera.sensor, resolution=(271, 231)),
    )
    near = Plane(FourDot(1.0, 2.0), 480.0, (0.5, 0.3), tilt=(0.4, 0.0), size=(3.5, 3.0))
    scene = Scene(one, (near, Plane(Chirp(), 530.0)), falloff=Falloff(), distortion=Distortion(3.0))
    pixels = np.array([[135 + place[0], 115 + place[1]]])
    (traced,), (uncertainty,) = trace_pixels(scene, pixels, wanted=2e-4)
    expected, error = thrown(scene, (place[0] * 0.00166, place[1] * 0.00166), 1_000_000)
    assert expected > 0.01
    assert abs(traced - expected) < 4 * math.hypot(error, uncertainty)


@SLOWER
def test_the_references_uncertainty_is_honest(
    trace_pixels: Callable[..., Any], camera: Camera
) -> None:
    pixels = np.stack([np.arange(113, 161, 4), np.full(12, 105)], axis=1)
    scene = one_plane(camera, FourDot(1.0, 1.2), 500.0)
    rough, stated = trace_pixels(scene, pixels, wanted=1.0)
    fine, _ = trace_pixels(scene, pixels, wanted=2e-5)
    lit = stated > 0
    assert lit.sum() >= 4
    assert np.all(np.abs(rough - fine)[lit] < 5 * stated[lit])
    assert np.array_equal(rough[~lit], fine[~lit])


def test_what_rays_cannot_tell_is_refused(trace_pixels: Callable[..., Any], camera: Camera) -> None:
    pixels = np.array([[1, 1]])
    with pytest.raises(InputError, match="diffraction"):
        trace_pixels(replace(one_plane(camera, White(), FOCUS), diffraction=Diffraction()), pixels)
    with pytest.raises(InputError, match="mean_light"):
        trace_pixels(
            replace(one_plane(camera, White(), FOCUS), stray_light=StrayLight(0.1)), pixels
        )

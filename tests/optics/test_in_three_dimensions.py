"""Views on the sensor against rays traced in three dimensions: rolled and tilted arrays, square
apertures, both layouts, several types.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.optics.camera import Camera, microlens_types
from flflab.optics.discs import two_disc_areas
from flflab.optics.useful import in_useful, sensor_fields
from flflab.optics.views import sensor_views

Array = npt.NDArray[np.float64]
Build = Callable[..., Camera]
GRID = 81


def pupil(camera: Camera) -> Array:
    """Crossings of the main lens on a grid that holds its centre, shape (K, 2); neighbours in
    memory are rays, which is quick.
    """
    steps = np.linspace(-0.5, 0.5, GRID) * camera.main_lens.aperture
    points = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    inside = np.hypot(*points.T) <= camera.main_lens.aperture / 2 * (1 + 1e-12)
    return np.asfortranarray(points if camera.aperture_shape == "square" else points[inside])


def centres_and_depths(camera: Camera) -> tuple[Array, Array]:
    """Microlens centres laid out, rolled and tilted by hand: (x, y) of shape (N, 2), distance from
    the main lens (N,).
    """
    array = camera.array
    places = []
    for row in range(array.count[1]):
        for column in range(array.count[0]):
            shift = 0.5 * (row % 2) if array.layout == "hexagonal" else 0.0
            places.append(
                [
                    (column - shift) * array.pitch[0],
                    row * array.pitch[1] * (np.sqrt(0.75) if array.layout == "hexagonal" else 1.0),
                ]
            )
    centre = np.array(places)
    centre -= (centre.min(axis=0) + centre.max(axis=0)) / 2
    turn = np.array(
        [[np.cos(array.roll), np.sin(array.roll)], [-np.sin(array.roll), np.cos(array.roll)]]
    )
    centre = centre @ turn
    return centre, array.distance + centre @ np.array(array.tilt)


def illumination(camera: Camera, offset: Array, depth: float, focal: float) -> Array:
    """Relative illumination at ``offset`` (K, 2) from a micro-image's centre: common area of the
    two stops' shadows.
    """
    gap = camera.sensor.distance - depth
    lens = camera.main_lens.aperture * gap / depth
    small = camera.array.aperture * abs(1 + gap / depth - gap / focal)
    if camera.aperture_shape == "square":
        common = np.clip((lens + small) / 2 - np.abs(offset), 0, min(lens, small)) / min(
            lens, small
        )
        return np.asarray(common[:, 0] * common[:, 1])
    return two_disc_areas(lens / 2, small / 2, np.hypot(*offset.T)) / (
        np.pi * min(lens, small) ** 2 / 4
    )


def count_by_rays(camera: Camera, distance: float, point: Array) -> tuple[int, int, int]:
    """(total, bright, chief) by refraction of rays at thin lenses, one microlens after another; no
    overlap is assumed.
    """
    centres, depths = centres_and_depths(camera)
    kinds = microlens_types(camera.array)
    low, high = (
        sign * np.array(camera.sensor.resolution) * camera.sensor.pixel / 2 for sign in (-1, 1)
    )
    grid = pupil(camera)
    totals = brights = chiefs = 0

    def through(offset: Array) -> npt.NDArray[np.bool_]:
        extent = (
            np.abs(offset).max(axis=-1)
            if camera.aperture_shape == "square"
            else np.hypot(*np.moveaxis(offset, -1, 0))
        )
        return np.asarray(extent <= camera.array.aperture / 2 * (1 + 1e-12))

    for centre, depth, kind in zip(centres, depths.tolist(), kinds, strict=True):
        focal = camera.array.focal_lengths[int(kind)]
        gap = camera.sensor.distance - depth
        home = centre * (1 + gap / depth)
        if np.any(home < low) or np.any(home > high):
            continue

        def trace(
            m: Array, centre: Array = centre, depth: float = depth, focal: float = focal
        ) -> tuple[Array, Array]:
            slope = (m - point) / distance - m / camera.main_lens.focal_length
            q = m + slope * depth
            return q, q + (slope - (q - centre) / focal) * (camera.sensor.distance - depth)

        def useful(
            s: Array, home: Array = home, depth: float = depth, focal: float = focal
        ) -> npt.NDArray[np.bool_]:
            lit = illumination(camera, s - home, depth, focal) >= camera.useful.minimum_illumination
            return np.asarray(lit & np.all((s >= low) & (s <= high), axis=-1))

        q, s = trace(grid)
        passed = through(q - centre)
        totals += bool(np.any(useful(s[passed]))) if passed.any() else 0
        x = depth * (1 / distance - 1 / camera.main_lens.focal_length + 1 / depth)
        microlens_limits = camera.array.aperture < camera.main_lens.aperture * abs(x)
        if microlens_limits:
            # Start at the microlens: which m leads to its centre and to its rim?
            base = trace(np.zeros((1, 2)))[0]
            m = (centre - base) / x
            edge = camera.main_lens.aperture / 2
            extent = np.abs(m).max() if camera.aperture_shape == "square" else np.hypot(*m[0])
            hit = extent <= edge
            rim = m + grid * camera.array.aperture / camera.main_lens.aperture / x
            sizes = (
                np.abs(rim).max(axis=1) if camera.aperture_shape == "square" else np.hypot(*rim.T)
            )
            whole = bool(np.all(sizes <= edge * (1 + 1e-9))) and bool(np.all(useful(trace(rim)[1])))
        else:
            m = np.zeros((1, 2))
            hit = bool(through(trace(m)[0] - centre)[0])
            whole = bool(passed.all()) and bool(np.all(useful(s)))
        chiefs += bool(hit and useful(trace(m)[1])[0])
        brights += whole
    return totals, brights, chiefs


@pytest.mark.parametrize(
    "changes",
    [
        {}, {"roll": 0.3}, {"roll": 0.1, "tilt": (0.02, -0.03)}, {"tilt": (0.04, 0.0)},
        {"layout": "hexagonal"},
        {"layout": "hexagonal", "roll": -0.2, "focal_lengths": (0.917, 0.96, 0.88),
        "pattern": ((0, 1, 2), (2, 0, 1))},
        {"pitch": (0.5, 0.4)},
    ],
    ids=["plain", "rolled", "rolled and tilted", "tilted", "hexagonal", "three types", "oblong"],
)  # fmt: skip
@pytest.mark.parametrize("shape", ["round", "square"])
def test_views_on_the_sensor_agree_with_rays_in_three_dimensions(
    changes: dict[str, Any], shape: str, laboratory: Build
) -> None:
    camera = laboratory(5.6, minimum=0.3)
    camera = replace(
        camera, array=replace(camera.array, count=(9, 7), **changes),
        aperture_shape="square" if shape == "square" else "round",
        sensor=replace(camera.sensor, resolution=(2000, 1500)),
    )  # fmt: skip
    fields = sensor_fields(camera)
    assert fields.neighbours.shape[1] == 0  # at F/5.6 nothing overlaps
    rng = np.random.Generator(np.random.Philox(key=17))
    wrong = 0
    for distance in (300.5, 380.0, 480.0, 506.7, 700.0):
        for point in rng.uniform(-10, 10, (3, 2)):
            traced = count_by_rays(camera, distance, point)
            found = sensor_views(fields, 1 / distance, point / distance)
            # Footprints that reach an edge by less than the grid of rays may be told apart by
            # neither.
            wrong += abs(found.total - traced[0]) + abs(found.bright - traced[1])
            assert found.chief == traced[2], (distance, point)
    assert wrong <= 2


def test_square_apertures_overlap_as_products_of_ramps(laboratory: Build) -> None:
    camera = replace(laboratory(2.0, minimum=0.25), aperture_shape="square")
    fields = sensor_fields(camera)
    smms = fields.smms
    half = float(smms.outside_radius[0])
    edge = 0.4 * (1 + 1.15 / 60) - half
    home = fields.centre[312]
    probes = home + np.array(
        [[0, 0], [edge, 0], [edge * 1.0001, 0], [edge, edge], [0, edge * 0.999]]
    )
    assert in_useful(fields, np.full(5, 312), probes).tolist() == [True, True, False, True, True]

"""Dots out of focus whose light falls off: the area common to three discs, each ray of it counted
by cos^4, against rays.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.image.effects.falloff import Falloff
from flflab.image.flat_target import form
from flflab.image.light.dot_area import weighted_share
from flflab.image.light.strips import strip_nodes
from flflab.image.reference.pixels import trace_pixels
from flflab.image.render import render
from flflab.image.scene import Scene, one_plane
from flflab.optics.camera import Camera
from flflab.targets import FourDot

DOTS = FourDot(1.0, 1.2)


@pytest.mark.parametrize(
    ("sensor_point", "dot", "size"),
    [
        ((0.1, 0.2), (0.3, -0.5), 0.8),
        ((0.1, 0.2), (0.1, 0.0), 0.3),
        ((1.9, 0.4), (0.3, 0.9), 0.7),
        ((1.2, -1.9), (-0.2, -0.4), 3.0),
        ((2.3, 0.9), (0.9, -0.1), 0.5),
    ],
    ids=[
        "cut by the pupil",
        "within the pupil",
        "cut by both apertures",
        "around the pupil",
        "a sliver",
    ],
)
def test_the_light_of_the_common_area_is_the_sum_over_its_rays(
    sensor_point: tuple[float, float], dot: tuple[float, float], size: float
) -> None:
    slant = np.array([0.3, -0.2, 0.01, 0.15])
    at = (np.arange(4000) + 0.5) / 2000 - 1
    x, y = at, at[:, None]
    lit = (
        (np.hypot(x, y) < 1)
        & (np.hypot(x - dot[0], y - dot[1]) < size)
        & (np.hypot(x - sensor_point[0], y - sensor_point[1]) < 2)
    )
    slopes = [
        slant[axis] + slant[2] * sensor_point[axis] + slant[3] * place
        for axis, place in enumerate((x, y))
    ]
    rays = float((lit / (1 + slopes[0] ** 2 + slopes[1] ** 2) ** 2).sum() / 2000**2 / math.pi)
    to = np.array([-dot[0], -dot[1], 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    chords = np.ascontiguousarray(strip_nodes(np.array([100]))[0, :2])
    assert weighted_share(
        *sensor_point, np.array([1.0, 2.0]), to, size, slant, chords
    ) == pytest.approx(rays, abs=2e-5)


@pytest.mark.parametrize("number", [1, 2, 5])
@pytest.mark.parametrize("toward", [0.3, 5.02])
def test_few_chords_leave_what_is_said_of_them_where_a_large_dot_cuts_a_side_off_the_pupil(
    number: int, toward: float
) -> None:
    """The dot's own height reaches far beyond the pupil: chords laid over that missed the common
    area, 1.7 times as much as said.
    """
    slant, away, size = np.array([0.2, 0.2, 0.0, 0.2]), 25.0, 25.2
    dot = away * np.array([math.cos(toward), math.sin(toward)])
    at = (np.arange(4000) + 0.5) / 2000 - 1
    x, y = at, at[:, None]
    lit = (np.hypot(x, y) < 1) & (np.hypot(x - dot[0], y - dot[1]) < size)
    rays = float(
        (lit / (1 + (0.2 + 0.2 * x) ** 2 + (0.2 + 0.2 * y) ** 2) ** 2).sum() / 2000**2 / math.pi
    )
    to = np.array([-dot[0], -dot[1], 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    chords = np.ascontiguousarray(strip_nodes(np.array([number]))[0, :2])
    off = weighted_share(0.0, 0.0, np.array([1.0, 3.7]), to, size, slant, chords) - rays
    change = 4 * (math.hypot(0.2, 0.2) + 0.2) * 0.2
    assert abs(off) < 0.1 * change / number**1.5 + 2e-5


@pytest.mark.parametrize("distance", [480.0, 400.0, 299.9, 200.0])
def test_shaded_dots_out_of_focus_are_what_rays_make(
    camera: Camera, largest_difference: Callable[..., float], distance: float
) -> None:
    """299.9 mm lies next to where the main lens images a dot onto the array."""
    assert (
        largest_difference(replace(one_plane(camera, DOTS, distance), falloff=Falloff()), 6) < 0.002
    )


def test_what_a_rim_cuts_of_a_sharp_dots_cone_falls_off_as_its_rays_do(
    with_f_number: Callable[[float], Camera],
) -> None:
    """Two points a side of the pupil tell the fall-off of a whole cone, but were 1.4 tolerances off
    where a rim leaves a part of it.
    """
    camera, tolerance = with_f_number(8.0), 1e-4
    sensor = replace(camera.sensor, resolution=(60, 60), offset=(0.09, 0.03))
    scene = one_plane(
        replace(camera, array=replace(camera.array, aperture=0.2), sensor=sensor),
        FourDot(30.0, 31.0),
        506.7,
        (15.5, 15.5),
    )
    scene = replace(scene, falloff=Falloff())
    image = render(scene, tolerance=tolerance)
    rim = np.argwhere((image > 0.1) & (image < 0.9))[::60]
    traced, _ = trace_pixels(scene, rim[:, ::-1], wanted=tolerance / 20)
    assert len(rim) > 10
    assert np.abs(image[rim[:, 0], rim[:, 1]] - traced).max() < 0.3 * tolerance


@pytest.fixture
def work_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[Scene], tuple[int, int, int]]:
    """Pixels that are looked at through all microlenses, and at most so many points and chords of
    the pupil for each.
    """

    def count(scene: Scene) -> tuple[int, int, int]:
        given = list[tuple[Any, Any]]()
        with monkeypatch.context() as patched:
            patched.setattr(form, "in_bands", lambda add, windows: add((0, 0)))
            patched.setattr(
                form, "add_dots", lambda image, rows, windows, seen: given.append((windows, seen))
            )
            render(scene)
        sides = [np.maximum(windows[:, 1::2] - windows[:, ::2], 0) for windows, _ in given]
        pixels = sum(int(np.sum(side[:, 0] * side[:, 1])) for side in sides)
        return (
            pixels,
            max(int(seen.counts.max()) ** 2 for _, seen in given),
            max(seen.weighing.shape[1] for _, seen in given),
        )

    return count


@pytest.mark.parametrize("distance", [400.0, 200.0])
def test_the_fall_off_of_dots_out_of_focus_asks_for_some_chords_and_no_points_of_the_pupil(
    camera: Camera, distance: float, work_of: Callable[[Scene], tuple[int, int, int]]
) -> None:
    plain = one_plane(camera, DOTS, distance)
    shaded = work_of(replace(plain, falloff=Falloff()))
    assert shaded[:2] == (work_of(plain)[0], 0)
    assert 0 < shaded[2] < 60


def test_what_sees_no_dot_is_not_looked_at_where_each_microlens_sees_one_place(
    camera: Camera, work_of: Callable[[Scene], tuple[int, int, int]]
) -> None:
    """At 300 mm the main lens images the dots onto the array, and a microlens sees them everywhere
    or nowhere.
    """
    assert work_of(one_plane(camera, FourDot(1.0, 30.0), 300.0))[0] == 0

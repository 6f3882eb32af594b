"""Dots out of focus whose light falls off: the area common to three discs, each ray of it counted by cos^4, against rays."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flflab.image.dot_area import weighted_share
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import Scene, one_plane
from flflab.image.strips import strip_nodes
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
    ids=["cut by the pupil", "within the pupil", "cut by both apertures", "around the pupil", "a sliver"],
)
def test_the_light_of_the_common_area_is_the_sum_over_its_rays(
    sensor_point: tuple[float, float], dot: tuple[float, float], size: float
) -> None:
    slant = np.array([0.3, -0.2, 0.01, 0.15])
    at = (np.arange(4000) + 0.5) / 2000 - 1
    x, y = at, at[:, None]
    lit = (np.hypot(x, y) < 1) & (np.hypot(x - dot[0], y - dot[1]) < size) & (np.hypot(x - sensor_point[0], y - sensor_point[1]) < 2)
    slopes = [slant[axis] + slant[2] * sensor_point[axis] + slant[3] * place for axis, place in enumerate((x, y))]
    rays = float((lit / (1 + slopes[0] ** 2 + slopes[1] ** 2) ** 2).sum() / 2000**2 / math.pi)
    to = np.array([-dot[0], -dot[1], 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    chords = np.ascontiguousarray(strip_nodes(np.array([100]))[0, :2])
    assert weighted_share(*sensor_point, np.array([1.0, 2.0]), to, size, slant, chords) == pytest.approx(rays, abs=2e-5)


@pytest.mark.parametrize("distance", [480.0, 400.0, 299.9, 200.0])
def test_shaded_dots_out_of_focus_are_what_rays_make(camera: Camera, largest_difference: Callable[..., float], distance: float) -> None:
    """299.9 mm lies next to where the main lens images a dot onto the array."""
    assert largest_difference(replace(one_plane(camera, DOTS, distance), falloff=Falloff()), 6) < 0.002


@pytest.mark.parametrize("distance", [400.0, 200.0])
def test_the_fall_off_of_dots_out_of_focus_costs_a_few_times_their_light(camera: Camera, distance: float) -> None:
    plain = one_plane(camera, DOTS, distance)
    assert _seconds(replace(plain, falloff=Falloff())) < 8 * _seconds(plain)


def test_what_sees_no_dot_costs_nothing_where_each_microlens_sees_one_place(camera: Camera) -> None:
    """At 300 mm the main lens images the dots onto the array, and a microlens sees them everywhere or nowhere."""
    assert _seconds(one_plane(camera, FourDot(1.0, 30.0), 300.0)) < 3 * _seconds(one_plane(camera, FourDot(1.0, 30.0), 310.0))


def _seconds(scene: Scene) -> float:
    """Of the processor, the least of three."""
    spent = list[float]()
    for _ in range(3):
        started = time.process_time()
        render(scene)
        spent.append(time.process_time() - started)
    return min(spent)

"""Far out of focus, pictures are formed at every so many pixels, and their cost is foreseen."""

from dataclasses import replace

import numpy as np
import pytest

from flflab.image.coarse import step_of
from flflab.image.cost import predicted_seconds
from flflab.image.fast.form import add_upright
from flflab.image.path import prepare
from flflab.image.render import render
from flflab.image.scene import ALL, one_plane
from flflab.optics.camera import Camera
from flflab.targets import Bars, FourDot, Target

TOLERANCE = 5e-4


def far_behind(camera: Camera, gap: float, resolution: tuple[int, int]) -> Camera:
    """The camera with its sensor so many mm behind the array."""
    sensor = replace(camera.sensor, resolution=resolution, distance=camera.array.distance + gap)
    return replace(camera, sensor=sensor)


@pytest.mark.parametrize("target", [Bars(), FourDot(spacing=1.0)])
def test_a_wide_blur_is_formed_coarsely_within_the_tolerance(
    camera: Camera, target: Target
) -> None:
    scene = one_plane(far_behind(camera, 5.0, (120, 40)), target, 507.0)
    made = prepare(scene, TOLERANCE).made
    assert made is not None
    assert step_of(made, scene.camera.sensor.pixel, TOLERANCE) >= 3
    every_pixel = np.zeros((40, 120))
    add_upright(every_pixel, scene, made)
    lit = every_pixel > 0
    assert lit.any()
    error = (render(scene, tolerance=TOLERANCE) - every_pixel)[lit]
    assert np.sqrt(np.mean(error**2)) < TOLERANCE * max(1.0, float(every_pixel.max()))


def test_a_picture_in_focus_is_formed_pixel_by_pixel(camera: Camera) -> None:
    made = prepare(one_plane(camera, Bars(), 507.0), TOLERANCE).made
    assert made is not None
    assert step_of(made, camera.sensor.pixel, TOLERANCE) == 1


def test_no_place_of_the_sensor_stage_makes_a_frame_take_twenty_seconds(camera: Camera) -> None:
    for gap in (0.5, 1.15, 2.5, 5.0, 12.0):
        for target in (Bars(), FourDot()):
            scene = one_plane(far_behind(camera, gap, (3664, 2748)), target, 507.0)
            assert 0 < predicted_seconds(scene, TOLERANCE, ALL) < 20


def test_more_pixels_and_more_light_cost_more(camera: Camera) -> None:
    few = one_plane(far_behind(camera, 1.15, (400, 300)), Bars(), 507.0)
    many = one_plane(far_behind(camera, 1.15, (4000, 3000)), Bars(), 507.0)
    nearer = one_plane(far_behind(camera, 1.4, (4000, 3000)), Bars(), 507.0)
    costs = [predicted_seconds(scene, TOLERANCE, ALL) for scene in (few, many, nearer)]
    assert costs == sorted(costs)
    assert costs[1] > 10 * costs[0]

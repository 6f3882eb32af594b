"""The image against rays refracted one by one, which share no formula with it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flflab.optics.camera import Camera, Sensor
from flflab.targets import Bars, Chirp, Edge, FourDot, Picture, Target, White

FOCUS = 506.7016
ALLOWED = 0.002 + 0.0008  # the tolerance, and the scatter of 65536 rays a pixel
TARGETS: tuple[Target, ...] = (
    White(),
    FourDot(1.0, 2.0),
    Bars(),
    Chirp(),
    Edge(),
    Picture(np.random.default_rng(0).random((60, 80)), 20.0),
)
Difference = Callable[..., float]


def name_of(part: object) -> str:
    return part.kind if isinstance(part, Target) else str(part)


@pytest.mark.parametrize("target", TARGETS, ids=name_of)
@pytest.mark.parametrize(("f_number", "distance"), [(4.0, FOCUS), (2.8, 490.0)])
def test_every_target_is_imaged_as_rays_draw_it(
    with_f_number: Callable[[float], Camera],
    largest_difference: Difference,
    target: Target,
    f_number: float,
    distance: float,
) -> None:
    assert largest_difference(with_f_number(f_number), target, distance, count=10) < ALLOWED


@pytest.mark.ci
@pytest.mark.parametrize("target", TARGETS, ids=name_of)
@pytest.mark.parametrize("f_number", [1.6, 2.8, 4.0, 16.0])
@pytest.mark.parametrize("distance", [FOCUS, 500.0, 490.0, 525.0])
def test_every_target_at_every_opening_in_and_out_of_focus(
    with_f_number: Callable[[float], Camera],
    largest_difference: Difference,
    target: Target,
    f_number: float,
    distance: float,
) -> None:
    assert largest_difference(with_f_number(f_number), target, distance, count=40) < ALLOWED


@pytest.mark.parametrize(("f_number", "distance"), [(1.6, 525.0), (16.0, 490.0)])
def test_overlapping_and_narrow_micro_images(
    with_f_number: Callable[[float], Camera],
    largest_difference: Difference,
    f_number: float,
    distance: float,
) -> None:
    assert largest_difference(with_f_number(f_number), Bars(), distance, count=8) < ALLOWED


@pytest.mark.parametrize("distance", [299.9, 320.0])
def test_a_galilean_camera(camera: Camera, largest_difference: Difference, distance: float) -> None:
    galilean = replace(camera, array=replace(camera.array, distance=55.0), sensor=replace(camera.sensor, distance=55.775))
    assert largest_difference(galilean, Bars(), distance, count=10) < ALLOWED


@pytest.mark.parametrize("target", TARGETS[1:3], ids=name_of)
def test_a_hexagonal_array_with_three_focal_lengths(camera: Camera, largest_difference: Difference, target: Target) -> None:
    array = replace(camera.array, layout="hexagonal", focal_lengths=(0.917, 0.87, 0.96), pattern=((0, 1, 2), (1, 2, 0)))
    assert largest_difference(replace(camera, array=array), target, FOCUS, count=10) < ALLOWED


def test_a_tilted_rolled_array_seen_off_the_axis_with_the_target_moved(camera: Camera, largest_difference: Difference) -> None:
    array = replace(camera.array, tilt=(0.01, -0.005), roll=0.02)
    moved = replace(camera, array=array, sensor=Sensor((200, 160), 0.00166, 61.15, (2.0, 1.5)))
    assert largest_difference(moved, Bars(), 495.0, count=10, offset=(-15.0, -12.0)) < ALLOWED


@pytest.mark.parametrize("beyond", [1.0, 1.001, 1.01, 1.05])
def test_the_sensor_in_the_exit_pupil_and_near_it(camera: Camera, largest_difference: Difference, beyond: float) -> None:
    gap = 0.917 * 60.0 / (60.0 - 0.917) * beyond
    at_pupil = replace(camera, sensor=Sensor((260, 200), 0.00166, 60.0 + gap))
    assert largest_difference(at_pupil, White(), FOCUS, count=8) < ALLOWED
    assert largest_difference(at_pupil, Bars(), FOCUS, count=8) < ALLOWED


@pytest.mark.parametrize("target", [FourDot(1.0, 1.6), Bars()], ids=name_of)
@pytest.mark.parametrize("f_number", [4.0, 16.0])
def test_the_targets_image_on_the_array(
    with_f_number: Callable[[float], Camera],
    largest_difference: Difference,
    target: Target,
    f_number: float,
) -> None:
    assert largest_difference(with_f_number(f_number), target, 1 / (1 / 50 - 1 / 60), count=6) < ALLOWED

"""Bars that are turned: each quarter turn has closed forms of its own, and charts end."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flflab.image.choose import choose
from flflab.image.render import render
from flflab.image.scene import Plane, Scene, one_plane, without
from flflab.optics.camera import Camera
from flflab.targets import Bars, BarsAlongY

CHART = (0.5, 6.0), 3.0, 2.0  # its ends lie within the picture


@pytest.mark.parametrize("distance", [506.7, 490.0])
@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_chart_turned_by_quarter_turns_is_what_rays_say(
    camera: Camera, typical_difference: Callable[..., float], turns: int, distance: float
) -> None:
    turned = Plane(Bars(*CHART), distance, (0.1, -0.2), roll=turns * math.pi / 2)
    assert typical_difference(Scene(camera, (turned,)), tolerance=1e-3) < 1e-3


def test_bars_along_y_are_bars_with_x_and_y_exchanged(camera: Camera) -> None:
    sensor = camera.sensor
    exchanged = replace(
        camera, sensor=replace(sensor, resolution=sensor.resolution[::-1], offset=(0.0, 0.0))
    )
    camera = replace(camera, sensor=replace(sensor, offset=(0.0, 0.0)))
    along_x = render(one_plane(exchanged, Bars(*CHART), 490.0, (0.2, 0.1)))
    along_y = render(one_plane(camera, BarsAlongY(*CHART), 490.0, (0.1, 0.2)))
    assert pytest.approx(along_x, abs=1e-9) == along_y.T
    x, y = np.meshgrid(np.linspace(-2, 2, 40), np.linspace(-2, 2, 40))
    assert np.array_equal(BarsAlongY(*CHART).radiance(x, y), Bars(*CHART).radiance(y, x))


def test_a_quarter_turn_is_no_misalignment(camera: Camera) -> None:
    scene = one_plane(camera, BarsAlongY(*CHART), 506.7)
    on = {decision.name for decision in choose(scene, 1e-3).decisions if decision.on}
    assert "misalignment" not in on
    askew = replace(scene, planes=(replace(scene.planes[0], roll=math.pi / 2 + 0.05),))
    assert without(askew, frozenset({"pixel"})).planes[0].roll == pytest.approx(math.pi / 2)

"""Dots out of focus: over a pixel, the area common to the pupil, a microlens's shadow and the dot's disc."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.reference import trace_pixels
from flflab.image.render import render
from flflab.image.scene import Scene, one_plane
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

BLURS = pytest.mark.parametrize(
    ("f_number", "distance"),
    [
        pytest.param(4.0, 500.0, id="slight, in wide rims"),
        pytest.param(2.8, 520.0, id="slight, in narrow rims"),
        pytest.param(8.0, 470.0, id="as wide as a dot"),
        pytest.param(4.0, 400.0, id="wide"),
        pytest.param(1.6, 500.0, id="where micro-images overlap"),
    ],
)


@pytest.fixture
def dots(with_f_number: Callable[[float], Camera]) -> Callable[[float, float], Scene]:
    """Dots before nine microlenses, in so many pixels that circles cross and touch in them in every way."""

    def scene(f_number: float, distance: float) -> Scene:
        camera = with_f_number(f_number)
        sensor = replace(camera.sensor, resolution=(160, 160), offset=(0.1, 0.07))
        return one_plane(replace(camera, sensor=sensor, array=replace(camera.array, count=(3, 3))), FourDot(1.0, 1.5), distance)

    return scene


def in_quarters(scene: Scene) -> Array:
    """The picture as the mean of 4 x 4 pixels a quarter as wide."""
    sensor = scene.camera.sensor
    columns, rows = sensor.resolution
    finer = replace(sensor, resolution=(4 * columns, 4 * rows), pixel=sensor.pixel / 4)
    image = render(replace(scene, camera=replace(scene.camera, sensor=finer)), tolerance=1e-5)
    return image.reshape(rows, 4, columns, 4).mean(axis=(1, 3))


@BLURS
def test_every_pixel_of_a_dot_is_as_right_as_asked(dots: Callable[[float, float], Scene], f_number: float, distance: float) -> None:
    scene = dots(f_number, distance)
    truth = in_quarters(scene)
    off = [float(np.abs(render(scene, tolerance=tolerance) - truth).max()) / tolerance for tolerance in (1e-2, 1e-3, 1e-4, 1e-5)]
    print(np.round(off, 3))
    assert np.all(np.array(off) < [0.6, 0.4, 0.6, 0.25])


@BLURS
def test_where_a_pixel_is_hardest_rays_show_the_same(dots: Callable[[float, float], Scene], f_number: float, distance: float) -> None:
    scene = dots(f_number, distance)
    fine = render(scene, tolerance=1e-5)
    off = np.abs(render(scene, tolerance=1e-3) - fine)
    row, column = np.unravel_index(np.argsort(off.ravel())[-2:], off.shape)
    traced, uncertainty = trace_pixels(scene, np.stack([column, row], axis=1), wanted=1e-4)
    assert np.all(np.abs(fine[row, column] - traced) < 1e-4 + 4 * uncertainty)

"""Diffracted pictures against finer ones, where the light is sharp, lines are fine, or microlenses
are unlike.
"""

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.effects.diffraction import Diffraction
from flflab.image.render import render
from flflab.image.scene import Plane, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Edge, FourDot, Picture, Target

pytestmark = pytest.mark.ci

Array = npt.NDArray[np.float64]

FOCUS = 506.7016
GREEN = 550e-6
RIM = 0.336 * 0.234923  # mm, width of a micro-image's rim in focus


def lone(count: int, pixel: float) -> Camera:
    """The worked example with one microlens on the axis before so many pixels a side."""
    array = MicrolensArray("square", (1, 1), (0.4, 0.4), 0.336, (0.917,), 60.0)
    return Camera(MainLens(50.0, 4.0), array, Sensor((count, count), pixel, 61.15))


@pytest.mark.parametrize(
    ("f_number", "distance"), [(2.8, 420.0), (4.0, 450.0), (5.6, 1200.0), (8.0, 600.0)]
)
def test_no_pixel_of_bars_in_waves_is_farther_off_than_asked(
    f_number: float, distance: float
) -> None:
    """Against a quarter of the tolerance, everywhere: with too few radii and samples up to five
    times as far, on few pixels.
    """
    camera = Camera(
        MainLens(50.0, f_number),
        MicrolensArray("square", (3, 3), (0.4, 0.4), 0.336, (0.917,), 60.0),
        Sensor((360, 300), 0.00166, 61.15),
    )
    scene = Scene(camera, (Plane(Bars(), distance),), diffraction=Diffraction(GREEN))
    assert np.abs(render(scene, tolerance=0.002) - render(scene, tolerance=5e-4)).max() < 0.002


@pytest.mark.parametrize("target", [Edge(0.3), Bars((0.5, 12.0), 20.0, 6.0)])
@pytest.mark.parametrize(
    ("rim", "cutoff", "tolerance"),
    [(1.5, 0.3, 3e-4), (8.0, 2.0, 3e-4), (8.0, 6.0, 5e-4), (16.0, 6.0, 1.4e-3)],
)
def test_sharp_light_on_rims_is_as_right_as_asked(
    rim: float, cutoff: float, tolerance: float, target: Target
) -> None:
    """Few points in a pixel are enough, and bars' upper and lower borders are as sharp as the
    light; against a tenth of the tolerance.

    Borders told at six places a pixel, however short the waves, were off by up to 1.5 of the
    tolerance.
    """
    side = RIM / rim  # mm, of a pixel
    light = Diffraction(0.336 * side / (1.15 * cutoff))
    for offset in ((0.0, 0.0), (4.2, 0.4)):
        scene = Scene(
            lone(round(3.6 * rim) + 6, side),
            (Plane(target, FOCUS, offset=offset),),
            diffraction=light,
        )
        coarse, fine = (render(scene, tolerance=asked) for asked in (tolerance, tolerance / 10))
        assert np.abs(coarse - fine).max() < tolerance


def test_texels_of_a_pixel_in_sharp_light_on_a_rim_are_as_right_as_asked() -> None:
    """They have edges along both axes in each pixel: squares enough for an edge were 1.9 of the
    tolerance off.
    """
    picture = Picture(np.random.default_rng(1).random((24, 32)).round(), 12.0)
    side = RIM / 8  # mm, of a pixel
    scene = Scene(
        lone(35, side),
        (Plane(picture, FOCUS, offset=(2.2, 0.4)),),
        diffraction=Diffraction(0.336 * side / (1.15 * 12)),
    )
    coarse, fine = (render(scene, tolerance=tolerance) for tolerance in (7e-4, 6e-5))
    assert np.abs(coarse - fine).max() < 7e-4


def test_dots_as_large_as_their_blur_change_with_it_by_more_than_an_edge_does() -> None:
    """Microlenses share a blur only where no dot tells: taken for edges, dots were off by more than
    asked for.
    """
    dots, distance, tolerance = FourDot(diameter=1.0, spacing=12.0), 250.0, 0.01
    plane = Plane(dots, distance, offset=(6.0, 6.0))  # one of them on the axis

    def seen(*focal_lengths: float) -> Array:
        array = MicrolensArray(
            "square",
            (2, 1),
            (0.2, 0.4),
            0.16,
            focal_lengths,
            60.0,
            pattern=(tuple(range(len(focal_lengths))),),
        )
        camera = Camera(MainLens(50.0, 8.0), array, Sensor((220, 60), 0.00166, 61.15))
        return render(Scene(camera, (plane,), diffraction=Diffraction(GREEN)), tolerance=tolerance)

    both, left, right = seen(0.917, 0.932), seen(0.917), seen(0.932)
    assert np.abs(left - right).max() > 2 * tolerance
    assert np.abs(both - np.where(np.arange(220) < 110, left, right)).max() < tolerance


@pytest.mark.parametrize("tolerance", [2.5e-3, 1.25e-3])
def test_bars_finer_than_pixels_are_told_on_rims_where_they_change_within_a_pixel(
    tolerance: float,
) -> None:
    """A pixel averages lines away whose waves it holds whole, unless the rim changes meanwhile:
    without them 1.6 of the tolerance off.
    """
    array = MicrolensArray("square", (3, 3), (0.4, 0.4), 0.336, (0.917,), 60.0)
    camera = Camera(MainLens(50.0, 2.0), array, Sensor((96, 96), 0.00996, 61.15))
    scene = Scene(camera, (Plane(Bars(), FOCUS),), diffraction=Diffraction(800e-6))
    assert (
        np.abs(render(scene, tolerance=tolerance) - render(scene, tolerance=tolerance / 16)).max()
        < 0.7 * tolerance
    )

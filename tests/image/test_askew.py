"""Pixels that stand askew on dots and pictures: exact areas against counting, single rays against
rays traced one by one.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.cards.single_rays import add_single_rays
from flflab.image.geometry.setup import make_setup
from flflab.image.radiance.parallelogram import (
    disc_parallelogram_area,
    parallelogram_sum,
    ruled_parallelogram,
)
from flflab.image.radiance.profile import first_antiderivative, first_mean, profile_table
from flflab.image.reference.pixels import trace_pixels
from flflab.image.render import render
from flflab.image.scene import ALL, Plane, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, Chirp, FourDot, Picture, Target

CAMERA = Camera(
    MainLens(50.0, 4.0),
    MicrolensArray(
        layout="square",
        count=(5, 5),
        pitch=(0.4, 0.4),
        aperture=0.336,
        focal_lengths=(0.917,),
        distance=60.0,
    ),
    Sensor((110, 90), 0.00166, 61.15),
)
NOISE = np.random.default_rng(1).random((8, 10))
BLACK_AND_WHITE = (np.random.default_rng(1).random((10, 10)) < 0.5).astype(np.float64)
SIDES = [
    (0.4, 0.3, -0.3, 0.4),
    (0.9, 0.5, 0.2, 0.7),
    (-0.02, 0.03, 0.05, 0.02),
    (3.1, -0.4, 0.0, 2.2),
]


def points_of(
    x: float, y: float, sides: tuple[float, float, float, float]
) -> npt.NDArray[np.float64]:
    """A dense grid of points of a parallelogram, shape (2, N)."""
    along = (np.arange(1500) + 0.5) / 1500 - 0.5
    first, second = (part.ravel() for part in np.meshgrid(along, along))
    return np.array(
        [x + sides[0] * first + sides[2] * second, y + sides[1] * first + sides[3] * second]
    )


@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.5, -0.6), (0.71, 0.7), (-1.1, 0.1), (3.0, 3.0)])
def test_the_area_of_a_disc_in_a_parallelogram_is_what_counting_says(
    place: tuple[float, float], sides: tuple[float, ...]
) -> None:
    ux, uy, vx, vy = sides
    within = float(np.mean(np.hypot(*points_of(*place, (ux, uy, vx, vy))) < 1.0))
    assert disc_parallelogram_area(1.0, *place, ux, uy, vx, vy) / abs(
        ux * vy - vx * uy
    ) == pytest.approx(within, abs=1e-3)


@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize(
    "place", [(5.0, 4.0), (5.02, 3.99), (0.1, 7.9), (9.7, 0.5), (-0.2, 3.3), (20.0, 1.0)]
)
def test_the_sum_of_a_picture_over_a_parallelogram_is_what_its_texels_say(
    place: tuple[float, float], sides: tuple[float, ...]
) -> None:
    ux, uy, vx, vy = sides
    column, row = np.floor(points_of(*place, (ux, uy, vx, vy))).astype(int)
    inside = (column >= 0) & (column < 10) & (row >= 0) & (row < 8)
    mean = float(np.sum(NOISE[row[inside], column[inside]]) / inside.size)
    sums = np.pad(NOISE.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    assert parallelogram_sum(*place, ux, uy, vx, vy, sums) / abs(
        ux * vy - vx * uy
    ) == pytest.approx(mean, abs=1e-3)


@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.4, 0.9), (-1.2, -1.0), (1.5, 0.2), (0.0, 2.6)])
def test_the_integral_of_bars_over_a_parallelogram_ends_where_they_end(
    place: tuple[float, float], sides: tuple[float, ...]
) -> None:
    ux, uy, vx, vy = sides
    bars = Bars((1.1, 1.6), 3.0, 2.0)
    across, up = points_of(*place, (ux, uy, vx, vy))
    bright = (np.abs(across) < 1.5) & (np.abs(up) < 1.0)
    seen = np.where(bright, bars.profile(bars.phase(np.where(bright, across, 0.0))), 0.0)
    found = ruled_parallelogram(
        *place, ux, uy, vx, vy, -1.0, 1.0, *profile_table(bars, bars.width)
    ) / abs(ux * vy - vx * uy)
    assert found == pytest.approx(float(seen.mean()), abs=1.5e-3)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("target", "pixels"),
    [
        (FourDot(0.6, 1.0), [(33, 51), (37, 60), (33, 61)]),
        (Picture(NOISE, 2.0), [(65, 60), (64, 61), (63, 62)]),
    ],
    ids=["dots", "picture"],
)
def test_a_sharp_target_turned_by_45_degrees_is_what_rays_show(
    target: Target, pixels: list[tuple[int, int]]
) -> None:
    plane = Plane(target, 506.7016, (0.1, 0.03), 0.785)
    scene = Scene(CAMERA, (plane,))
    singly = np.zeros((90, 110))
    add_single_rays(singly, make_setup(scene, plane, 0.002, ALL), plane, None, ())
    traced, uncertainty = trace_pixels(scene, np.array(pixels)[:, ::-1], wanted=1e-4)
    assert uncertainty.max() <= 1e-4
    for image in (render(scene), singly):  # at once, and ray by ray as past cards
        assert np.abs(image[tuple(np.array(pixels).T)] - traced).max() < 3e-4


@pytest.mark.parametrize(
    ("distance", "roll", "pixels"),
    [
        (506.7016, 0.3, [(39, 62), (36, 53)]),
        (506.7016, 0.785, [(55, 56), (46, 47)]),
        (503.0, 0.3, [(39, 62)]),
        (495.0, 0.785, [(57, 56), (43, 42)]),
    ],
    ids=["sharp", "sharp at 45 degrees", "half a pixel of blur", "1.7 pixels of blur"],
)
def test_the_ends_of_bars_askew_are_what_rays_show(
    distance: float, roll: float, pixels: list[tuple[int, int]]
) -> None:
    plane = Plane(Bars((2.0, 3.0), 1.2, 0.9), distance, (0.1, 0.03), roll)
    scene = Scene(CAMERA, (plane,))
    traced, uncertainty = trace_pixels(scene, np.array(pixels)[:, ::-1], wanted=1e-4)
    assert uncertainty.max() <= 1e-4
    assert np.abs(render(scene, tolerance=5e-4)[tuple(np.array(pixels).T)] - traced).max() < 5e-4


@pytest.mark.parametrize(
    ("distance", "roll", "pixels"),
    [
        pytest.param(506.3, 0.785, [(38, 73), (35, 70)], marks=pytest.mark.ci),
        (500.0, 0.785, [(66, 53), (65, 57)]),
        (485.0, 0.0, [(41, 62)]),
        (460.0, 0.0, [(60, 69), (68, 53)]),
    ],
    ids=[
        "a twentieth of a pixel of blur",
        "0.9 pixels of blur",
        "3.3 pixels of blur, not askew",
        "8 pixels of blur, not askew",
    ],
)
def test_a_blurred_picture_is_what_rays_show(
    distance: float, roll: float, pixels: list[tuple[int, int]]
) -> None:
    scene = Scene(CAMERA, (Plane(Picture(BLACK_AND_WHITE, 2.0), distance, (0.1, 0.03), roll),))
    traced, uncertainty = trace_pixels(scene, np.array(pixels)[:, ::-1], wanted=1e-4)
    assert uncertainty.max() <= 1e-4
    assert np.abs(render(scene, tolerance=0.001)[tuple(np.array(pixels).T)] - traced).max() < 0.001


@pytest.mark.parametrize(
    ("target", "pixels"),
    [
        (FourDot(), [(51, 29), (11, 50)]),
        pytest.param(Picture(BLACK_AND_WHITE, 2.0), [(56, 32), (32, 32)], marks=pytest.mark.ci),
    ],
    ids=["dots", "picture"],
)
def test_a_steep_target_on_wide_pixels_is_what_rays_show(
    target: Target, pixels: list[tuple[int, int]]
) -> None:
    """A tilt of 27 degrees bends the map within two pixels of 20 um: parts of two pixels a side
    were off by 7.2 and 5.2 tolerances.
    """
    camera = replace(
        CAMERA, array=replace(CAMERA.array, count=(3, 3)), sensor=Sensor((65, 65), 0.02, 61.15)
    )
    scene = Scene(camera, (Plane(target, 506.7, roll=0.3, tilt=(0.4, 0.3)),))
    traced, uncertainty = trace_pixels(scene, np.array(pixels)[:, ::-1], wanted=3e-5)
    assert uncertainty.max() <= 3e-5
    assert np.abs(render(scene, tolerance=2e-4)[tuple(np.array(pixels).T)] - traced).max() < 2e-4


@pytest.mark.ci
@pytest.mark.parametrize(
    ("distance", "tolerance", "pixel"),
    [(470.0, 0.001, (9, 47)), (490.0, 5e-4, (36, 42))],
    ids=["6 pixels of blur", "2.5 pixels of blur"],
)
def test_single_rays_on_a_blurred_picture_are_those_traced(
    distance: float, tolerance: float, pixel: tuple[int, int]
) -> None:
    array = replace(CAMERA.array, count=(3, 3))
    camera = replace(CAMERA, array=array, sensor=replace(CAMERA.sensor, resolution=(70, 60)))
    plane = Plane(Picture(BLACK_AND_WHITE, 2.0), distance, (0.1, 0.03))
    scene = Scene(camera, (plane,))
    image = np.zeros((60, 70))
    add_single_rays(image, make_setup(scene, plane, tolerance, ALL), plane, None, ())
    traced, uncertainty = trace_pixels(scene, np.array([pixel])[:, ::-1], wanted=1e-4)
    assert uncertainty.max() <= 1e-4
    assert abs(image[pixel] - traced[0]) < tolerance


@pytest.mark.parametrize(
    "target", [Bars((1.1, 1.6), 3.0, 2.0), Chirp((0.7, 3.1), 3.0, 2.0)], ids=["bars", "chirp"]
)
@pytest.mark.parametrize("way", [1e-9, 1e-6, 1e-3, 0.3, 4.0])
def test_the_mean_of_the_light_left_of_a_short_way_loses_no_digits(
    target: Bars, way: float
) -> None:
    """A difference of second antiderivatives over a way of 1e-6 mm has lost half of its digits."""
    table, law = profile_table(target, target.width)
    for place in (-1.7, -1.5, -0.3, 0.123, 1.1, 1.5, 2.0):
        ways = np.linspace(place, place + way, 20001)
        means = [first_antiderivative(float(at), table, law) for at in ways]
        assert first_mean(place, place + way, table, law) == pytest.approx(
            np.trapezoid(means, dx=1 / 20000), abs=1e-14 if way < 1e-3 else 1e-7
        )
        assert first_mean(place + way, place, table, law) == first_mean(
            place, place + way, table, law
        )

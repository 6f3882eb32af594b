"""Dots where nobody expects them: the target elsewhere, nearer or farther than told, and turned.
Truth by rays of this test's own.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.render import render
from flflab.image.scene import Plane, Scene, one_plane
from flflab.measurement.dots.pose import spots_in
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.targets import Chirp, FourDot, Target, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
RESOLUTION = (1240, 1240)
FOCUS = 506.7016
TARGET = FourDot(diameter=1.0, spacing=4.0)


def taken(
    brute: Any,
    f_number: float,
    target: Target,
    distance: float,
    aside: tuple[float, float],
    turn: float,
) -> Array:
    scene = Scene(
        brute.camera(f_number, RESOLUTION), (Plane(target, distance, offset=aside, roll=turn),)
    )
    return brute.expose(render(scene, tolerance=1e-3), NOISE, 3000, np.random.default_rng(3))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("f_number", "distance", "aside", "turn", "told"),
    [
        (4.0, 560.0, (2.0, -2.2), -0.5, FOCUS),
        pytest.param(2.8, 460.0, (0.0, -1.2), 0.3, FOCUS, marks=pytest.mark.full),
        pytest.param(4.0, FOCUS, (3.0, -1.2), 0.0, FOCUS, marks=pytest.mark.ci),
        pytest.param(4.0, 640.0, (1.0, -0.2), 0.0, FOCUS, marks=pytest.mark.full),
        pytest.param(5.6, FOCUS, (3.0, 3.2), 0.2, 900.0, marks=pytest.mark.ci),
        pytest.param(4.0, 470.0, (-3.0, 1.0), 0.7, 1500.0, marks=pytest.mark.ci),
    ],
)
def test_dots_are_found_wherever_the_target_stands(
    brute: Any,
    f_number: float,
    distance: float,
    aside: tuple[float, float],
    turn: float,
    told: float,
) -> None:
    camera = brute.camera(f_number, RESOLUTION)
    white = brute.expose(
        render(one_plane(camera, White(), told), tolerance=1e-3),
        NOISE,
        3000,
        np.random.default_rng(2),
    )
    lattice = lattice_behind(camera, white, NOISE)
    picture = taken(brute, f_number, TARGET, distance, aside, turn)
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    for dot in count_views(picture, lattice, camera, TARGET, told, NOISE):
        where = turned @ TARGET.centres[dot.dot] + aside
        _, landed = brute.landings(camera, distance, where)
        assert dot.views >= 1
        off = np.hypot(*(dot.centres_px[:, None] - landed[None]).transpose(2, 0, 1)).min(axis=1)
        assert (off < 5 * np.hypot(*dot.centre_uncertainty_px.T) + 0.01).all()
        if np.isfinite(dot.position_mm).all():
            assert np.all(
                np.abs(dot.position_mm - [*where, -distance]) < 4 * dot.uncertainty_mm + 0.002
            )


def test_hot_pixels_are_no_spots(brute: Any) -> None:
    picture = taken(brute, 4.0, TARGET, FOCUS, (0.5, 0.3), 0.0)
    hot = picture.copy()
    hot.ravel()[np.random.default_rng(4).choice(hot.size, 500, replace=False)] = 4000
    for radius in (8.0, 3.0):
        seen, among = spots_in(picture, radius, NOISE), spots_in(hot, radius, NOISE)
        assert len(among) == len(seen) >= 12
        moved = np.hypot(*(among[:, None] - seen[None]).transpose(2, 0, 1)).min(axis=1)
        assert np.median(moved) < 0.75
        # one at the rim of a spot that is cut to 22 pixels moves it by 0.73 or 1.03, as the noise
        # falls
        assert moved.max() < 1.5


@pytest.mark.ci
@pytest.mark.parametrize("target", [White(), Chirp((0.3, 2.0), 40.0, 40.0)])
def test_what_makes_no_square_is_no_pattern(brute: Any, target: Target) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    lattice = lattice_behind(camera, taken(brute, 4.0, White(), FOCUS, (0.0, 0.0), 0.0), NOISE)
    picture = taken(brute, 4.0, target, FOCUS, (0.0, 0.0), 0.0)
    with pytest.raises(MeasurementError, match="no pattern of dots"):
        count_views(picture, lattice, camera, TARGET, FOCUS, NOISE)


def test_dots_of_another_size_than_told_make_no_square(brute: Any) -> None:
    """Their parallax says how far they are, and then the square's side what it should be."""
    camera = brute.camera(4.0, RESOLUTION)
    lattice = lattice_behind(camera, taken(brute, 4.0, White(), FOCUS, (0.0, 0.0), 0.0), NOISE)
    picture = taken(brute, 4.0, FourDot(diameter=1.0, spacing=6.0), FOCUS, (0.5, 0.3), 0.1)
    with pytest.raises(MeasurementError, match="no pattern of dots"):
        count_views(picture, lattice, camera, TARGET, FOCUS, NOISE)

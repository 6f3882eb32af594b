"""Dots blurred over more than any bright field, as in a Raytrix R12: every spot is cut, and some
micro-images show two of them.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.views import DotViews, count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.measure import measure
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.cut_light import wide
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
CAMERA = Camera(
    MainLens(49.885, 4.0),
    MicrolensArray("hexagonal", (30, 30), (0.12744, 0.12744), 0.12744, (0.56057,), 56.866),
    Sensor((420, 420), 0.0055, 57.1971),
)
KINDS = replace(
    CAMERA.array,
    focal_lengths=(0.58267, 0.52402, 0.56057),
    pattern=((0, 1, 2), (1, 2, 0)),
    tilt=(0.0003, -0.0004),
)
BRIGHT_PX = 1.8  # radius of the bright fields; spots with their blur reach 7.4 to 13 px


def measured(
    brute: Any,
    target: FourDot,
    distance: float,
    offset: tuple[float, float],
    seed: int,
    camera: Camera = CAMERA,
) -> tuple[DotViews, ...]:
    rng = np.random.default_rng(seed)
    scenes = [one_plane(camera, one, distance, offset) for one in (White(), target)]
    white, dots = (
        brute.expose(render(scene, tolerance=5e-4), NOISE, 3000, rng) for scene in scenes
    )
    lattice = lattice_behind(camera, white, NOISE)
    assert lattice.inside_radius_px < BRIGHT_PX + 0.8
    return count_views(dots, white, lattice, camera, target, distance, NOISE)


@pytest.mark.parametrize(
    ("diameter", "spacing", "distance"),
    [
        (6.0, 20.0, 900.0),
        # what the square of dots says of their radius and what their radius does to the square go
        # round and round here
        pytest.param(6.0, 20.0, 600.0, marks=pytest.mark.ci),
        pytest.param(10.0, 30.0, 900.0, marks=pytest.mark.ci),
        pytest.param(4.0, 20.0, 900.0, marks=pytest.mark.ci),
    ],
)
def test_dots_that_every_micro_image_cuts_stand_where_they_are(
    brute: Any, diameter: float, spacing: float, distance: float
) -> None:
    target, offset = FourDot(diameter=diameter, spacing=spacing), (0.5, -0.3)
    for dot in measured(brute, target, distance, offset, seed=4):
        off = dot.position_mm - np.append(target.centres[dot.dot] + offset, -distance)
        assert np.abs(off / dot.uncertainty_mm).max() < 3.5
        assert dot.uncertainty_mm[2] < 1


@pytest.mark.parametrize("distance", [900.0, pytest.param(600.0, marks=pytest.mark.ci)])
def test_behind_tilted_microlenses_of_three_kinds_dots_stand_where_they_are(
    brute: Any, distance: float
) -> None:
    target, offset = FourDot(diameter=6.0, spacing=20.0), (1.5, -0.8)
    for dot in measured(brute, target, distance, offset, 2, replace(CAMERA, array=KINDS)):
        off = dot.position_mm - np.append(target.centres[dot.dot] + offset, -distance)
        assert np.abs(off / dot.uncertainty_mm).max() < 3.5
        assert dot.uncertainty_mm[2] < 1


def test_without_a_white_picture_they_are_refused_since_nothing_shows_how_light_falls_off() -> None:
    target = FourDot(diameter=6.0, spacing=20.0)
    picture = 64 + 3000 * render(one_plane(CAMERA, target, 900.0), tolerance=1e-3)
    with pytest.raises(MeasurementError, match="name a picture of a white target"):
        measure(picture, CAMERA, target, 900.0, NOISE)


def test_what_stands_for_saturated_in_single_precision_is_saturated() -> None:
    """Rounded down, all that was no dot passed for plain white."""
    for full in (4095.0, 8000.000000000001, 65535 / 8):
        noise = replace(NOISE, full_scale_dn=full)
        assert noise.saturated(noise.saturated_dn)


def test_dots_blurred_into_one_another_are_refused(brute: Any) -> None:
    with pytest.raises(MeasurementError, match=r"10\.\d px apart and, with 11\.4 px of blur"):
        measured(brute, FourDot(diameter=6.0, spacing=12.0), 900.0, (0.0, 0.0), seed=1)


@pytest.mark.full
def test_of_many_such_pictures_depths_scatter_as_is_stated(brute: Any) -> None:
    target, scores = FourDot(diameter=6.0, spacing=20.0), []
    for seed in range(12):
        for dot in measured(brute, target, 900.0, (0.1, 0.2), seed):
            off = dot.position_mm - np.append(target.centres[dot.dot] + (0.1, 0.2), -900.0)
            scores.append(off / dot.uncertainty_mm)
    assert np.all(np.sqrt(np.mean(np.square(scores), axis=0)) < 1.3)


def test_the_light_of_a_broadly_blurred_dot_grows_with_its_radius_as_its_slope_says() -> None:
    nodes, step = np.polynomial.legendre.leggauss(4), 1e-5
    spot = np.array([2.3, -1.1])
    for x, y in ((0.0, 0.0), (3.0, 1.0), (-2.0, 4.0), (5.5, -3.5)):
        there, here = (
            wide(x, y, spot, 2.6 + side * step, 6.6, 4.8, -1.2, nodes)[0] for side in (1, -1)
        )
        assert wide(x, y, spot, 2.6, 6.6, 4.8, -1.2, nodes)[4] == pytest.approx(
            (there - here) / (2 * step), rel=1e-6, abs=1e-6
        )

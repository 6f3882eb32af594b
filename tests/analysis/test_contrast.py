"""Contrast against frequency from pictures of bars made by strips and rays, against closed forms."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import j1

from flflab.analysis.contrast import ContrastCurve, fit_contrast
from flflab.analysis.lattice import find_lattice
from flflab.analysis.noise import SensorNoise
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.targets import Bars, Chirp

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
RESOLUTION = (760, 520)
FOCUS = 506.7016


def closed_form(camera: Camera, distance: float, frequency: Array) -> Array:
    """sinc u times 2 J1(z)/z for the bright field of a microlens-limited view, written out for this camera."""
    b, away, f, main = camera.gap, camera.array.distance, camera.array.focal_lengths[0], camera.main_lens.focal_length
    image = 1 / (1 / main - 1 / distance)
    a = away - image  # behind the main lens's image
    spread = camera.array.aperture * abs(1 / f - 1 / b - 1 / a) * b
    scale = b / a * image / distance
    u, z = frequency * camera.sensor.pixel / scale, np.pi * spread * frequency / scale
    return np.sinc(u) * np.where(z < 1e-6, 1.0, 2 * j1(np.maximum(z, 1e-6)) / np.maximum(z, 1e-6))


def measured(
    brute: Any,
    camera: Camera,
    distance: float,
    pictures: tuple[Array, Array],
    target: Bars,
    seed: int,
    level: float = 3000,
) -> ContrastCurve:
    rng = np.random.default_rng(seed)
    white, bars = (brute.expose(picture, NOISE, level, rng) for picture in pictures)
    lattice = find_lattice(white, "square", 245.0, NOISE)
    return fit_contrast(bars, lattice, camera, target, distance, NOISE)


@pytest.mark.parametrize(
    ("f_number", "distance", "shift", "level", "scatter"),
    [
        (4.0, FOCUS, 0.0, 3000, 0.2),
        (4.0, 497.0, 0.37, 3000, 0.2),
        (2.8, 490.0, -0.2, 3000, 0.15),
        (8.0, FOCUS, 0.0, 3000, 0.9),  # a dozen pixels across a view
        (1.6, FOCUS, 0.1, 1000, 0.6),
    ],
)
def test_bars_give_the_closed_form_contrast_within_their_uncertainty(
    brute: Any, f_number: float, distance: float, shift: float, level: float, scatter: float
) -> None:
    camera = brute.camera(f_number, RESOLUTION)
    target = Bars()
    curve = measured(brute, camera, distance, brute.bars_picture(camera, distance, (0.5, 10.0), 20.0, shift=shift), target, 3, level)
    error = curve.contrast - closed_form(camera, distance, curve.cycles_per_mm)
    assert len(error) >= 4
    assert np.sqrt(np.mean((error / curve.uncertainty) ** 2)) < 2.0
    well_known = curve.uncertainty < 1e-3
    assert np.abs(error[well_known]).max(initial=0.0) < 1.5e-3
    assert curve.chi2_per_pixel == pytest.approx(1.0, abs=scatter)
    assert curve.geometry[0] == pytest.approx(-shift, abs=2e-3)


def test_without_noise_the_bias_is_below_five_in_ten_thousand(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    white, bars = brute.bars_picture(camera, FOCUS, (0.5, 10.0), 20.0)
    lattice = find_lattice(white * 3000 + 64, "square", 245.0, NOISE)
    curve = fit_contrast(bars * 3000 + 64, lattice, camera, Bars(), FOCUS, NOISE)
    error = curve.contrast - closed_form(camera, FOCUS, curve.cycles_per_mm)
    assert np.abs(error).max() < 5e-4
    # the extremes of ideal bars are 1 up to half a cycle a pixel (eq. 2), whatever the phases of the pixels
    sharp = curve.cycles_per_px < 0.45
    assert np.abs(curve.extremes[sharp] - 1).max() < 3e-3


def test_a_sine_chirp_gives_the_same_curve(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    target = Chirp()
    curve = measured(brute, camera, 500.0, brute.bars_picture(camera, 500.0, (0.5, 10.0), 20.0, sine=True), target, 5)
    error = curve.contrast - closed_form(camera, 500.0, curve.cycles_per_mm)
    assert np.sqrt(np.mean((error / curve.uncertainty) ** 2)) < 2.0


def test_falling_frequencies_are_bars_too(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    target = Bars(cycles_per_mm=(8.0, 1.0))
    curve = measured(brute, camera, FOCUS, brute.bars_picture(camera, FOCUS, (8.0, 1.0), 20.0), target, 6)
    assert np.abs(curve.contrast - closed_form(camera, FOCUS, curve.cycles_per_mm)).max() < 5e-3


def test_a_sensor_that_stands_off_by_a_hundredth_of_the_gap_is_still_measured(brute: Any) -> None:
    real = brute.camera(4.0, RESOLUTION)
    nominal = replace(real, sensor=replace(real.sensor, distance=real.sensor.distance + 0.0115))
    curve = measured(brute, nominal, FOCUS, brute.bars_picture(real, FOCUS, (0.5, 10.0), 20.0), Bars(), 8)
    assert np.abs(curve.contrast - closed_form(real, FOCUS, curve.cycles_per_mm)).max() < 5e-3


@pytest.mark.ci
@pytest.mark.parametrize(("f_number", "low", "high"), [(8.0, 0.5, 1.15), (5.6, 0.5, 1.15)])
def test_the_uncertainty_covers_repeated_noise_without_being_twice_too_wide(brute: Any, f_number: float, low: float, high: float) -> None:
    camera = brute.camera(f_number, RESOLUTION)  # few pixels: noise rules, and knots in gaps are held by the prior alone
    pictures = brute.bars_picture(camera, FOCUS, (0.5, 10.0), 20.0)
    scores: list[float] = []
    for seed in range(30):
        curve = measured(brute, camera, FOCUS, pictures, Bars(), seed, level=1000)
        scores.extend((curve.contrast - closed_form(camera, FOCUS, curve.cycles_per_mm)) / curve.uncertainty)
    assert low < np.sqrt(np.mean(np.square(scores))) < high
    assert np.mean(np.abs(scores) > 2) < 0.07


@pytest.mark.parametrize(
    "picture",
    [
        np.full((520, 760), 1500.0),
        np.full((520, 760), 4095.0),
        np.zeros((2, 2)),
        np.full((520, 760), np.nan),
    ],
)
def test_a_picture_without_bars_is_refused(brute: Any, picture: Array) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    white = brute.white_picture((520, 760), "square", 245.58, 0.0, (379.5, 259.5), 72.2, 23.8)
    lattice = find_lattice(white * 3000 + 64, "square", 245.0, NOISE)
    with pytest.raises(MeasurementError, match="bars picture"):
        fit_contrast(picture, lattice, camera, Bars(), FOCUS, NOISE)

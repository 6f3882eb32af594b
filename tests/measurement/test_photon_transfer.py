"""Photon transfer against sensors drawn by numpy, whose gain and read noise are known."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import InputError, MeasurementError
from flflab.measurement.sensor.photon_transfer import Pair, photon_transfer

Array = npt.NDArray[np.float64]
GAIN, READ, OFFSET, FULL = 0.4, 1.2, 64.0, 4095.0


def frames(light_e: Array, rng: np.random.Generator, count: int = 2) -> Pair:
    electrons = rng.poisson(light_e, (count, *light_e.shape)) + READ / GAIN * rng.standard_normal(
        (count, *light_e.shape)
    )
    numbers = np.clip(np.rint(OFFSET + GAIN * electrons), 0, FULL)
    return numbers[0], numbers[1]


def scene(shape: tuple[int, int], top: float) -> Array:
    """Bright spots on black, as micro-images are."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return top * np.clip(1.4 - np.hypot((x % 40) - 20, (y % 40) - 20) / 14, 0, 1)


def test_gain_and_read_noise_are_found_within_their_uncertainty() -> None:
    rng = np.random.default_rng(1)
    light = scene((300, 400), 7000)
    found = photon_transfer([frames(light, rng)], frames(np.zeros_like(light), rng), FULL)
    assert abs(found.noise.dn_per_electron - GAIN) < 3 * found.gain_uncertainty
    assert abs(found.dark_variance - READ**2 - 1 / 12) < 3 * found.dark_uncertainty
    assert abs(found.noise.offset_dn - OFFSET) < 3 * found.offset_uncertainty
    assert found.gain_uncertainty < 0.005
    assert found.chi2_per_pixel == pytest.approx(1, abs=0.05)


@pytest.mark.full
def test_intervals_of_95_per_cent_cover_the_truth_in_94_to_96_of_100() -> None:
    rng = np.random.default_rng(20261)
    light = scene((40, 80), 7000)
    z = np.zeros((10_000, 2))
    for index in range(len(z)):
        found = photon_transfer([frames(light, rng)], frames(np.zeros_like(light), rng), FULL)
        z[index, 0] = (found.noise.dn_per_electron - GAIN) / found.gain_uncertainty
        z[index, 1] = (found.dark_variance - READ**2 - 1 / 12) / found.dark_uncertainty
    covered = (np.abs(z) < 1.959964).mean(axis=0)
    assert ((covered > 0.94) & (covered < 0.96)).all(), covered


def test_a_lamp_that_drifts_a_little_does_no_harm() -> None:
    rng = np.random.default_rng(2)
    light = scene((300, 400), 5000)
    pair = frames(light, rng)[0], frames(1.03 * light, rng)[0]
    found = photon_transfer([pair], frames(np.zeros_like(light), rng), FULL)
    assert found.noise.dn_per_electron == pytest.approx(GAIN, rel=0.03)


def test_saturated_pixels_are_left_out() -> None:
    rng = np.random.default_rng(3)
    light = scene((300, 400), 20000)
    found = photon_transfer([frames(light, rng)], frames(np.zeros_like(light), rng), FULL)
    assert abs(found.noise.dn_per_electron - GAIN) < 4 * found.gain_uncertainty
    assert found.pixels < 2 * light.size


@pytest.mark.parametrize(
    ("pairs", "dark", "says"),
    [
        ([], (np.zeros((40, 40)), np.zeros((40, 40))), "no pair"),
        (
            [(np.zeros((40, 41)), np.zeros((40, 41)))],
            (np.zeros((40, 40)), np.zeros((40, 40))),
            "all must be alike",
        ),
        (
            [(np.zeros((40, 40)), np.zeros((40, 40)))],
            (np.zeros((4, 4)), np.zeros((4, 4))),
            "1000 pixels",
        ),
        (
            [(np.full((40, 40), math.nan), np.zeros((40, 40)))],
            (np.zeros((40, 40)), np.zeros((40, 40))),
            "finite",
        ),
    ],
)
def test_frames_that_do_not_fit_are_refused(pairs: list[Pair], dark: Pair, says: str) -> None:
    with pytest.raises(InputError, match=says):
        photon_transfer(pairs, dark, FULL)


def test_a_changing_lamp_and_a_dark_scene_are_told() -> None:
    rng = np.random.default_rng(4)
    light = scene((300, 400), 5000)
    dark = frames(np.zeros_like(light), rng)
    with pytest.raises(MeasurementError, match="keep the lamp steady"):
        photon_transfer([(frames(light, rng)[0], frames(1.5 * light, rng)[0])], dark, FULL)
    with pytest.raises(MeasurementError, match="pixels with light"):
        photon_transfer([dark], dark, FULL)

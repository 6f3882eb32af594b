import math
import time

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.image.sensor_response import SensorResponse, digitise

RESPONSE = SensorResponse(full_well_e=9000.0, read_noise_e=4.0, bits=12, dn_per_electron=0.4, offset_dn=64.0)


@pytest.mark.parametrize("level", [0.0, 0.002, 0.05, 0.3, 0.8])
def test_photon_transfer_mean_and_variance_follow_the_electrons(level: float) -> None:
    electrons = 8000.0 * level
    numbers = digitise(np.full((400, 500), level), 8000.0, RESPONSE, np.random.default_rng(1)).astype(float)
    variance = 0.4**2 * (electrons + 4.0**2) + 1 / 12
    assert numbers.mean() == pytest.approx(64.0 + 0.4 * electrons, abs=4 * math.sqrt(variance / numbers.size))
    assert numbers.var() == pytest.approx(variance, rel=4 * math.sqrt(2 / numbers.size))


def test_neighbouring_pixels_and_frames_are_independent() -> None:
    rng = np.random.default_rng(2)
    first, second = (digitise(np.full((300, 300), 0.4), 8000.0, RESPONSE, rng).astype(float) for _ in range(2))
    for one, other in ((first[:, 1:], first[:, :-1]), (first[1:], first[:-1]), (first, second)):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / math.sqrt(one.size)


def test_the_same_generator_gives_the_same_picture_and_another_does_not() -> None:
    image = np.linspace(0, 1, 20000).reshape(100, 200)
    first, again, other = (digitise(image, 5000.0, RESPONSE, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_pixel_saturates_at_the_full_well_or_the_largest_number() -> None:
    rng = np.random.default_rng(3)
    well = SensorResponse(full_well_e=1000.0, read_noise_e=0.0, bits=12, dn_per_electron=1.0, offset_dn=0.0)
    assert np.all(digitise(np.full((10, 10), 1.0), 5000.0, well, rng) == 1000)
    number = SensorResponse(full_well_e=1e6, read_noise_e=0.0, bits=8, dn_per_electron=1.0, offset_dn=0.0)
    assert np.all(digitise(np.full((10, 10), 1.0), 5000.0, number, rng) == 255)
    assert number.saturation_e == 255
    assert well.saturation_e == 1000


def test_without_noise_the_numbers_are_the_rounded_light() -> None:
    quiet = SensorResponse(full_well_e=1e5, read_noise_e=0.0, bits=12, dn_per_electron=0.5, offset_dn=10.0)
    image = np.array([[0.0, 0.1, 0.2]])
    assert digitise(image, 1000.0, quiet, np.random.default_rng(0), shot_noise=False).tolist() == [[10, 60, 110]]


def test_a_dark_frame_never_falls_below_nothing() -> None:
    low = SensorResponse(read_noise_e=50.0, dn_per_electron=1.0, offset_dn=5.0)
    numbers = digitise(np.zeros((100, 100)), 1000.0, low, np.random.default_rng(0))
    assert numbers.min() == 0
    assert numbers.dtype == np.uint16


def test_ten_million_pixels_take_less_than_half_a_second_of_one_core() -> None:
    image = np.zeros((2748, 3664))
    image[:, ::3] = 0.5
    started = time.thread_time()
    digitise(image, 8000.0, RESPONSE, np.random.default_rng(0))
    assert time.thread_time() - started < 1.5  # a goal of 0.5 s, with room for a slow or busy machine


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf])
def test_impossible_light_is_refused(bad: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        digitise(np.array([[bad]]), 1000.0, RESPONSE, np.random.default_rng(0))
    with pytest.raises(InputError, match="electrons_at_white"):
        digitise(np.ones((1, 1)), bad, RESPONSE, np.random.default_rng(0))


@pytest.mark.parametrize(
    "change",
    [{"full_well_e": 0.0}, {"read_noise_e": -1.0}, {"bits": 17}, {"dn_per_electron": 0.0}, {"offset_dn": 4095.0}, {"offset_dn": math.nan}],
)
def test_impossible_sensors_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        SensorResponse(**change)  # pyright: ignore[reportArgumentType]

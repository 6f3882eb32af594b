import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from flflab.errors import InputError
from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.fixed_pattern import FixedPattern
from flflab.image.effects.hot_pixels import HotPixels
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.shot_noise import ShotNoise
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise, read_out

RESPONSE = SensorResponse(
    Quantisation(12, 0.4, 64.0), Saturation(9000.0), read_noise=ReadNoise(4.0)
)
QUIET = SensorResponse(Quantisation(16, 1.0, 0.0), None, None, None)
KEY = noise_key(1)


@pytest.mark.parametrize("level", [0.0, 0.002, 0.05, 0.3, 0.8])
def test_photon_transfer_mean_and_variance_follow_the_electrons(level: float) -> None:
    electrons = 8000.0 * level
    numbers = digitise(np.full((400, 500), level), 8000.0, RESPONSE, KEY).astype(float)
    variance = 0.4**2 * (electrons + 4.0**2) + 1 / 12
    assert numbers.mean() == pytest.approx(
        64.0 + 0.4 * electrons, abs=4 * math.sqrt(variance / numbers.size)
    )
    assert numbers.var() == pytest.approx(variance, rel=4 * math.sqrt(2 / numbers.size))


def test_neighbouring_pixels_and_frames_are_independent() -> None:
    frames = (noise_key("frame", number) for number in range(2))
    first, second = (
        digitise(np.full((300, 300), 0.4), 8000.0, RESPONSE, key).astype(float) for key in frames
    )
    for one, other in ((first[:, 1:], first[:, :-1]), (first[1:], first[:-1]), (first, second)):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / math.sqrt(one.size)


def test_a_key_depends_on_every_part_and_its_kind() -> None:
    parts = [(1, "a"), (1, "b"), (2, "a"), (1, "a", 0), ("1", "a"), (11, ""), (1, "1"), (1.0, "a")]
    keys = [noise_key(*one) for one in parts]
    assert len(set(keys)) == len(keys)
    assert noise_key(1, "a") == keys[0]


@pytest.mark.parametrize("mean", [0.5, 7.3, 8000.0])
def test_electrons_are_poisson_numbers(mean: float) -> None:
    shot = replace(QUIET, shot_noise=ShotNoise(), saturation=None)
    read = read_out(np.full((300, 300), mean / 1e4), 1e4, shot, noise_key("poisson", mean))
    wanted = np.unique(stats.poisson.ppf(np.linspace(0, 1, 100)[1:-1], mean))
    edges = np.concatenate([[-np.inf], wanted + 0.5, [np.inf]])
    expected = np.diff(np.concatenate([[0.0], stats.poisson.cdf(wanted, mean), [1.0]])) * 90_000
    assert stats.chisquare(np.histogram(read, edges)[0], expected).pvalue > 1e-5


def test_shot_and_read_noise_are_independent() -> None:
    image = np.full((300, 300), 0.4)
    shot = read_out(image, 8000.0, replace(RESPONSE, read_noise=None), KEY)
    read = read_out(image, 8000.0, replace(RESPONSE, shot_noise=None), KEY)
    both = read_out(image, 8000.0, RESPONSE, KEY)
    assert both == pytest.approx(shot + read - (64.0 + 0.4 * 3200), abs=1e-9)
    assert abs(np.corrcoef(shot.ravel(), read.ravel())[0, 1]) < 4 / math.sqrt(image.size)


def test_a_picture_depends_on_its_key_alone_and_not_on_how_the_work_is_shared_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    image = np.linspace(0, 1, 1300 * 200).reshape(200, 1300)
    response = replace(
        RESPONSE, fixed_pattern=FixedPattern(0.01, 2.0, 3), dead_pixels=DeadPixels(0.01, 4)
    )
    whole = digitise(image, 5000.0, response, KEY)
    assert not np.array_equal(whole, digitise(image, 5000.0, response, noise_key(2)))
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    assert np.array_equal(digitise(image, 5000.0, response, KEY), whole)


def test_a_pixel_saturates_at_the_full_well_or_the_largest_number() -> None:
    well = replace(QUIET, saturation=Saturation(1000.0))
    assert np.all(digitise(np.full((10, 10), 1.0), 5000.0, well, KEY) == 1000)
    number = replace(QUIET, quantisation=Quantisation(8, 1.0, 0.0), saturation=Saturation(1e6))
    assert np.all(digitise(np.full((10, 10), 1.0), 5000.0, number, KEY) == 255)
    assert np.all(read_out(np.full((10, 10), 1.0), 5000.0, number, KEY) == 5000.0)
    assert number.saturation_e == 255
    assert well.saturation_e == 1000


def test_without_noise_the_numbers_are_the_rounded_light() -> None:
    quiet = replace(QUIET, quantisation=Quantisation(12, 0.5, 10.0))
    image = np.array([[0.0, 0.1, 0.2013]])
    assert digitise(image, 1000.0, quiet, KEY).tolist() == [[10, 60, 111]]
    assert read_out(image, 1000.0, quiet, KEY) == pytest.approx(np.array([[10.0, 60.0, 110.65]]))


def test_a_dark_frame_never_falls_below_nothing() -> None:
    low = SensorResponse(Quantisation(12, 1.0, 5.0), read_noise=ReadNoise(50.0))
    numbers = digitise(np.zeros((100, 100)), 1000.0, low, KEY)
    assert numbers.min() == 0
    assert numbers.dtype == np.uint16


def test_dark_current_gathers_with_shot_noise_of_its_own() -> None:
    dark = read_out(
        np.zeros((300, 300)),
        1000.0,
        SensorResponse(
            Quantisation(16, 1.0, 0.0), None, read_noise=None, dark_current=DarkCurrent(50.0, 0.5)
        ),
        KEY,
    )
    assert dark.mean() == pytest.approx(25.0, abs=4 * math.sqrt(25 / dark.size))
    assert dark.var() == pytest.approx(25.0, rel=4 * math.sqrt(2.04 / dark.size))
    assert np.all(dark == np.rint(dark))


def test_hot_pixels_stay_where_they_are_and_gather_exponential_numbers_of_electrons() -> None:
    response = replace(QUIET, hot_pixels=HotPixels(0.1, 400.0, seed=2))
    first, again = (
        read_out(np.zeros((300, 300)), 1000.0, response, noise_key(frame)) for frame in (1, 2)
    )
    assert np.array_equal(first, again)
    hot = first[first > 0]
    assert hot.size == pytest.approx(9000, abs=4 * 90)
    assert hot.mean() == pytest.approx(400, rel=4 / math.sqrt(hot.size))
    assert np.median(hot) == pytest.approx(400 * math.log(2), rel=5 / math.sqrt(hot.size))


def test_the_fixed_pattern_stays_from_frame_to_frame_and_has_the_spreads_it_says() -> None:
    response = replace(QUIET, fixed_pattern=FixedPattern(gain=0.02, offset=3.0, seed=5))
    dark, bright = (
        read_out(np.full((300, 300), level), 10000.0, response, noise_key("any", level))
        for level in (0.0, 1.0)
    )
    gain, offset = (bright - dark) / 10000 - 1, dark
    for errors, spread in ((gain, 0.02), (offset, 3.0)):
        assert errors.mean() == pytest.approx(0.0, abs=4 * spread / 300)
        assert errors.std() == pytest.approx(spread, rel=4 / math.sqrt(2 * errors.size))
    assert abs(np.corrcoef(gain.ravel(), offset.ravel())[0, 1]) < 4 / 300
    another = replace(response, fixed_pattern=FixedPattern(gain=0.02, offset=3.0, seed=6))
    assert (
        abs(
            np.corrcoef(read_out(np.zeros((300, 300)), 1.0, another, KEY).ravel(), offset.ravel())[
                0, 1
            ]
        )
        < 4 / 300
    )


def test_dead_pixels_are_stuck_at_nothing_or_full_scale_in_every_frame() -> None:
    response = replace(RESPONSE, dead_pixels=DeadPixels(0.02, 7))
    first, second = (
        digitise(np.full((300, 300), level), 8000.0, response, noise_key(level))
        for level in (0.3, 0.5)
    )
    for stuck in (0, 4095):
        assert np.array_equal(first == stuck, second == stuck)
        assert (first == stuck).sum() == pytest.approx(900, abs=4 * math.sqrt(900))


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf])
def test_impossible_light_is_refused(bad: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        digitise(np.array([[bad]]), 1000.0, RESPONSE, KEY)
    with pytest.raises(InputError, match="electrons_at_white"):
        digitise(np.ones((1, 1)), bad, RESPONSE, KEY)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (Saturation, {"full_well": 0.0}),
        (ReadNoise, {"electrons": -1.0}),
        (Quantisation, {"bits": 17}),
        (Quantisation, {"dn_per_electron": 0.0}),
        (Quantisation, {"offset_dn": 4095.0}),
        (Quantisation, {"offset_dn": math.nan}),
        (DarkCurrent, {"electrons_per_second": -1.0, "exposure": 1.0}),
        (DarkCurrent, {"exposure": math.inf, "electrons_per_second": 1.0}),
        (FixedPattern, {"gain": 0.2}),
        (FixedPattern, {"offset": -1.0}),
        (DeadPixels, {"share": 1.5}),
    ],
)
def test_impossible_sensors_are_refused(kind: Any, change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        kind(**change)

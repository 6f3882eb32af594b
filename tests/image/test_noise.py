"""The random numbers of pixels against published answers and scipy's distributions."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy import special, stats

from flflab.image.sensor.draws import Draws, draw
from flflab.image.sensor.random_numbers import (
    EDGES,
    FAR,
    HEIGHTS,
    LARGE_MEAN,
    TAIL,
    noise_key,
    philox,
)

Array = npt.NDArray[np.float64]
SHAPE = (4, 50_000)
PIXELS = 200_000
SEEN = 1e-5  # a true distribution looks this unlikely once in 10^5 tries, and the keys are fixed


def drawn(*parts: object) -> Draws:
    return draw(SHAPE, (0, 0), noise_key(*parts))


def uniform(bits: npt.NDArray[np.uint64]) -> Array:
    return ((bits >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_known_answers_of_random123(
    counter: tuple[int, ...], key: tuple[int, ...], answer: tuple[int, ...]
) -> None:
    words = [np.uint64(word) for word in (*key, *counter[2:])]
    low, high = (
        int(pair)
        for pair in philox(
            np.uint64(counter[0]), np.uint64(counter[1]), (words[0], words[1], words[2], words[3])
        )
    )
    assert (low & 0xFFFFFFFF, low >> 32, high & 0xFFFFFFFF, high >> 32) == answer


def test_a_key_depends_on_every_part_and_its_kind() -> None:
    keys = [
        noise_key(*parts)
        for parts in [
            (1, "a"),
            (1, "b"),
            (2, "a"),
            (1, "a", 0),
            ("1", "a"),
            (11, ""),
            (1, "1"),
            (1.0, "a"),
        ]
    ]
    assert len(set(keys)) == len(keys)
    assert noise_key(1, "a") == keys[0]


def test_normal_numbers_are_normal_to_the_tail() -> None:
    for stream in (0, 1):
        numbers = drawn("normal", stream).normal(stream).ravel()
        assert stats.kstest(numbers, "norm").pvalue > SEEN
        edges = special.ndtri(np.linspace(0, 1, 401))
        assert stats.chisquare(np.histogram(numbers, edges)[0]).pvalue > SEEN
        assert numbers.var() == pytest.approx(1.0, abs=4 * math.sqrt(2 / PIXELS))
        assert np.mean(numbers**4) == pytest.approx(3.0, abs=4 * math.sqrt(96 / PIXELS))
        expected = PIXELS * math.erfc(
            TAIL / math.sqrt(2)
        )  # beyond here the ziggurat has its own rule
        assert abs(np.sum(np.abs(numbers) > TAIL) - expected) < 4 * math.sqrt(expected)


def test_beyond_the_ziggurat_the_tail_is_normal() -> None:
    beyond = np.full(SHAPE, 0xFFFFFFFFFFFFFE00, dtype=np.uint64)  # the base layer, at its far end
    numbers = replace(drawn("tail"), first=beyond).normal(0).ravel()
    assert numbers.min() > TAIL
    assert stats.kstest(special.ndtr(-numbers) / special.ndtr(-TAIL), "uniform").pvalue > SEEN


@pytest.mark.parametrize("layer", [1, 100, 254, 255])
def test_between_two_layers_the_normal_density_decides(layer: int) -> None:
    draws = drawn("layer", layer)
    bits = draws.first & np.uint64(0xFFFFFFFFFFFFFE00) | np.uint64(layer)
    numbers = replace(draws, first=bits).normal(0)
    offered = uniform(bits) * EDGES[layer]
    kept = np.sum((offered >= EDGES[layer + 1]) & (numbers == offered))
    low, high = EDGES[layer + 1], EDGES[layer]
    density = (
        math.sqrt(math.pi / 2) * (math.erf(high / math.sqrt(2)) - math.erf(low / math.sqrt(2)))
        - (high - low) * HEIGHTS[layer]
    )
    share = density / (HEIGHTS[layer + 1] - HEIGHTS[layer]) / high
    assert kept == pytest.approx(PIXELS * share, abs=4 * math.sqrt(PIXELS * share))


@pytest.mark.parametrize("mean", [0.01, 0.5, 3.0, 4.999, 5.0, 7.3, 20.5, 300.0, 1e4, 1e5])
def test_poisson_numbers_have_the_poisson_distribution(mean: float) -> None:
    numbers = drawn("poisson", mean).poisson(np.full(SHAPE, mean)).ravel()
    wanted = np.unique(stats.poisson.ppf(np.linspace(0, 1, 200)[1:-1], mean))
    edges = np.concatenate([[-np.inf], wanted + 0.5, [np.inf]])
    expected = PIXELS * np.diff(np.concatenate([[0.0], stats.poisson.cdf(wanted, mean), [1.0]]))
    assert (
        stats.chisquare(np.histogram(numbers, edges)[0], expected * PIXELS / expected.sum()).pvalue
        > SEEN
    )
    assert numbers.mean() == pytest.approx(mean, abs=4 * math.sqrt(mean / PIXELS))
    assert numbers.var() == pytest.approx(mean, abs=4 * math.sqrt((mean + 2 * mean**2) / PIXELS))
    third = np.mean((numbers - mean) ** 3)
    assert third == pytest.approx(
        mean, abs=4 * math.sqrt((15 * mean**3 + 25 * mean**2 + mean) / PIXELS)
    )


def test_every_poisson_number_is_the_quantile_of_its_uniform_number() -> None:
    means = np.exp(np.linspace(math.log(0.01), math.log(1e6), PIXELS)).reshape(SHAPE)
    draws = drawn("quantiles")
    share = np.where(means >= LARGE_MEAN, special.ndtr(draws.normal(0)), uniform(draws.first))
    assert np.array_equal(draws.poisson(means), stats.poisson.ppf(share, means))


def test_the_bound_of_the_expansion_holds_wherever_it_is_trusted() -> None:
    w = np.linspace(-FAR, FAR, 241)
    for mean in (LARGE_MEAN, 6.0, 8.0, 11.0, 20.0, 100.0, 3000.0):
        place = mean + math.sqrt(mean) * w + (2 + w**2) / 6 - (w + w**3 / 2) / 36 / math.sqrt(mean)
        place += (-8 / 405 + 7 * w**2 / 810 + w**4 / 270) / mean
        doubt = (0.025 + np.abs(w) ** 5 / 150) / mean**1.5
        low, high = (
            special.gammaincc(np.maximum(place + step, 1e-12), mean) for step in (-doubt, doubt)
        )
        upper_low, upper_high = (
            special.gammainc(np.maximum(place + step, 1e-12), mean) for step in (-doubt, doubt)
        )
        assert np.all(np.where(w < 0, low < special.ndtr(w), upper_low > special.ndtr(-w)))
        assert np.all(np.where(w < 0, high > special.ndtr(w), upper_high < special.ndtr(-w)))


def test_no_light_makes_no_electrons_and_much_light_stays_exact() -> None:
    assert not drawn("dark").poisson(np.zeros(SHAPE)).any()
    numbers = drawn("bright").poisson(np.full(SHAPE, 1e11))
    assert numbers.mean() == pytest.approx(1e11, abs=4 * math.sqrt(1e11 / PIXELS))
    assert numbers.std() == pytest.approx(math.sqrt(1e11), rel=4 / math.sqrt(2 * PIXELS))

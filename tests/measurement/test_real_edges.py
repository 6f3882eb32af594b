"""Slanted edges as real light shows them: sides that slope, a skirt of flare, little contrast; line
spreads drawn by sums, truths in closed form.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from flflab.measurement.edges.curve import FREQUENCIES as F
from flflab.measurement.edges.curve import curve_of
from flflab.measurement.edges.edge import fit_edge

Array = npt.NDArray[np.float64]
SIDE, STEP = 90, 0.02
Y, X = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
FIELD = np.hypot(X, Y) < SIDE / 2


@dataclass(frozen=True)
class Spread:
    """A Gaussian, and a share of the light in a skirt that decays over ``width`` px."""

    blur: float
    skirt: float
    width: float

    @property
    def edge(self) -> tuple[Array, Array]:
        x = np.arange(-400, 400, STEP)
        line = (1 - self.skirt) * np.exp(-0.5 * (x / self.blur) ** 2) / self.blur
        line = line / math.sqrt(2 * math.pi)
        line = line + self.skirt * np.exp(-np.abs(x) / self.width) / (2 * self.width)
        return x + STEP / 2, np.cumsum(line) / line.sum()

    def transfer(self, angle: float) -> Array:
        skirt = self.skirt / (1 + (2 * math.pi * self.width * F) ** 2)
        core = (1 - self.skirt) * np.exp(-2 * (math.pi * self.blur * F) ** 2)
        return (core + skirt) * np.abs(np.sinc(F * math.cos(angle)) * np.sinc(F * math.sin(angle)))


def drawn(
    spread: Spread, angle: float, slope: float, dark: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """One field with 1 % of noise, and the deviation of its pixels."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    t = X * math.cos(angle) + Y * math.sin(angle) - rng.uniform(-3, 3)
    lit, edge = np.zeros_like(t), spread.edge
    for u, v in np.ndindex(5, 5):
        away = t + nodes[u] / 2 * math.cos(angle) + nodes[v] / 2 * math.sin(angle)
        lit += weights[u] * weights[v] / 4 * np.interp(away, *edge)
    turn = rng.uniform(0, 2 * math.pi)
    light = 1 + slope * (X * math.cos(turn) + Y * math.sin(turn)) / SIDE
    picture = (dark + (1 - dark) * lit) * light
    deviation = 0.01 * np.sqrt(picture)
    return picture + deviation * rng.standard_normal(picture.shape), deviation


def measured(
    spread: Spread, degrees: float, slope: float, dark: float, seed: int
) -> tuple[Array, Array, Array]:
    """Transfer of five fields together, its uncertainty, and the truth."""
    rng, angle = np.random.default_rng(seed), math.radians(degrees)
    fields = [drawn(spread, angle, slope, dark, rng) for _ in range(5)]
    curve = curve_of([fit_edge(one, FIELD, deviation) for one, deviation in fields])
    return curve.mtf, curve.uncertainty, spread.transfer(angle)


def within(mean: Array, doubt: Array, truth: Array) -> npt.NDArray[np.bool_]:
    off = np.abs(mean - truth)
    return (off < 2 * doubt) | (off < 0.01)


def test_sides_that_slope_leave_the_transfer_as_it_is() -> None:
    """A slope of 10 % across made it 0.1 wrong."""
    mean, doubt, truth = measured(Spread(0.65, 0.0, 1.0), 5.0, 0.1, 0.05, 1)
    assert np.abs(mean - truth).max() < 0.005
    assert doubt.max() < 0.005


@pytest.mark.parametrize(("degrees", "dark"), [(2.0, 0.05), (7.0, 0.67)])
def test_a_skirt_of_flare_is_seen(degrees: float, dark: float) -> None:
    mean, doubt, truth = measured(Spread(0.65, 0.08, 20.0), degrees, 0.0, dark, 2)
    assert within(mean, doubt, truth).mean() >= 0.9
    assert doubt.max() < 0.06


def test_esfr_is_the_response_of_a_plain_edge() -> None:
    spread, angle = Spread(0.65, 0.0, 1.0), math.radians(5)
    picture, deviation = drawn(spread, angle, 0.0, 0.1, np.random.default_rng(3))
    found = curve_of([fit_edge(picture, FIELD, deviation)])
    assert np.abs(found.esfr - spread.transfer(angle))[F <= 0.4].max() < 0.03


@pytest.mark.ci
def test_edges_of_every_slope_and_skirt_are_within_what_is_stated() -> None:
    """The sizes of real pictures: slopes of 0 and 10 %, skirts of 0 and 8 % over 10 and 20 px, dark
    sides of 5 and 60 %, angles from 2 degrees.
    """
    good, rng = list[npt.NDArray[np.bool_]](), np.random.default_rng(4)
    for slope in (0.0, 0.1):
        for skirt, width in ((0.0, 1.0), (0.08, 10.0), (0.08, 20.0)):
            for dark in (0.05, 0.6):
                spread = Spread(float(rng.uniform(0.4, 1.2)), skirt, width)
                degrees, seed = float(rng.uniform(2, 20)), int(rng.integers(1 << 30))
                good.append(within(*measured(spread, degrees, slope, dark, seed)))
    assert np.mean(good) >= 0.95

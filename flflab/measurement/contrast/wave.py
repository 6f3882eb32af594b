"""A chirp of bars or of a sine seen through a pixel and a disc of blur.

Bars are averaged over the pixel exactly, by their integral, which is a broken line, and over the
disc by strips of it. A sine is multiplied by the transfer at its frequency.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.special import j1

from flflab.targets import Bars

Array = npt.NDArray[np.float64]

STRIPS = 64
TURN = np.pi * np.arange(1, STRIPS + 1) / (STRIPS + 1)
PLACES = np.cos(TURN) / 2  # of strips across a disc of diameter 1
SHARES = 2 * np.sin(TURN) ** 2 / (STRIPS + 1)  # of its light


@dataclass(frozen=True)
class Pattern:
    """A target's law of frequency.

    Attributes:
        first: cycles/mm at the left edge.
        growth: cycles/mm^2.
        left: place of that edge, mm.
        edges: places of the bars' edges, mm, the first rising, every second falling; empty for a
            sine.
        integral: of bars of amplitude 1 from the left edge to each of ``edges``, mm.
    """

    first: float
    growth: float
    left: float
    edges: Array
    integral: Array

    @property
    def bars(self) -> bool:
        """Whether it is of bars."""
        return len(self.edges) > 0

    def frequency(self, x: Array) -> Array:
        """Cycles/mm at x mm."""
        return self.first + self.growth * (x - self.left)

    def phase(self, x: Array) -> Array:
        """Cycles from the left edge to x mm."""
        return (x - self.left) * (self.first + self.growth * (x - self.left) / 2)

    def seen(self, x: Array, pixel: float, squares: Array) -> tuple[Array, Array]:
        """The target of amplitude 1 at x mm through a pixel and discs of blur, and its slope, 1/mm.

        Args:
            x: places on the target, mm, shape (n,).
            pixel: mm on the target.
            squares: of the discs' diameters there, mm^2, shape (n,).
        """
        if self.bars:
            law = (self.first, self.growth, self.left)
            discs = np.sqrt(np.maximum(squares, 0.0))
            return _bars(x, law, self.edges, self.integral, pixel, discs, PLACES, SHARES)
        nu, turn = self.frequency(x), 2 * np.pi * self.phase(x)
        left = transfer(nu, pixel, squares)
        return left * np.sin(turn), left * np.cos(turn) * 2 * np.pi * nu


def pattern_of(target: Bars) -> Pattern:
    """The target's."""
    left, right = target.cycles_per_mm
    law = left, (right - left) / target.width, -target.width / 2
    if target.kind != "bars":
        return Pattern(*law, np.zeros(0), np.zeros(0))
    edges = np.asarray(target.position(np.arange(np.floor(2 * target.cycles) + 1) / 2))
    widths = np.diff(edges) * (1.0 - 2.0 * (np.arange(len(edges) - 1) % 2))
    return Pattern(*law, edges, np.append(0.0, np.cumsum(widths)))


def transfer(frequency: Array, pixel: float, squares: Array) -> Array:
    """Of a pixel and discs of so large squares of their diameters, mm^2, at frequencies in
    cycles/mm.
    """
    z = np.pi * np.sqrt(np.maximum(squares, 0.0)) * np.abs(frequency) + 1e-9
    return np.sinc(frequency * pixel) * 2 * j1(z) / z


@numba.njit(nogil=True, cache=True)
def _integral(
    x: float, law: tuple[float, float, float], edges: Array, integral: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Integral of sharp bars up to x, and the bars there, 1 or -1."""
    along = x - law[2]
    half = int(np.floor(2.0 * along * (law[0] + law[1] * along / 2)))
    half = min(max(half, 0), len(edges) - 1)
    value = 1.0 - 2.0 * (half % 2)
    return integral[half] + value * (x - edges[half]), value


@numba.njit(nogil=True, cache=True)
def _bars(
    x: Array,
    law: tuple[float, float, float],
    edges: Array,
    integral: Array,
    pixel: float,
    discs: Array,
    places: Array,
    shares: Array,
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    seen, slope = np.zeros(len(x)), np.zeros(len(x))
    for n in range(len(x)):
        for k in range(len(places)):
            at = x[n] + discs[n] * places[k]
            right, there = _integral(at + pixel / 2, law, edges, integral)
            left, here = _integral(at - pixel / 2, law, edges, integral)
            seen[n] += shares[k] * (right - left) / pixel
            slope[n] += shares[k] * (there - here) / pixel
    return seen, slope

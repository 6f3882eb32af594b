"""Antiderivatives of a radiance that varies along x only, so that its mean over a pixel and over a chord of the pupil is exact."""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.targets import Bars, Chirp

Array = npt.NDArray[np.float64]

CELLS_PER_CYCLE = {"bars": 2, "chirp": 32}  # bars are constant in a cell, a sine is a cubic to 5e-7
NODES = np.polynomial.legendre.leggauss(4)[0]


def profile_table(target: Bars | Chirp) -> tuple[Array, Array]:
    """The radiance along x as cubics between positions of equal steps of phase.

    Returns:
        The table, one row a cell: knot (mm from the centre), then the coefficients c0..c5 of its second antiderivative in
        powers of the distance from the knot; the last row holds what lies beyond the right edge. And the law (left edge, right
        edge, frequency at the left in cells/mm, half its slope in cells/mm^2), from which the cell of a position follows.
    """
    per_cycle = CELLS_PER_CYCLE[target.kind]
    cells = math.ceil(target.cycles * per_cycle * (1 - 1e-12))
    steps = np.minimum(np.arange(cells + 1) / per_cycle, target.cycles)
    knots = target.position(steps)
    knots[0], knots[-1] = -target.width / 2, target.width / 2
    widths = np.diff(knots)
    inside = (NODES + 1) / 2
    at_nodes = target.profile(target.phase(knots[:-1, None] + widths[:, None] * inside))
    cubic = np.linalg.solve(np.vander(inside, increasing=True), at_nodes.T).T
    powers = np.arange(4)
    area = widths * (cubic / (powers + 1)).sum(axis=1)
    moment = widths**2 * (cubic / ((powers + 1) * (powers + 2))).sum(axis=1)
    first = np.concatenate([[0.0], np.cumsum(area)])
    second = np.concatenate([[0.0], np.cumsum(first[:-1] * widths + moment)])
    table = np.zeros((cells + 1, 8))
    table[:, 0], table[:, 1], table[:, 2] = knots, second, first
    table[:-1, 3:7] = cubic / widths[:, None] ** powers / ((powers + 1) * (powers + 2))
    left, right = target.cycles_per_mm
    law = np.array([knots[0], knots[-1], left * per_cycle, (right - left) * per_cycle / (2 * target.width)])
    return table, law


@numba.njit(cache=True)
def antiderivatives(x: float, table: Array, law: Array) -> tuple[float, float, float]:
    """Second antiderivative, first antiderivative and radiance at x mm."""
    if x <= law[0]:
        return 0.0, 0.0, 0.0
    last = table.shape[0] - 1
    along = x - law[0]
    cell = last if x >= law[1] else min(int(along * (law[2] + law[3] * along)), last - 1)
    c = table[cell]
    d = x - c[0]
    second = c[1] + d * (c[2] + d * (c[3] + d * (c[4] + d * (c[5] + d * c[6]))))
    first = c[2] + d * (2.0 * c[3] + d * (3.0 * c[4] + d * (4.0 * c[5] + d * 5.0 * c[6])))
    return second, first, 2.0 * c[3] + d * (6.0 * c[4] + d * (12.0 * c[5] + d * 20.0 * c[6]))


@numba.njit(cache=True)
def profile_mean(x: float, box: float, chord: float, table: Array, law: Array) -> float:
    """Mean radiance at x smoothed by two boxes of these widths (mm); below 3e-8 of the target's width a box counts as 0."""
    wide = max(box, chord)
    narrow = min(box, chord)
    least = 3e-8 * (law[1] - law[0])
    if wide < least:
        return antiderivatives(x, table, law)[2]
    high = x + 0.5 * wide
    low = x - 0.5 * wide
    if narrow < least:
        return (antiderivatives(high, table, law)[1] - antiderivatives(low, table, law)[1]) / wide
    half = 0.5 * narrow
    ends = antiderivatives(high + half, table, law)[0] - antiderivatives(high - half, table, law)[0]
    ends -= antiderivatives(low + half, table, law)[0] - antiderivatives(low - half, table, law)[0]
    return min(max(ends / (wide * narrow), 0.0), 1.0)


@numba.njit(cache=True)
def step_mean(x: float, box1: float, box2: float) -> float:
    """A step from 0 to 1 at x = 0, smoothed by two boxes of these widths."""
    outer = 0.5 * (box1 + box2)
    if x >= outer:
        return 1.0
    if x <= -outer:
        return 0.0
    inner = 0.5 * abs(box1 - box2)
    wide = max(box1, box2)
    if abs(x) <= inner:
        return 0.5 + x / wide
    narrow = min(box1, box2)
    corner = 0.5 * (outer - abs(x)) ** 2 / (wide * narrow)
    return 1.0 - corner if x > 0.0 else corner

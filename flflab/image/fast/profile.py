"""A target that varies along one direction, as a piecewise cubic with its first three integrals, so
that means and moments over one or two boxes are exact.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.targets import Bars, Chirp, Edge

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

KNOTS_A_CYCLE = 32  # of a sine: its cubics are within 2e-6
BUCKETS = 4  # a knot, for finding the piece of a place
NARROW = 1e-4  # of the wider box: a narrower one is a point


class Profile(NamedTuple):
    """Radiance along a direction; black before the first knot, the last piece without end.

    Attributes:
        pieces: for each piece, shape (K, 8): where it begins, mm; the integral of the radiance up
            to there, the integral of that, and of that; four coefficients of the radiance in powers
            of the distance from there.
        buckets: the last piece that begins at or before the start of each of as many equal parts.
        per_mm: parts to the mm.
    """

    pieces: Array
    buckets: Whole
    per_mm: float


EVEN = Profile(
    np.array([[-1e12, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]), np.zeros(1, dtype=np.int64), 1.0
)  # white everywhere


def profile_of(target: Bars | Edge) -> Profile:
    """The radiance of bars or a chirp along x, or of an edge along its normal, mm from the
    centre.
    """
    if isinstance(target, Edge):
        return _made(np.array([0.0]), np.array([[1.0, 0.0, 0.0, 0.0]]))
    half = target.width / 2
    if isinstance(target, Chirp):
        count = max(1, math.ceil(KNOTS_A_CYCLE * target.cycles))
        knots = target.position(np.linspace(0, target.cycles, count + 1))
        knots[0], knots[-1] = -half, half
        value = target.profile(target.phase(knots))
        turn = 2 * math.pi * target.phase(knots)
        slope = math.pi * np.cos(turn) * target.frequency(knots)
        step, rise = np.diff(knots), np.diff(value)
        pieces = np.zeros((count + 1, 4))
        pieces[:-1, 0], pieces[:-1, 1] = value[:-1], slope[:-1]
        pieces[:-1, 2] = (3 * rise / step - 2 * slope[:-1] - slope[1:]) / step
        pieces[:-1, 3] = (slope[:-1] + slope[1:] - 2 * rise / step) / step**2
        return _made(knots, pieces)
    borders = np.arange(math.ceil(2 * target.cycles)) / 2
    knots = np.append(target.position(borders), half)
    knots[0] = -half
    pieces = np.zeros((len(knots), 4))
    pieces[:-1:2, 0] = 1.0
    return _made(knots, pieces)


def _made(knots: Array, pieces: Array) -> Profile:
    step = np.diff(knots)[:, None] ** np.arange(1, 7)
    s, own = step[:, 0], pieces[:-1]
    once = _running((own * step[:, :4] / [1, 2, 3, 4]).sum(axis=1))
    twice = _running(once[:-1] * s + (own * step[:, 1:5] / [2, 6, 12, 20]).sum(axis=1))
    bent = (own * step[:, 2:6] / [6, 24, 60, 120]).sum(axis=1)
    thrice = _running(twice[:-1] * s + once[:-1] * s**2 / 2 + bent)
    count = BUCKETS * len(knots)
    length = max(knots[-1] - knots[0], 1e-300)
    starts = knots[0] + length * np.arange(count) / count
    buckets = np.maximum(np.searchsorted(knots, starts, side="right") - 1, 0)
    rows = np.column_stack([knots, once, twice, thrice, pieces])
    return Profile(rows, buckets.astype(np.int64), count / length)


def _running(parts: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(parts)])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def piece_at(profile: Profile, x: float) -> int:
    """Which piece a place lies in; -1 before the first."""
    pieces, last = profile.pieces, profile.pieces.shape[0] - 1
    if x < pieces[0, 0]:
        return -1
    if x >= pieces[last, 0]:
        return last
    index = profile.buckets[int((x - pieces[0, 0]) * profile.per_mm)]
    while index < last and pieces[index + 1, 0] <= x:
        index += 1
    return index


@numba.njit(cache=True, nogil=True, error_model="numpy")
def radiance(profile: Profile, x: float) -> float:
    """Radiance at a place."""
    index = piece_at(profile, x)
    if index < 0:
        return 0.0
    piece = profile.pieces[index]
    s = x - piece[0]
    return piece[4] + s * (piece[5] + s * (piece[6] + s * piece[7]))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_even(profile: Profile, index: int) -> bool:
    """Whether the radiance is the same all over a piece."""
    piece = profile.pieces[index]
    return piece[5] == 0.0 and piece[6] == 0.0 and piece[7] == 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def integrals(profile: Profile, x: float) -> tuple[float, float, float]:
    """The radiance integrated up to a place once, twice and three times."""
    index = piece_at(profile, x)
    if index < 0:
        return 0.0, 0.0, 0.0
    piece = profile.pieces[index]
    s, once, twice, thrice = x - piece[0], piece[1], piece[2], piece[3]
    a, b, c, d = piece[4], piece[5], piece[6], piece[7]
    first = a + s * (b * (1 / 2) + s * (c * (1 / 3) + s * d * (1 / 4)))
    second = a * (1 / 2) + s * (b * (1 / 6) + s * (c * (1 / 12) + s * d * (1 / 20)))
    third = a * (1 / 6) + s * (b * (1 / 24) + s * (c * (1 / 60) + s * d * (1 / 120)))
    return (
        once + s * first,
        twice + s * (once + s * second),
        thrice + s * (twice + s * (once * 0.5 + s * third)),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_and_moment(profile: Profile, x: float, box: float) -> tuple[float, float]:
    """Mean of the radiance over a box round a place, and of its product with the distance from
    there, mm.
    """
    if box <= 0.0:
        return radiance(profile, x), 0.0
    high, low = integrals(profile, x + 0.5 * box), integrals(profile, x - 0.5 * box)
    moment = 0.5 * (high[0] + low[0]) - (high[1] - low[1]) / box
    return (high[0] - low[0]) / box, moment


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_and_moment_sums(profile: Profile, x: float, box: float) -> tuple[float, float]:
    """Integrals up to a place of ``mean_and_moment``."""
    if box <= 0.0:
        return integrals(profile, x)[0], 0.0
    high, low = integrals(profile, x + 0.5 * box), integrals(profile, x - 0.5 * box)
    moment = 0.5 * (high[1] + low[1]) - (high[2] - low[2]) / box
    return (high[1] - low[1]) / box, moment


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_over_two(profile: Profile, x: float, box: float, other: float) -> tuple[float, float]:
    """``mean_and_moment`` of a box, in the mean over places in another box round x."""
    other = abs(other)
    if other <= NARROW * box or other <= 0.0:
        return mean_and_moment(profile, x, box)
    high = mean_and_moment_sums(profile, x + 0.5 * other, box)
    low = mean_and_moment_sums(profile, x - 0.5 * other, box)
    return (high[0] - low[0]) / other, (high[1] - low[1]) / other

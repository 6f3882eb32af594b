"""Transfer function of a clipped, defocused pupil for incoherent light of one wavelength: what
diffraction leaves of a sine.

The pupil P is the part of the unit disc |t| <= 1 that lies in a second disc, as in ``lens_chord``.
Its transfer function along x,

    H(s, w) = 1/|P| integral over {t: t - s/2 and t + s/2 in P} of exp(2 pi i w t_x) dt,

is the autocorrelation of P under its defocus: ``shift`` s is the frequency in units of half the
cutoff of the whole disc, and ``waves`` w the frequency times the geometric blur's radius. Along a
row of chord c round m the integral is exact, (c - s) sinc(w (c - s)) exp(2 pi i w m): the image
through a slit. As the wavelength falls, s goes to 0 and H to the mean of exp(2 pi i w t_x) over P,
the transfer function of the geometric blur. Source: H. H. Hopkins, Proc. R. Soc. A 231 (1955) 91.
"""

import math
from functools import cache

import numba
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.optics.discs import LOOSE, lens_chord, lens_rows, two_disc_area

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

WHOLE = (0.0, 0.0, 2.0)  # a second disc that clips nothing
ROWS_AT_LEAST, ROWS_PER_WAVE, ROWS_AT_MOST = 16, 7.0, 700
ROWS_STEP = 1.15  # from one number of rows to the next
TERMS = 9  # of the series of sin(pi f) / f and cos(pi f) in f^2
SINE = tuple((-1) ** k * math.pi ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(TERMS))
COSINE = tuple((-1) ** k * math.pi ** (2 * k) / math.factorial(2 * k) for k in range(TERMS))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shifted_rows(x: float, y: float, radius: float, shift: float) -> tuple[float, float]:
    """Lowest and highest row in which the pupil's chord is longer than ``shift``; empty if low >=
    high.

    The chord of two discs is the least of four lengths, one for each pair of arcs; each asks that
    two discs overlap in the row.
    """
    room = (1.0 - 0.5 * shift) * (1.0 + 0.5 * shift)
    other = (radius - 0.5 * shift) * (radius + 0.5 * shift)
    if room <= 0.0 or other <= 0.0:
        return 0.0, 0.0
    low1, high1 = lens_rows(min(x - shift, 0.0), y, radius)
    low2, high2 = lens_rows(max(x + shift, 0.0), y, radius)
    if low1 >= high1 or low2 >= high2:
        return 0.0, 0.0
    low = max(max(low1, low2), max(-math.sqrt(room), y - math.sqrt(other)))
    high = min(min(high1, high2), min(math.sqrt(room), y + math.sqrt(other)))
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def corner_rows(x: float, y: float, radius: float) -> tuple[float, float]:
    """The rows of the corners at which the two circles cross, the lower first, where the chord has
    kinks; beyond all rows without any.
    """
    distance = math.hypot(x, y)
    if distance + 1.0 <= radius or distance + radius <= 1.0:
        return -2.0, -2.0
    along = (1.0 + (distance - radius) * (distance + radius)) / (2.0 * distance)
    across = math.sqrt(max(0.0, 1.0 - along * along))
    one, two = (along * y + across * x) / distance, (along * y - across * x) / distance
    return min(one, two), max(one, two)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def way_of_ends(x: float, y: float, radius: float, start: float, end: float) -> float:
    """How far the chord's left or right end, whichever moves more, moves to and fro from one row to
    another with no corner between.
    """
    lower, upper = (
        min(max(min(y, 0.0), start), end),
        min(max(max(y, 0.0), start), end),
    )  # where the circles are widest
    left, right = lens_chord(x, y, radius, start)
    of_left, of_right = 0.0, 0.0
    for row in (lower, upper, end):
        next_left, next_right = lens_chord(x, y, radius, row)
        of_left += abs(next_left - left)
        of_right += abs(next_right - right)
        left, right = next_left, next_right
    return max(of_left, of_right)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def piece_transfer(
    x: float,
    y: float,
    radius: float,
    shift: float,
    waves: float,
    start: float,
    end: float,
    nodes: Array,
    count: int,
) -> tuple[float, float]:
    """The part of H times the pupil's area that comes from the rows between two; without a branch,
    so that vectors can be used.

    The sine and cosine of pi v are those of pi f with f = v - n, n the nearest whole number, times
    (-1)^n; both by Taylor's series, to 1e-12.
    """
    real, imaginary = 0.0, 0.0
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    for index in range(count):
        row = middle + half * nodes[0, index]
        one, other = (
            math.sqrt(max(0.0, 1.0 - row * row)),
            math.sqrt(max(0.0, (radius - (row - y)) * (radius + (row - y)))),
        )
        left, right = max(-one, x - other), min(one, x + other)
        kept = max(right - left - shift, 0.0)
        v = max(abs(waves * kept), 1e-30)
        n = math.floor(v + 0.5)
        f = v - n
        sign = 1.0 - 2.0 * (n - 2.0 * math.floor(0.5 * n))
        weight = (
            half * nodes[1, index] * kept * sign * f * power_series(f * f, SINE) / (math.pi * v)
        )
        v = waves * (left + right)
        n = math.floor(v + 0.5)
        f = v - n
        weight *= 1.0 - 2.0 * (n - 2.0 * math.floor(0.5 * n))
        real += weight * power_series(f * f, COSINE)
        imaginary += weight * f * power_series(f * f, SINE)
    return real, imaginary


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def power_series(z: float, terms: tuple[float, ...]) -> float:
    """The sum of the terms times the powers of z from 0 up."""
    total = 0.0
    for k in range(TERMS - 1, -1, -1):
        total = total * z + terms[k]
    return total


@cache
def row_nodes(count: int) -> Array:
    """Rows and weights on (-1, 1) for functions with roots at both ends, shape (2, n)."""
    places, weights = np.polynomial.legendre.leggauss(count)
    return np.stack([np.sin(np.pi / 2 * places), weights * np.pi / 2 * np.cos(np.pi / 2 * places)])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _transfers(
    x: Array,
    y: Array,
    radius: Array,
    shift: Array,
    waves: Array,
    least: int,
    counts: npt.NDArray[np.int64],
    nodes: Array,
    real: Array,
    imaginary: Array,
) -> None:
    """H for every pupil: in the rows between corners, with as many rows as the waves across them
    need.
    """
    area, first, second = 0.0, 0.0, 0.0
    for index in range(shift.size):
        if (
            index == 0
            or x[index] != x[index - 1]
            or y[index] != y[index - 1]
            or radius[index] != radius[index - 1]
        ):
            area = two_disc_area(1.0, radius[index], math.hypot(x[index], y[index]))
            first, second = corner_rows(x[index], y[index], radius[index])
        real[index], imaginary[index] = 0.0, 0.0
        low, high = shifted_rows(x[index], y[index], radius[index], shift[index])
        if area <= 0.0 or low >= high:
            continue
        for piece in range(3):
            start = low if piece == 0 else min(max(first if piece == 1 else second, low), high)
            end = high if piece == 2 else min(max(first if piece == 0 else second, low), high)
            if end - start <= 0.0:
                continue
            across = (
                0.5 * abs(waves[index]) * way_of_ends(x[index], y[index], radius[index], start, end)
            )
            level = 0
            while level < counts.size - 1 and counts[level] < least + ROWS_PER_WAVE * across:
                level += 1
            part = piece_transfer(
                x[index],
                y[index],
                radius[index],
                shift[index],
                waves[index],
                start,
                end,
                nodes[level],
                counts[level],
            )
            real[index] += part[0] / area
            imaginary[index] += part[1] / area


def pupil_transfer(
    shift: npt.ArrayLike,
    waves: npt.ArrayLike,
    clip_x: npt.ArrayLike = 0.0,
    clip_y: npt.ArrayLike = 0.0,
    clip_radius: npt.ArrayLike = 2.0,
    rows: int = ROWS_AT_LEAST,
) -> ComplexArray:
    """H(s, w) along x of a disc clipped by another, element by element of broadcast arrays.

    Args:
        shift: frequency over half the cutoff, from 0 up; from 2 up nothing is left.
        waves: frequency times the radius of the geometric blur, signed.
        clip_x: centre of the clipping disc in radii of the pupil, against the direction of the
            frequency.
        clip_y: the same across it.
        clip_radius: its radius; centre 0 and a radius from 1 up clip nothing.
        rows: over how many each piece of the pupil is summed where there is no defocus; 16 leave
            2e-7, 10 leave 5e-6.

    Returns:
        Complex transfer: image of exp(2 pi i nu x) over the object's, 1 at frequency 0.

    Raises:
        InputError: a number is not finite, or a shift or radius is negative.
    """
    given = np.broadcast_arrays(
        *(
            np.asarray(part, dtype=np.float64)
            for part in (clip_x, clip_y, clip_radius, shift, waves)
        )
    )
    for name, part in zip(
        ("clip_x", "clip_y", "clip_radius", "shift", "waves"), given, strict=True
    ):
        if not np.all(np.isfinite(part)) or (name in ("clip_radius", "shift") and np.any(part < 0)):
            raise InputError(
                f"pupil_transfer: {name} holds a negative or not finite number; finite ones are"
                " due, shift and radius from 0 up"
            )
    x, y, radius, shifts, defocus = (np.array(part).ravel() for part in given)
    real, imaginary = np.empty(x.size), np.empty(x.size)
    most = rows + ROWS_PER_WAVE * float(np.max(np.abs(defocus), initial=0.0))
    counts = [rows]
    while counts[-1] < min(most, ROWS_AT_MOST):
        counts.append(min(math.ceil(ROWS_STEP * counts[-1]), ROWS_AT_MOST))
    nodes = np.zeros((len(counts), 2, counts[-1]))
    for level, count in zip(nodes, counts, strict=True):
        level[:, :count] = row_nodes(count)
    _transfers(x, y, radius, shifts, defocus, rows, np.array(counts), nodes, real, imaginary)
    return (real + 1j * imaginary).reshape(given[0].shape)

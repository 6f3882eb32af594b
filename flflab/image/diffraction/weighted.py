"""Transfer functions of pupils weighted by polynomials of their places, at the nodes of a
``TransferTable``.
"""

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.shading import ODD, WEIGHTS
from flflab.image.diffraction.table import BLOCK, TransferTable
from flflab.optics.diffraction import (
    COSINE,
    ROWS_AT_MOST,
    ROWS_PER_WAVE,
    ROWS_STEP,
    SINE,
    corner_rows,
    power_series,
    row_nodes,
    shifted_rows,
    way_of_ends,
)
from flflab.optics.discs import LOOSE

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Whole = npt.NDArray[np.int64]
Moments = tuple[float, float, float, float, float, float, float, float, float, float, float, float]

ROWS = 12  # of the pupil, where there is no defocus
SERIES = 0.3  # radians; below, sums over a row are series
SMALL = 1e-4  # shift at which a tail is found


def weighted_values(table: TransferTable) -> tuple[ComplexArray, Array]:
    """Share times transfer for all of Zernike's polynomials but the first, and tails; see
    ``shading``.

    Returns:
        Shapes (5, R, A, F) and (5, R, A), as ``values`` and ``tails`` of the table.
    """
    kind, count, angles = table.kind, table.values.shape[2], len(table.angles)
    clip, clip_radius = table.radii / kind.slope, kind.reach / kind.slope
    shift = (1 - np.cos(np.linspace(0, np.pi, count))) * table.band / kind.cutoff
    waves, half = kind.blur * kind.cutoff / 2 * shift, table.angles[: (angles + 1) // 2]
    blocks = [*np.array_split(np.arange(count), math.ceil(count / BLOCK))]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = list(
            pool.map(lambda some: _at(shift[some], waves[some], clip, half, clip_radius), blocks)
        )
    near = _at(np.array([0.0, SMALL]), np.zeros(2), clip, half, clip_radius)
    values = np.concatenate([*parts, (near[..., :1] - near[..., 1:]) / SMALL], axis=3)
    mirrored = values[:, :, : angles // 2][
        :, :, ::-1
    ].conj()  # of mirrored pupils, in which u changes its sign
    mirrored[ODD - 1 :] *= -1
    values = np.concatenate([values, mirrored], axis=2)
    return values[..., :-1], np.asarray(
        values[..., -1].real / (math.pi**2 * kind.cutoff), dtype=np.float64
    )


def _at(shift: Array, waves: Array, clip: Array, angles: Array, clip_radius: float) -> ComplexArray:
    counts = [ROWS]
    while counts[-1] < min(ROWS + ROWS_PER_WAVE * float(np.abs(waves).max()), ROWS_AT_MOST):
        counts.append(min(math.ceil(ROWS_STEP * counts[-1]), ROWS_AT_MOST))
    nodes = np.zeros((len(counts), 2, counts[-1]))
    for level, count in zip(nodes, counts, strict=True):
        level[:, :count] = row_nodes(count)
    found = np.zeros((WEIGHTS - 1, len(clip), len(angles), len(shift)), dtype=np.complex128)
    _fill(found, shift, waves, clip, angles, clip_radius, np.array(counts), nodes)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill(
    found: ComplexArray,
    shift: Array,
    waves: Array,
    clip: Array,
    angles: Array,
    radius: float,
    counts: Whole,
    nodes: Array,
) -> None:
    """Fill in the integrals over {p: p - s/2 and p + s/2 in the pupil} of a weight's mean at both
    times exp(2 pi i w p_x), over pi.
    """
    for i in range(clip.size):
        for j in range(angles.size):
            cos, sin = math.cos(angles[j]), math.sin(angles[j])
            x, y = clip[i] * cos, clip[i] * sin
            first, second = corner_rows(x, y, radius)
            for k in range(shift.size):
                low, high = shifted_rows(x, y, radius, shift[k])
                if low >= high:
                    continue
                unit, along, across, square, product, across_square = 0j, 0j, 0j, 0j, 0j, 0j
                for piece in range(3):
                    start = (
                        low if piece == 0 else min(max(first if piece == 1 else second, low), high)
                    )
                    end = (
                        high if piece == 2 else min(max(first if piece == 0 else second, low), high)
                    )
                    if end - start <= 0.0:
                        continue
                    needed, level = (
                        ROWS
                        + ROWS_PER_WAVE
                        * 0.5
                        * abs(waves[k])
                        * way_of_ends(x, y, radius, start, end),
                        0,
                    )
                    while level < counts.size - 1 and counts[level] < needed:
                        level += 1
                    part = _piece_moments(
                        x, y, radius, shift[k], waves[k], start, end, nodes[level], counts[level]
                    )
                    unit += complex(part[0], part[1])
                    along += complex(part[2], part[3])
                    across += complex(part[4], part[5])
                    square += complex(part[6], part[7])
                    product += complex(part[8], part[9])
                    across_square += complex(part[10], part[11])
                found[0, i, j, k] = cos * along + sin * across
                found[1, i, j, k] = 2.0 * (square + across_square) - unit
                found[2, i, j, k] = (cos * cos - sin * sin) * (
                    square - across_square
                ) + 4.0 * cos * sin * product
                found[3, i, j, k] = cos * across - sin * along
                found[4, i, j, k] = (
                    cos * sin * (across_square - square) + (cos * cos - sin * sin) * product
                )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def _piece_moments(
    x: float,
    y: float,
    radius: float,
    shift: float,
    waves: float,
    start: float,
    end: float,
    nodes: Array,
    count: int,
) -> Moments:
    """Real and imaginary parts of the means of 1, p_x, p_y, p_x^2, p_x p_y and p_y^2 in the rows
    between two; as ``piece_transfer``.

    With z = pi w times a row's length 2 h its own integrals are 2 h sin z / z, of x sin 2 h^2 (sin
    z / z - cos z) / z, and of x^2 cos 2 h^3 (sin z / z + 2 (cos z - sin z / z) / z^2); for small z
    by series.
    """
    one_r, one_i, x_r, x_i, y_r, y_i, xx_r, xx_i, xy_r, xy_i, yy_r, yy_i = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    middle_row, half = 0.5 * (start + end), 0.5 * (end - start)
    for index in range(count):
        row = middle_row + half * nodes[0, index]
        one, other = (
            math.sqrt(max(0.0, 1.0 - row * row)),
            math.sqrt(max(0.0, (radius - (row - y)) * (radius + (row - y)))),
        )
        left, right = max(-one, x - other), min(one, x + other)
        h, middle = 0.5 * max(right - left - shift, 0.0), 0.5 * (left + right)
        sin, cos = _turn(2.0 * waves * h)
        z = 2.0 * math.pi * waves * h
        q, safe = z * z, (z if abs(z) > SERIES else 1.0)
        ratio = sin / safe
        small = abs(z) <= SERIES
        even = 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)) if small else ratio
        odd = (
            z * (1.0 / 3.0 - q / 30.0 * (1.0 - q / 28.0 * (1.0 - q / 54.0)))
            if small
            else (ratio - cos) / safe
        )
        second = (
            1.0 / 3.0 - q / 10.0 + q * q / 168.0 - q * q * q / 6480.0
            if small
            else ratio + 2.0 * (cos - ratio) / (safe * safe)
        )
        weight = half * nodes[1, index] / math.pi * 2.0 * h
        even, odd, second = weight * even, weight * h * odd, weight * h * h * second
        sine, cosine = _turn(2.0 * waves * middle)
        by_x, by_x_aside = (
            middle * even,
            odd,
        )  # of exp(2 pi i w x) round the middle: odd parts are imaginary
        squared = middle * middle * even + second + 0.25 * shift * shift * even
        one_r += even * cosine
        one_i += even * sine
        along_r, along_i = by_x * cosine - by_x_aside * sine, by_x * sine + by_x_aside * cosine
        x_r += along_r
        x_i += along_i
        y_r += row * even * cosine
        y_i += row * even * sine
        xx_r += squared * cosine - 2.0 * middle * odd * sine
        xx_i += squared * sine + 2.0 * middle * odd * cosine
        xy_r += row * along_r
        xy_i += row * along_i
        yy_r += row * row * even * cosine
        yy_i += row * row * even * sine
    return one_r, one_i, x_r, x_i, y_r, y_i, xx_r, xx_i, xy_r, xy_i, yy_r, yy_i


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE, inline="always")
def _turn(v: float) -> tuple[float, float]:
    """Sine and cosine of pi v without a branch, to 1e-12; see ``piece_transfer``."""
    n = math.floor(v + 0.5)
    f = v - n
    sign = 1.0 - 2.0 * (n - 2.0 * math.floor(0.5 * n))
    return sign * f * power_series(f * f, SINE), sign * power_series(f * f, COSINE)

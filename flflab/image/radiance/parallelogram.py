"""A pixel on a target is a parallelogram: its area within a disc, and the integrals of bars and
pictures over it, all exact.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.radiance.profile import first_mean, second_antiderivative
from flflab.optics.discs import side_area

Array = npt.NDArray[np.float64]

ASKEW = 1e-3  # of a side's length: less along the other axis is none
# cells of a profile: a side that leads less far aside is summed cell by cell, as a difference over
# its way loses digits
FEW = 16.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def stands_askew(by: Array) -> bool:
    """Whether the sides of a pixel run askew to the target's axes, by the maps of pupil and pixel,
    row by row in one.
    """
    for k in (4, 6):
        if min(abs(by[k]), abs(by[k + 1])) > ASKEW * max(abs(by[k]), abs(by[k + 1])):
            return abs(by[4] * by[7] - by[5] * by[6]) > ASKEW * math.hypot(
                by[4], by[6]
            ) * math.hypot(by[5], by[7])
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def disc_parallelogram_area(
    radius: float, x: float, y: float, ux: float, uy: float, vx: float, vy: float
) -> float:
    """Area common to a disc round the origin and the parallelogram round (x, y) with the sides u
    and v.
    """
    reach = 0.5 * (math.hypot(ux, uy) + math.hypot(vx, vy))
    away = math.hypot(x, y)
    if away >= radius + reach:
        return 0.0
    if away + reach <= radius:
        return abs(ux * vy - vx * uy)
    ax, ay = x - 0.5 * (ux + vx), y - 0.5 * (uy + vy)
    area = 0.0
    for side in range(4):
        along_x, along_y = (ux, uy) if side % 2 == 0 else (vx, vy)
        if side >= 2:
            along_x, along_y = -along_x, -along_y
        length = math.hypot(along_x, along_y)
        beside = (ax * along_y - ay * along_x) / length
        begin = (ax * along_x + ay * along_y) / length
        area += side_area(beside, begin + length, radius) - side_area(beside, begin, radius)
        ax, ay = ax + along_x, ay + along_y
    return abs(area)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_parallelogram(
    x: float,
    y: float,
    ux: float,
    uy: float,
    vx: float,
    vy: float,
    lower: float,
    upper: float,
    table: Array,
    law: Array,
) -> float:
    """Integral over the parallelogram round (x, y) with the sides u and v of what varies along x,
    between two ends along y; mm.

    As in ``parallelogram_sum``; the ends themselves, of no height, add nothing.
    """
    ax, ay = x - 0.5 * (ux + vx), y - 0.5 * (uy + vy)
    total = 0.0
    for side in range(4):
        dx, dy = (ux, uy) if side % 2 == 0 else (vx, vy)
        if side >= 2:
            dx, dy = -dx, -dy
        if dy != 0.0:
            one, other = (lower - ay) / dy, (upper - ay) / dy
            begin, end = min(max(min(one, other), 0.0), 1.0), min(max(max(one, other), 0.0), 1.0)
            left, right = ax + begin * dx, ax + end * dx
            if abs(right - left) * (law[2] + 2.0 * law[3] * (left - law[0])) > FEW:
                mean = (
                    second_antiderivative(right, table, law)
                    - second_antiderivative(left, table, law)
                ) / (right - left)
            else:
                mean = first_mean(left, right, table, law)
            total += (end - begin) * dy * mean
        ax, ay = ax + dx, ay + dy
    return abs(total)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def parallelogram_sum(
    x: float, y: float, ux: float, uy: float, vx: float, vy: float, sums: Array
) -> float:
    """Integral of a picture, from its summed-area table, over the parallelogram round (x, y) with
    the sides u and v, all in texels.

    By Green's theorem it is the integral round the border of what lies left of it in its row:
    linear in x and the same all over the row, so that its middle between two borders of texels
    stands for all of the piece.
    """
    ax, ay = x - 0.5 * (ux + vx), y - 0.5 * (uy + vy)
    total = _left_of(ax, ay, ux, uy, sums) + _left_of(ax + ux, ay + uy, vx, vy, sums)
    total += _left_of(ax + ux + vx, ay + uy + vy, -ux, -uy, sums) + _left_of(
        ax + vx, ay + vy, -vx, -vy, sums
    )
    return abs(total)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _left_of(x: float, y: float, dx: float, dy: float, sums: Array) -> float:
    """What lies left of a side that runs from (x, y) by (dx, dy), integrated over its height."""
    rows, columns = sums.shape[0] - 1, sums.shape[1] - 1
    if dy == 0.0:
        return 0.0
    column = max(math.floor(x) + 1, 0) if dx > 0.0 else min(math.ceil(x) - 1, columns)
    row = max(math.floor(y) + 1, 0) if dy > 0.0 else min(math.ceil(y) - 1, rows)
    total, begin = 0.0, 0.0
    while begin < 1.0:
        across = (column - x) / dx if dx != 0.0 and 0 <= column <= columns else 2.0
        up = (row - y) / dy if 0 <= row <= rows else 2.0
        end = min(1.0, across, up)
        middle = 0.5 * (begin + end)
        total += (end - begin) * _row_sum(x + middle * dx, y + middle * dy, sums)
        if across <= end:
            column += 1 if dx > 0.0 else -1
        if up <= end:
            row += 1 if dy > 0.0 else -1
        begin = end
    return total * dy


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _row_sum(column: float, row: float, sums: Array) -> float:
    """What lies left of a place in its row of texels."""
    if row <= 0.0 or row >= sums.shape[0] - 1.0:
        return 0.0
    column = min(max(column, 0.0), sums.shape[1] - 1.0)
    i, j = min(int(column), sums.shape[1] - 2), int(row)
    u = column - i
    return (1.0 - u) * (sums[j + 1, i] - sums[j, i]) + u * (sums[j + 1, i + 1] - sums[j, i + 1])

"""Mean radiance of dots and pictures in a neighbourhood whose sides run askew to the target's axes.

The larger of its two parallelograms, of the part of the pixel and of the cell of the pupil, is taken exactly; four places stand for the
other and for movement, with their variances.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.neighbourhood import PICTURE
from flflab.optics.discs import side_area

Array = npt.NDArray[np.float64]

ASKEW = 1e-3  # of a side's length: less along the other axis is none
SLIGHT = 1e-3  # of the larger parallelogram: what is left out of a neighbourhood


@numba.njit(cache=True, nogil=True, error_model="numpy")
def stands_askew(by: Array) -> bool:
    """Whether the sides of a pixel on the target, of its maps, run askew to the target's axes."""
    for k in (4, 6):
        if min(abs(by[k]), abs(by[k + 1])) > ASKEW * max(abs(by[k]), abs(by[k + 1])):
            return abs(by[4] * by[7] - by[5] * by[6]) > ASKEW * math.hypot(by[4], by[6]) * math.hypot(by[5], by[7])
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def radiance_askew(
    x: float,
    y: float,
    by: Array,
    boxes: Array,
    parts: int,
    width: float,
    height: float,
    kind: int,
    numbers: Array,
    sums: Array,
) -> float:
    """Mean radiance of dots or a picture round (x, y), for a part of a pixel and a cell of the pupil, by the maps of both.

    What the target moves meanwhile is in ``boxes`` from the fifth on.
    """
    ux, uy, vx, vy = by[4] / parts, by[6] / parts, by[5] / parts, by[7] / parts
    ax, ay, bx, by_ = by[0] * width, by[2] * width, by[1] * height, by[3] * height
    if abs(ax * by_ - bx * ay) > abs(ux * vy - vx * uy):
        ux, uy, vx, vy, ax, ay, bx, by_ = ax, ay, bx, by_, ux, uy, vx, vy
    across = (ax * ax + bx * bx + boxes[4] ** 2 + boxes[5] ** 2) / 12.0
    up = (ay * ay + by_ * by_ + boxes[6] ** 2 + boxes[7] ** 2) / 12.0
    both = (ax * ay + bx * by_ + boxes[4] * boxes[6] + boxes[5] * boxes[7]) / 12.0
    if across + up <= SLIGHT * SLIGHT * (ux * ux + uy * uy + vx * vx + vy * vy) / 12.0:
        return _mean_over(x, y, ux, uy, vx, vy, kind, numbers, sums)
    first_x = math.sqrt(across)
    first_y = both / first_x if first_x > 0.0 else 0.0
    second_y = math.sqrt(max(0.0, up - first_y * first_y))
    total = 0.0
    for one in (-1.0, 1.0):
        for other in (-1.0, 1.0):
            total += _mean_over(x + one * first_x, y + one * first_y + other * second_y, ux, uy, vx, vy, kind, numbers, sums)
    return 0.25 * total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mean_over(x: float, y: float, ux: float, uy: float, vx: float, vy: float, kind: int, numbers: Array, sums: Array) -> float:
    area = abs(ux * vy - vx * uy)
    if kind == PICTURE:
        size = numbers[0]
        column, row = x / size + 0.5 * (sums.shape[1] - 1), y / size + 0.5 * (sums.shape[0] - 1)
        return parallelogram_sum(column, row, ux / size, uy / size, vx / size, vy / size, sums) * size * size / area
    total = 0.0
    for i in (-1.0, 1.0):
        for j in (-1.0, 1.0):
            total += disc_parallelogram_area(numbers[0], x - i * numbers[1], y - j * numbers[1], ux, uy, vx, vy)
    return total / area


@numba.njit(cache=True, nogil=True, error_model="numpy")
def disc_parallelogram_area(radius: float, x: float, y: float, ux: float, uy: float, vx: float, vy: float) -> float:
    """Area common to a disc round the origin and the parallelogram round (x, y) with the sides u and v."""
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
def parallelogram_sum(x: float, y: float, ux: float, uy: float, vx: float, vy: float, sums: Array) -> float:
    """Integral of a picture, from its summed-area table, over the parallelogram round (x, y) with the sides u and v, all in texels.

    By Green's theorem it is the integral round the border of what lies left of it in its row: linear in x and the same all over the row,
    so that its middle between two borders of texels stands for all of the piece.
    """
    ax, ay = x - 0.5 * (ux + vx), y - 0.5 * (uy + vy)
    total = _left_of(ax, ay, ux, uy, sums) + _left_of(ax + ux, ay + uy, vx, vy, sums)
    total += _left_of(ax + ux + vx, ay + uy + vy, -ux, -uy, sums) + _left_of(ax + vx, ay + vy, -vx, -vy, sums)
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

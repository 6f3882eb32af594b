"""Mean radiance of dots, bars and pictures in a neighbourhood whose sides run askew to the target's
axes.

The larger of its two parallelograms, of the part of the pixel and of the cell of the pupil, is
taken exactly; four places stand for the other and for movement, with their variances.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.radiance.neighbourhood import DISC, PICTURE, RULED
from flflab.image.radiance.parallelogram import (
    disc_parallelogram_area,
    parallelogram_sum,
    ruled_parallelogram,
)

Array = npt.NDArray[np.float64]

SLIGHT = 1e-3  # of the larger parallelogram: what is left out of a neighbourhood


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
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean radiance of dots, bars or a picture round (x, y), for a part of a pixel and a cell of
    the pupil, by the maps of both.

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
        return mean_over(x, y, ux, uy, vx, vy, kind, numbers, table, law, sums)
    first_x = math.sqrt(across)
    first_y = both / first_x if first_x > 0.0 else 0.0
    second_y = math.sqrt(max(0.0, up - first_y * first_y))
    total = 0.0
    for one in (-1.0, 1.0):
        for other in (-1.0, 1.0):
            total += mean_over(
                x + one * first_x,
                y + one * first_y + other * second_y,
                ux,
                uy,
                vx,
                vy,
                kind,
                numbers,
                table,
                law,
                sums,
            )
    return 0.25 * total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_over(
    x: float,
    y: float,
    ux: float,
    uy: float,
    vx: float,
    vy: float,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean radiance over the parallelogram round (x, y) with the sides u and v; kinds and numbers
    as ``described``, or a disc's radius.
    """
    area = abs(ux * vy - vx * uy)
    if kind == PICTURE:
        size = numbers[0]
        column, row = x / size + 0.5 * (sums.shape[1] - 1), y / size + 0.5 * (sums.shape[0] - 1)
        return (
            parallelogram_sum(column, row, ux / size, uy / size, vx / size, vy / size, sums)
            * size
            * size
            / area
        )
    if kind == RULED:
        return ruled_parallelogram(x, y, ux, uy, vx, vy, -numbers[0], numbers[0], table, law) / area
    if kind == DISC:
        return disc_parallelogram_area(numbers[0], x, y, ux, uy, vx, vy) / area
    total = 0.0
    for i in (-1.0, 1.0):
        for j in (-1.0, 1.0):
            total += disc_parallelogram_area(
                numbers[0], x - i * numbers[1], y - j * numbers[1], ux, uy, vx, vy
            )
    return total / area

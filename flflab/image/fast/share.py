"""Vignetting: how much of a microlens's full cone reaches a pixel, exactly at a point and as a
table of means over a pixel.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.optics.discs import disc_rectangle_area, two_disc_area

Array = npt.NDArray[np.float64]

STEPS = 512  # of a table
# Gauss's points a side of a pixel, of the side, over which a table's entries are means.
PLACES = (-math.sqrt(0.15), 0.0, math.sqrt(0.15))
WEIGHTS = (5 / 18, 8 / 18, 5 / 18)
PARTS = 4  # of a pixel's side, where its vignetting edge is narrow
STEEP = 6.0  # pixels; where the vignetting edge is narrower, the share is no function of distance
SIDEWAYS = math.radians(22.5)  # half-way between a pixel's side and its diagonal


@numba.njit(cache=True, nogil=True, error_model="numpy")
def share_at(ex: float, ey: float, slope: float, reach: float) -> float:
    """Share of the full cone at a sensor point, mm from the micro-image's centre."""
    away = math.sqrt(ex * ex + ey * ey)
    wide = abs(slope)
    if away <= reach - wide:
        return 1.0
    if away >= reach + wide:
        return 0.0
    return two_disc_area(1.0, reach / wide, away / wide) / math.pi


@numba.njit(cache=True, nogil=True, error_model="numpy")
def share_in(ex: float, ey: float, side: float, slope: float, reach: float) -> float:
    """Mean share over a square round a point; where the vignetting edge is narrower than the
    square, the part of the square within the edge's middle.
    """
    half = 0.5 * side
    if half <= 0.0 or 2 * abs(slope) > side:
        return share_at(ex, ey, slope, reach)
    return disc_rectangle_area(reach, ex - half, ex + half, ey - half, ey + half) / (side * side)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def share_over(ex: float, ey: float, side: float, slope: float, reach: float) -> float:
    """Mean share over a pixel round a point, of its parts."""
    if math.sqrt(ex * ex + ey * ey) + side <= reach - abs(slope):
        return 1.0
    parts = 2 if 2 * abs(slope) >= STEEP * side else PARTS
    part, total = side / parts, 0.0
    for row in range(parts):
        y = ey + part * (row + 0.5 - 0.5 * parts)
        for column in range(parts):
            x = ex + part * (column + 0.5 - 0.5 * parts)
            total += share_in(x, y, part, slope, reach)
    return total / (parts * parts)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def look_up(table: Array, squared: float) -> float:
    """Share at a squared distance (mm^2) from the centre, from a table of ``share_table``."""
    place = min(max((math.sqrt(squared) - table[0]) * table[1], 0.0), float(table.size - 3))
    index = min(int(place), table.size - 4)
    part = place - index
    return table[index + 2] * (1.0 - part) + table[index + 3] * part


@numba.njit(cache=True, nogil=True, error_model="numpy")
def slope_of(table: Array, squared: float) -> float:
    """Change of the share with the squared distance, per mm^2."""
    away = math.sqrt(squared)
    place = (away - table[0]) * table[1]
    if place <= 0.0 or place >= table.size - 3 or away <= 0.0:
        return 0.0
    index = int(place)
    return (table[index + 3] - table[index + 2]) * table[1] / (2 * away)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def share_table(slope: float, reach: float, pixel: float) -> Array:
    """Share against the distance: its start (mm), 1 / step, then the means over a
    pixel.
    """
    wide = abs(slope)
    points = np.empty(2 * STEPS + 3)
    points[0] = max(0.0, reach - wide)
    points[1] = 2 * STEPS / max(reach + wide - points[0], 1e-300)
    for index in range(2 * STEPS + 1):
        points[index + 2] = share_at(points[0] + index / points[1], 0.0, slope, reach)
    if pixel <= 0.0:
        return points
    table = np.empty(STEPS + 3)
    table[0] = max(0.0, reach - wide - pixel)
    table[1] = STEPS / (reach + wide + pixel - table[0])
    for index in range(STEPS + 1):
        away = table[0] + index / table[1]
        x, y = away * math.cos(SIDEWAYS), away * math.sin(SIDEWAYS)
        total = 0.0
        for row in range(len(PLACES)):
            up = y + pixel * PLACES[row]
            for column in range(len(PLACES)):
                across = x + pixel * PLACES[column]
                seen = look_up(points, across * across + up * up)
                total += WEIGHTS[row] * WEIGHTS[column] * seen
        table[index + 2] = total
    return table

"""Natural fall-off where blur does not matter: the mean of cos^4 of the slopes of a sensor point's
rays, and tables of it.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.clipping import SLIVER
from flflab.image.geometry.rim import inside

Array = npt.NDArray[np.float64]

ACROSS = math.sqrt(0.6)  # of half a chord, where Gauss looks beside its middle
NARROW = 4.0  # pixels
READ, CUT, EACH = range(3)  # how cells are weighed, see ``weigh_cells``
GAUSS = tuple(
    (0.5 + 0.5 * float(node), float(weight))
    for node, weight in zip(*np.polynomial.legendre.leggauss(4), strict=True)
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_weight(ex: float, ey: float, slope: float, reach: float, slant: Array) -> float:
    """Mean of cos^4 = (1 + slope^2)^-2 over the part of the pupil that lights a sensor point.

    The part is common to the unit disc and one of radius R >= 1 whose centre is d away: chords
    across the line of centres, at places that go with the square of v from where a circle ends, so
    that the sum over v is one of a smooth function. Four of them a piece leave 1.6e-4 of the
    weight's change over the pupil, measured on random cameras.

    Args:
        ex: sensor point, mm from the micro-image's centre.
        ey: the same along y.
        slope: of the micro-image, mm; 0 for all of the pupil.
        reach: the same.
        slant: slope (x, y) of the middle ray at the sensor, its change per mm on the sensor and per
            unit of pupil.
    """
    away = math.sqrt(ex * ex + ey * ey)
    along, aside = (ex / away, ey / away) if away > 0.0 else (1.0, 0.0)
    slope_x, slope_y = slant[0] + slant[2] * ex, slant[1] + slant[2] * ey
    toward, beside = slope_x * along + slope_y * aside, slope_y * along - slope_x * aside
    spread = -slant[3] if slope < 0.0 else slant[3]
    radius, apart = (reach / abs(slope), away / abs(slope)) if slope != 0.0 else (2.0, 0.0)
    apart = min(apart, (radius + 1.0) * SLIVER)
    low, crossing = -1.0, -1.0
    if apart > max(radius - 1.0, 1e-12):
        low, crossing = apart - radius, 0.5 * (1.0 + apart * apart - radius * radius) / apart
    light, area = 0.0, 0.0
    for piece, start, end in ((0, low, crossing), (1, crossing, 0.0), (2, 1.0, max(crossing, 0.0))):
        if piece < 2 and start >= end:
            continue
        for node, weight in GAUSS:
            at = start + (end - start) * node * node
            squared = 1.0 - at * at if piece else radius * radius - (at - apart) ** 2
            half = math.sqrt(max(squared, 0.0))
            share = weight * node * half * abs(end - start)
            forth = toward + spread * at
            right, left = beside + spread * half * ACROSS, beside - spread * half * ACROSS
            area += share
            on_sides = (1.0 + forth * forth + right * right) ** -2 + (
                1.0 + forth * forth + left * left
            ) ** -2
            light += (
                share
                * (8.0 * (1.0 + forth * forth + beside * beside) ** -2 + 5.0 * on_sides)
                / 18.0
            )
    return light / area


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cut_weight(
    ex: float, ey: float, side: float, slope: float, reach: float, slant: Array, nodes: Array
) -> float:
    """Mean of cos^4 over all the light of a square that a narrow rim cuts, for each pupil point
    elsewhere.

    Args:
        ex: middle of the square, mm from the micro-image's centre.
        ey: the same along y.
        side: of the square, mm.
        slope: of the micro-image, mm.
        reach: the same.
        slant: see ``seen_weight``.
        nodes: points of the pupil that count alike, shape (N, 2).
    """
    light, area = 0.0, 0.0
    for node in range(nodes.shape[0]):
        x, y = ex - slope * nodes[node, 0], ey - slope * nodes[node, 1]
        lit, look = inside(x, y, side, reach)
        slope_x = slant[0] + slant[2] * (ex + (look - 1.0) * x) + slant[3] * nodes[node, 0]
        slope_y = slant[1] + slant[2] * (ey + (look - 1.0) * y) + slant[3] * nodes[node, 1]
        area += lit
        light += lit / (1.0 + slope_x * slope_x + slope_y * slope_y) ** 2
    return light / area if area > 0.0 else 1.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_uneven(slope: float, reach: float, slant: Array, width: float, error: float) -> bool:
    """Whether the light of pixels in a rim must be weighed by ``cut_weight``: a rim up to
    ``NARROW`` pixels wide, a weight that changes.

    The weight at the pixel's middle leaves up to 0.1 of the weight's change over the pupil;
    measured on a rim of 0.75 pixels.
    """
    steepest = math.hypot(slant[0], slant[1]) + abs(slant[2]) * (reach + abs(slope)) + abs(slant[3])
    return 2.0 * abs(slope) < NARROW * width and 0.4 * steepest * abs(slant[3]) > error


@numba.njit(cache=True, nogil=True, error_model="numpy")
def table_steps(slope: float, reach: float, slant: Array, error: float) -> tuple[float, float]:
    """Steps (mm) of tables of ``seen_weight`` that leave an error of white: where the pupil is
    whole, and where the rim clips it too.

    Between places h apart, a whole pupil's mean is off by up to (h times the slopes' change per
    mm)^2, and a clipped one's by 0.2 c of the power 3/2 of h over the rim's width, where the weight
    changes by c over the pupil; measured, the rim's share of light included.
    """
    steepest = math.hypot(slant[0], slant[1]) + abs(slant[2]) * (reach + abs(slope)) + abs(slant[3])
    whole = math.sqrt(error) / max(abs(slant[2]), 1e-300)
    return whole, min(
        whole, 2.0 * abs(slope) * (error / max(0.8 * steepest * abs(slant[3]), 1e-300)) ** (2 / 3)
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_weights(
    left: float,
    bottom: float,
    step: float,
    weights: Array,
    slope: float,
    reach: float,
    slant: Array,
) -> None:
    """``seen_weight`` at sensor points ``step`` mm apart from (left, bottom) on, into ``weights``
    [row, column].
    """
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            weights[row, column] = seen_weight(
                left + column * step, bottom + row * step, slope, reach, slant
            )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_weight(
    x: float, y: float, weights: Array, grid: tuple[float, float, float, float, float], slant: Array
) -> float:
    """The weight at a place (x, y), mm from the centre, between those of a table.

    Args:
        x: the place.
        y: the same.
        weights: the table, see ``seen_weights``; an empty one has the four places round this one
            worked out at once.
        grid: where it begins (x, y) and its step, mm; slope and reach that it is made for.
        slant: see ``seen_weight``.
    """
    left, bottom, step, slope, reach = grid
    column, row = (x - left) / step, (y - bottom) / step
    i, j = int(column), int(row)
    u, v = column - i, row - j
    if weights.size > 0:
        low = (1.0 - u) * weights[j, i] + u * weights[j, i + 1]
        return (1.0 - v) * low + v * ((1.0 - u) * weights[j + 1, i] + u * weights[j + 1, i + 1])
    x, y = left + i * step, bottom + j * step
    low = (1.0 - u) * seen_weight(x, y, slope, reach, slant) + u * seen_weight(
        left + (i + 1) * step, y, slope, reach, slant
    )
    y = bottom + (j + 1) * step
    high = (1.0 - u) * seen_weight(x, y, slope, reach, slant) + u * seen_weight(
        left + (i + 1) * step, y, slope, reach, slant
    )
    return (1.0 - v) * low + v * high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_around(
    x: float,
    y: float,
    beside: float,
    above: float,
    weights: Array,
    grid: tuple[float, float, float, float, float],
    slant: Array,
) -> float:
    """Mean of the weights at places that deviate by so much, mm, from one, by four of them; see
    ``read_weight``.
    """
    low = read_weight(x - beside, y - above, weights, grid, slant) + read_weight(
        x + beside, y - above, weights, grid, slant
    )
    high = read_weight(x - beside, y + above, weights, grid, slant) + read_weight(
        x + beside, y + above, weights, grid, slant
    )
    return 0.25 * (low + high)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weigh_cells(
    cells: Array,
    number: int,
    xs: Array,
    dy: float,
    count: int,
    width: float,
    by: int,
    weights: Array,
    grid: tuple[float, float, float, float, float],
    cone: tuple[float, float, float],
    slant: Array,
    nodes: Array,
) -> None:
    """The weight of each of ``count`` cells a side of some pixels of a row, row of cells by row,
    into ``cells`` (count^2 or more, number).

    Args:
        cells: to fill.
        number: of pixels.
        xs: their places from the micro-image's centre, mm.
        dy: their row's place.
        count: cells a side.
        width: of a pixel, mm.
        by: READ of a table, CUT by a narrow rim, else each by itself.
        weights: the table.
        grid: see ``read_weight``.
        cone: slope of the micro-image, mm, the same or 0 where a cell holds all of its rim, and its
            reach, mm.
        slant: see ``seen_weight``.
        nodes: see ``cut_weight``.
    """
    slope, clipped, reach = cone
    for cell in range(count * count):
        y = dy + ((cell // count + 0.5) / count - 0.5) * width
        aside = ((cell % count + 0.5) / count - 0.5) * width
        for p in range(number):
            x = xs[p] + aside
            if by == READ:
                cells[cell, p] = read_weight(x, y, weights, grid, slant)
            elif by == CUT:
                cells[cell, p] = cut_weight(x, y, width / count, slope, reach, slant, nodes)
            else:
                cells[cell, p] = seen_weight(x, y, clipped, reach, slant)

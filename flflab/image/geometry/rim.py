"""Vignetting: how much of a microlens's full cone reaches a pixel, as a table over the distance
from the micro-image's centre.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.pupil import Pupils
from flflab.optics.discs import disc_rectangle_area, two_disc_area

Array = npt.NDArray[np.float64]

TABLE_STEPS = 512
STEEP = 6.0  # a rim narrower than this many (sub)pixels is no function of the distance alone


@dataclass(frozen=True)
class Rims:
    """What the rims of the micro-images are like; a camera of equal microlenses has one kind of
    rim.

    Attributes:
        kind: which kind of rim each microlens has, shape (N,).
        width: width of each kind's rim in pixels, shape (K,).
        slope: of each kind, mm, shape (K,).
        reach: of each kind, mm, shape (K,).
    """

    kind: npt.NDArray[np.int64]
    width: Array
    slope: Array
    reach: Array


def find_rims(pupils: Pupils, pixel: float) -> Rims:
    """Tell equal rims apart from unlike ones; ``pixel`` in mm."""
    pairs, kind = np.unique(
        np.stack([np.abs(pupils.slope), pupils.reach], axis=1), axis=0, return_inverse=True
    )
    return Rims(
        kind=kind.reshape(-1), width=2 * pairs[:, 0] / pixel, slope=pairs[:, 0], reach=pairs[:, 1]
    )


def rim_tables(
    rims: Rims, sides: Array, steep: npt.NDArray[np.bool_], steps: int = TABLE_STEPS
) -> Array:
    """Share of the full cone against the distance from the centre, averaged over a pixel.

    Args:
        rims: the kinds of rims.
        sides: side of the pixel for each kind, mm.
        steep: kinds without a table.
        steps: steps of a table.

    Returns:
        Shape (K, steps + 3): first distance, 1 / step, then the shares. The rows of steep kinds
        start with -1.
    """
    tables = np.zeros((len(rims.slope), steps + 3))
    _fill(tables, rims.slope, rims.reach, sides, steep)
    tables[steep, 0] = -1.0
    return tables


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rim_share(distance: float, table: Array) -> float:
    """Share of the full cone at a distance (mm) from the centre, from one row of ``rim_tables``."""
    steps = table.shape[0] - 3
    place = min(max((distance - table[0]) * table[1], 0.0), float(steps))  # there the table is 0
    index = min(int(place), steps - 1)
    part = place - index
    return table[index + 2] * (1.0 - part) + table[index + 3] * part


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill(
    tables: Array, slope: Array, reach: Array, sides: Array, steep: npt.NDArray[np.bool_]
) -> None:
    steps = tables.shape[1] - 3
    points = np.empty(
        steps + 3
    )  # a table of points of no size: areas of discs cost ten times what looking them up does
    for kind in range(tables.shape[0]):
        if steep[kind]:
            continue
        points[0] = abs(reach[kind] - slope[kind])
        points[1] = steps / (reach[kind] + slope[kind] - points[0])
        for index in range(steps + 1):
            points[index + 2] = (
                two_disc_area(
                    1.0, reach[kind] / slope[kind], (points[0] + index / points[1]) / slope[kind]
                )
                / math.pi
            )
        pixel = sides[kind]
        first = max(0.0, reach[kind] - slope[kind] - pixel)
        step = (reach[kind] + slope[kind] + pixel - first) / steps
        tables[kind, 0] = first
        tables[kind, 1] = 1.0 / step
        for index in range(steps + 1):
            total = 0.0
            for column in range(4):
                x = first + step * index + pixel * (column - 1.5) / 4
                for row in range(2):
                    y = pixel * (row + 0.5) / 4
                    total += rim_share(math.sqrt(x * x + y * y), points)
            tables[kind, index + 2] = total / 8


def disc_nodes(rings: int, spokes: int) -> Array:
    """Points (x, y) of equal weight in the unit disc, shape (rings * spokes, 2)."""
    radius = np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2 * np.pi * (np.arange(spokes) + 0.5 * (np.arange(rings)[:, None] % 2)) / spokes
    return np.stack(
        [(radius[:, None] * np.cos(angle)).ravel(), (radius[:, None] * np.sin(angle)).ravel()],
        axis=1,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def steep_share(x: float, y: float, side: float, slope: float, reach: float, nodes: Array) -> float:
    """Share of the full cone in a pixel at (x, y) from the centre: the mean over the pupil of the
    part of it inside the shadow.
    """
    if side == 0.0 and slope == 0.0:
        return 1.0 if math.hypot(x, y) <= reach else 0.0
    total = 0.0
    for index in range(nodes.shape[0]):
        left = x - slope * nodes[index, 0] - 0.5 * side
        bottom = y - slope * nodes[index, 1] - 0.5 * side
        total += disc_rectangle_area(reach, left, left + side, bottom, bottom + side)
    return total / (nodes.shape[0] * side * side)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lit_middle(distance: float, part: float, reach: float) -> float:
    """Where to look in a pixel of this side that a steep rim crosses: the middle of its lit part,
    as a share of its distance.
    """
    if distance + 0.5 * part <= reach or distance <= part:
        return 1.0
    return max(0.5 * (distance - 0.5 * part + reach), distance - 0.5 * part) / distance


@numba.njit(cache=True, nogil=True, error_model="numpy")
def inside(x: float, y: float, side: float, reach: float) -> tuple[float, float]:
    """Share of a square round (x, y) that lies in a disc round the origin, and where to look in it
    as a share of its distance.
    """
    away = math.sqrt(x * x + y * y)
    if away + side < reach:
        return 1.0, 1.0
    if away > reach + side:
        return 0.0, 1.0
    left, bottom = x - 0.5 * side, y - 0.5 * side
    return disc_rectangle_area(reach, left, left + side, bottom, bottom + side) / (
        side * side
    ), lit_middle(away, side, reach)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def part_share(
    x: float, y: float, side: float, slope: float, reach: float, table: Array, nodes: Array
) -> tuple[float, float]:
    """Share of the full cone in a part of a pixel on the rim, and where to look in it as a share of
    its distance from the centre.

    Args:
        x: its middle from the micro-image's centre, mm.
        y: the same along y.
        side: its side, mm.
        slope: of the micro-image, mm.
        reach: the same.
        table: its row of ``rim_tables``.
        nodes: pupil points for steep rims.
    """
    distance = math.sqrt(x * x + y * y)
    if table[0] >= 0.0:
        return rim_share(distance, table), 1.0
    return steep_share(x, y, side, slope, reach, nodes), lit_middle(distance, side, reach)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def place_on_rim(
    x: float, y: float, side: float, rim: Array, steep: bool, count: int, nodes: Array
) -> tuple[float, float, float]:
    """How a part of a pixel looks through a pupil that a table over the rim describes.

    Args:
        x: its middle from the micro-image's centre, pixels.
        y: the same along y.
        side: its side, pixels.
        rim: inner edge, slope, reach and outer edge of the micro-image, pixels.
        steep: whether the rim is too narrow for a table.
        count: steps of the table, even ones of the cosine from the inner edge to the outer.
        nodes: pupil points for steep rims.

    Returns:
        Its place in the table, below 0 where the pupil counts as whole; its share of light; where
        to look, as a share of its distance.
    """
    distance = math.sqrt(x * x + y * y)
    if steep:
        return (
            -1.0,
            steep_share(x, y, side, rim[1], rim[2], nodes),
            lit_middle(distance, side, rim[2]),
        )
    if distance >= rim[3]:
        return -1.0, 0.0, 1.0
    if distance <= rim[0]:
        return -1.0, 1.0, 1.0
    return math.acos(max(-1.0, 1.0 - (distance - rim[0]) / rim[1])) / math.pi * count, 1.0, 1.0

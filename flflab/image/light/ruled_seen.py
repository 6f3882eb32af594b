"""What a target that varies along one direction looks like to microlenses, and its means over parts
of pixels.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.light.lenses import Lenses
from flflab.image.light.sampled import sampled_mean
from flflab.image.light.strips import WEIGHT, weighted_mean
from flflab.image.radiance.neighbourhood import RULED
from flflab.image.radiance.parallelogram import ruled_parallelogram
from flflab.image.radiance.profile import moved_mean, prepare
from flflab.optics.discs import LOOSE

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

EVENLY = math.sqrt(1 / 12)  # of a side: the standard deviation of places along it


class RuledSeen(NamedTuple):
    """A target that varies along x' only, between two ends along y', as all entries see it.

    Attributes:
        lenses: the entries.
        sharp: entries whose blur is negligible.
        counts: number of strips for each kind of rim, (K, 2): of most pixels, and where the window
            ends.
        strips: see ``strip_nodes``; (K, 2, 3, most strips).
        grid: which of the grids of points across the pupil sums the window's ends in every entry.
        grids: how many points a side each has; 0 where strips do.
        rows_of_points: see ``strip_nodes``; (G, 2, most points).
        chords: see ``chord_nodes``; the same.
        chunks: pieces of a strip for the fall-off, see ``strip_means``; 0 for no fall-off.
        whole: parts a side of a pixel that no rim crosses, for its fall-off, for each kind of rim.
        divided: the same on rims, and where blur is negligible: above 1 every part has its own
            fall-off.
        fall: largest error of the fall-off's tables.
        fine: largest error of the antiderivatives' tables.
        table: profile, see ``profile_table``; no row where the target does not vary along x'.
        law: its law.
        ways: how far rays end along x' from where they would, mm, at some moments of the exposure;
            shape (N, moments).
        bounds: lower and upper end of the window, target mm.
        numbers: what ``mean_over`` asks for: the upper end.
        no_sums: of no picture.
    """

    lenses: Lenses
    sharp: Chosen
    counts: Whole
    strips: Array
    grid: Whole
    grids: Whole
    rows_of_points: Array
    chords: Array
    chunks: int
    whole: Whole
    divided: Whole
    fall: float
    fine: float
    table: Array
    law: Array
    ways: Array
    bounds: Array
    numbers: Array
    no_sums: Array


@numba.njit(cache=True, nogil=True, error_model="numpy")
def columns_between(
    low: float, high: float, at: float, per_column: float, columns: int
) -> tuple[int, int]:
    """The columns where at + per_column * column lies between two bounds: the first, and the one
    after the last.
    """
    if low > high or (per_column == 0.0 and not low <= at <= high):
        return 0, 0
    if per_column == 0.0:
        return 0, columns
    one, other = (low - at) / per_column, (high - at) / per_column
    first, last = (
        math.ceil(max(min(one, other), 0.0)),
        math.floor(min(max(one, other), columns - 1.0)),
    )
    return (first, last + 1) if first <= last else (0, 0)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def rim_shares(
    points: Array, number: int, xs: Array, column: int, shift: float, y: float, rim: Array
) -> None:
    """``rim_share`` at xs + shift mm from the centre, of pixels from a column on; fills ``points``
    from WEIGHT on.
    """
    nearest, per_step, squared, last = rim[0], rim[1], y * y, float(rim.shape[0] - 4)
    for p in range(number):
        x = xs[column + p] + shift
        points[WEIGHT + p] = min(
            max((math.sqrt(x * x + squared) - nearest) * per_step, 0.0), last + 1.0
        )
    for p in range(
        number
    ):  # apart from the above: reading here and there is faster without vectors
        place = points[WEIGHT + p]
        i = np.int64(min(place, last))
        below = np.uint64(i + 2)
        points[WEIGHT + p] = rim[below] + (place - i) * (rim[below + np.uint64(1)] - rim[below])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rim_boxes(seen: RuledSeen, entry: int, boxes: Array) -> None:
    """Widths on the target of a pixel's parts outside rims, in them, and there where chords end at
    the rim, into ``boxes`` (3, 2).
    """
    lenses = seen.lenses
    kind, slope, to = lenses.kinds[entry], lenses.cones[entry, 0], lenses.maps[entry]
    for axis in range(2):
        boxes[0, axis] = abs(to[6 + axis]) * lenses.width / seen.whole[kind]
        boxes[1, axis] = abs(to[6 + axis]) * lenses.width / lenses.parts[kind]
        moved = 0.0 if lenses.rims[kind, 0] < 0.0 or slope == 0.0 else to[2 + axis] / slope
        boxes[2, axis] = abs(to[6 + axis] + moved) * lenses.width / lenses.parts[kind]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def antiderivatives(
    seen: RuledSeen, entry: int, window: Whole, boxes: Array, places: Array
) -> Array:
    """What ``prepare`` makes for the pixels of a window of an entry: first column, column after the
    last, first row, row after the last.
    """
    lenses = seen.lenses
    to, xs, ys, pixel = lenses.maps[entry], lenses.xs, lenses.ys, lenses.pixel
    middle_x = 0.5 * (xs[window[0]] + xs[window[1] - 1]) - lenses.centres[entry, 0]
    middle_y = 0.5 * (ys[window[2]] + ys[window[3] - 1]) - lenses.centres[entry, 1]
    middle = to[0] + to[6] * middle_x + to[7] * middle_y
    half = 0.5 * (
        abs(to[6]) * ((window[1] - window[0]) * pixel)
        + abs(to[7]) * ((window[3] - window[2]) * pixel)
    )
    spread = math.hypot(to[2], to[3])
    return prepare(
        middle - half,
        middle + half,
        spread,
        boxes,
        seen.fine,
        seen.table,
        seen.law,
        seen.ways[entry],
        places,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lit_columns(
    at: float, per_mm: float, width: float, count: int, table: Array, law: Array, ways: Array
) -> tuple[float, float]:
    """Where the light lies across the columns of a pixel beside which a sharp target stands
    upright: middle and standard deviation, mm.

    Args:
        at: x' of the pixel's middle, mm.
        per_mm: its change per mm on the sensor.
        width: of the pixel, mm.
        count: into how many parts it is divided.
        table: profile, see ``RuledSeen``; without a row the pixel is lit evenly.
        law: the same.
        ways: of the entry.
    """
    if table.shape[0] == 0:
        return 0.0, EVENLY * width
    light, first, second, side = 0.0, 0.0, 0.0, width / count
    for i in range(count):
        x = (i + 0.5) * side - 0.5 * width
        value = moved_mean(at + per_mm * x, abs(per_mm) * side, 0.0, table, law, ways)
        light += value
        first += value * x
        second += value * (x * x + side * side / 12.0)
    if light <= 0.0:
        return 0.0, EVENLY * width
    return first / light, math.sqrt(max(second / light - (first / light) ** 2, 0.0))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def askew_mean(
    at_x: float,
    at_y: float,
    side: float,
    to: Array,
    table: Array,
    law: Array,
    ways: Array,
    window: Array,
) -> float:
    """Mean of a sharp target for a part of a pixel that stands askew, where the window's ends are
    near.

    Args:
        at_x: x' of the part's middle, mm.
        at_y: y' of it.
        side: of the part, mm.
        to: the maps to the target, see ``Lenses``.
        table: profile, see ``RuledSeen``.
        law: the same.
        ways: of the entry.
        window: lower and upper end, and the height on the target of the part's sides along x and y.
    """
    total, area = 0.0, abs(to[6] * to[9] - to[7] * to[8]) * side * side
    for way in ways:
        total += ruled_parallelogram(
            at_x + way,
            at_y,
            to[6] * side,
            to[8] * side,
            to[7] * side,
            to[9] * side,
            window[0],
            window[1],
            table,
            law,
        )
    return total / (ways.size * area)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def end_at(
    ex: float,
    ey: float,
    side: float,
    landing: tuple[float, float, float, float, float, float],
    entry: int,
    seen: RuledSeen,
    sums: Array,
    whole: Array,
    cut: Array,
    window: Array,
    moved_to: Array,
) -> float:
    """Mean of a blurred target for a part of a pixel where the window's ends are near.

    Args:
        ex: place of the part's middle from the micro-image's centre, mm.
        ey: the same along y.
        side: of the part, mm.
        landing: see ``strip_means``.
        entry: which of the entries it is seen through.
        seen: the target.
        sums: antiderivatives of the profile.
        whole: see ``strip_means``.
        cut: the same.
        window: see ``askew_mean``.
        moved_to: scratch, shape (10,).
    """
    lenses, own = seen.lenses, seen.grid[entry]
    to, slant, points = lenses.maps[entry], lenses.slants[entry], int(seen.grids[own])
    if points == 0:
        kind, along_x, along_y = lenses.kinds[entry], landing[4], landing[5]
        cone, slants = (
            (lenses.cones[entry, 0], lenses.cones[entry, 1]),
            (slant[0], slant[1], slant[2], slant[3]),
        )
        across = (
            to[1] + to[8] * ex + to[9] * ey,
            to[4] * along_x + to[5] * along_y,
            to[5] * along_x - to[4] * along_y,
        )
        strips, count = seen.strips[kind, 1], int(seen.counts[kind, 1])
        return weighted_mean(
            ex,
            ey,
            landing,
            cone,
            strips,
            count,
            sums,
            whole,
            cut,
            seen.chunks,
            slants,
            across,
            window,
        )
    total, ways = 0.0, seen.ways[entry]
    for way in ways:
        for i in range(len(to)):  # one by one, or numba would ask a device for memory
            moved_to[i] = to[i]
        moved_to[0] += way
        total += sampled_mean(
            ex,
            ey,
            lenses.cones[entry],
            moved_to,
            seen.rows_of_points[own],
            seen.chords[own],
            points,
            side,
            RULED,
            seen.numbers,
            seen.table,
            seen.law,
            seen.no_sums,
            slant,
        )
    return total / ways.size

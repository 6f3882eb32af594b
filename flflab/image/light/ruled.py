"""Images of targets that vary along one direction (bars, chirp), end at a straight line (edge), or are plain white.

The radiance is profile(x') times a window in y', where x' and y' are target axes turned as the target asks. Over the pupil, strips
along the gradient of x' are summed; along each strip the mean of the profile is exact, and so is the mean over the pixel.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.falloff_means import cut_weight, is_uneven, read_between, seen_weight, seen_weights, table_steps
from flflab.image.geometry.rim import part_share, rim_share
from flflab.image.geometry.tiles import shrink
from flflab.image.light.lenses import Lenses
from flflab.image.light.sampled import sampled_mean
from flflab.image.light.strips import BLOCK, EX, EY, MEAN, ROWS, WEIGHT, strip_means, weighted_mean, window_mean
from flflab.image.radiance.neighbourhood import RULED
from flflab.image.radiance.parallelogram import ruled_parallelogram, stands_askew
from flflab.image.radiance.profile import moved_mean, prepare
from flflab.optics.discs import LOOSE

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

EDGE = 0.04  # of white: what is left in the last pixels of a rim, times the 3/2 power of half its width, where only its columns are cut
EVEN = 0.0015  # of white, times the same power of its whole width: what four points of a pixel leave that is OFF_ENDS from a rim's ends
OFF_ENDS = 1.25  # pixels


class RuledSeen(NamedTuple):
    """A target that varies along x' only, between two ends along y', as all entries see it.

    Attributes:
        lenses: the entries.
        sharp: entries whose blur is negligible.
        counts: number of strips for each kind of rim, (K, 2): of most pixels, and where the window ends.
        strips: see ``strip_nodes``; (K, 2, 3, most strips).
        grid: which of the grids of points across the pupil sums the window's ends in every entry.
        grids: how many points a side each has; 0 where strips do.
        rows_of_points: see ``strip_nodes``; (G, 2, most points).
        chords: see ``chord_nodes``; the same.
        chunks: pieces of a strip for the fall-off; 0 for no fall-off.
        fall: largest error of the fall-off's tables.
        fine: largest error of the antiderivatives' tables.
        table: profile, see ``profile_table``; no row where the target does not vary along x'.
        law: its law.
        ways: how far rays end along x' from where they would, mm, at some moments of the exposure; shape (N, moments).
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
    fall: float
    fine: float
    table: Array
    law: Array
    ways: Array
    bounds: Array
    numbers: Array
    no_sums: Array


@numba.njit(cache=True, nogil=True, error_model="numpy")
def columns_between(low: float, high: float, at: float, per_column: float, columns: int) -> tuple[int, int]:
    """The columns where at + per_column * column lies between two bounds: the first, and the one after the last."""
    if low > high or (per_column == 0.0 and not low <= at <= high):
        return 0, 0
    if per_column == 0.0:
        return 0, columns
    one, other = (low - at) / per_column, (high - at) / per_column
    first, last = math.ceil(max(min(one, other), 0.0)), math.floor(min(max(one, other), columns - 1.0))
    return (first, last + 1) if first <= last else (0, 0)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def rim_shares(points: Array, number: int, xs: Array, column: int, shift: float, y: float, rim: Array) -> None:
    """``rim_share`` at xs + shift mm from the centre, of pixels from a column on; fills ``points`` from WEIGHT on."""
    nearest, per_step, squared, last = rim[0], rim[1], y * y, float(rim.shape[0] - 4)
    for p in range(number):
        x = xs[column + p] + shift
        points[WEIGHT + p] = min(max((math.sqrt(x * x + squared) - nearest) * per_step, 0.0), last + 1.0)
    for p in range(number):  # apart from the above: reading here and there is faster without vectors
        place = points[WEIGHT + p]
        i = np.int64(min(place, last))
        below = np.uint64(i + 2)
        points[WEIGHT + p] = rim[below] + (place - i) * (rim[below + np.uint64(1)] - rim[below])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rim_boxes(seen: RuledSeen, entry: int, boxes: Array) -> None:
    """Widths on the target of a pixel, of its parts in the rim, and of these where chords end at the rim, into ``boxes`` (3, 2)."""
    lenses = seen.lenses
    kind, slope, to = lenses.kinds[entry], lenses.cones[entry, 0], lenses.maps[entry]
    for axis in range(2):
        boxes[0, axis] = abs(to[6 + axis]) * lenses.width
        boxes[1, axis] = boxes[0, axis] / lenses.parts[kind]
        moved = 0.0 if lenses.rims[kind, 0] < 0.0 or slope == 0.0 else to[2 + axis] / slope
        boxes[2, axis] = abs(to[6 + axis] + moved) * lenses.width / lenses.parts[kind]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def antiderivatives(seen: RuledSeen, entry: int, window: Whole, boxes: Array, places: Array) -> Array:
    """What ``prepare`` makes for the pixels of a window of an entry: first column, column after the last, first row, row after the last."""
    lenses = seen.lenses
    to, xs, ys, pixel = lenses.maps[entry], lenses.xs, lenses.ys, lenses.pixel
    middle_x = 0.5 * (xs[window[0]] + xs[window[1] - 1]) - lenses.centres[entry, 0]
    middle_y = 0.5 * (ys[window[2]] + ys[window[3] - 1]) - lenses.centres[entry, 1]
    middle = to[0] + to[6] * middle_x + to[7] * middle_y
    half = 0.5 * (abs(to[6]) * ((window[1] - window[0]) * pixel) + abs(to[7]) * ((window[3] - window[2]) * pixel))
    spread = math.hypot(to[2], to[3])
    return prepare(middle - half, middle + half, spread, boxes, seen.fine, seen.table, seen.law, seen.ways[entry], places)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def askew_mean(at_x: float, at_y: float, side: float, to: Array, table: Array, law: Array, ways: Array, window: Array) -> float:
    """Mean of a sharp target for a part of a pixel that stands askew, where the window's ends are near.

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
            at_x + way, at_y, to[6] * side, to[8] * side, to[7] * side, to[9] * side, window[0], window[1], table, law
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
        cone, slants = (lenses.cones[entry, 0], lenses.cones[entry, 1]), (slant[0], slant[1], slant[2], slant[3])
        across = (to[1] + to[8] * ex + to[9] * ey, to[4] * along_x + to[5] * along_y, to[5] * along_x - to[4] * along_y)
        strips, count = seen.strips[kind, 1], int(seen.counts[kind, 1])
        return weighted_mean(ex, ey, landing, cone, strips, count, sums, whole, cut, seen.chunks, slants, across, window)
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_ruled(image: Array, rows: tuple[int, int], windows: Whole, seen: RuledSeen) -> None:
    """Add the light of every entry to the rows from rows[0] to below rows[1] of an image.

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last, of every entry; shape (N, 4).
        seen: the target.
    """
    lenses = seen.lenses
    xs, ys, pixel, width, wanted = lenses.xs, lenses.ys, lenses.pixel, lenses.width, lenses.wanted
    chunks, fine, table, law, bounds = seen.chunks, seen.fine, seen.table, seen.law, seen.bounds
    varies = table.shape[0] > 0
    window, moved_to = np.empty(4), np.empty(lenses.maps.shape[1])
    window[:2] = bounds
    places, boxes, sums, piece = np.zeros((3, 4)), np.zeros((3, 2)), np.zeros(2), np.zeros(4, dtype=np.int64)
    points, shares, light = np.zeros(ROWS * BLOCK), np.zeros(BLOCK), np.zeros(BLOCK)
    for entry in range(windows.shape[0]):
        first, last = max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])
        start, end = windows[entry, 0], windows[entry, 1]
        if wanted.size > 0:
            start, end, first, last = shrink(wanted, start, end, first, last)
        if first >= last or start >= end:
            continue
        kind, to, slant, ways = lenses.kinds[entry], lenses.maps[entry], lenses.slants[entry], seen.ways[entry]
        slope, reach = lenses.cones[entry]
        centre_x, centre_y = lenses.centres[entry]
        origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = to
        spread = math.hypot(xx, xy)
        along_x, along_y = (xx / spread, xy / spread) if spread > 0.0 else (1.0, 0.0)
        up_along, up_across = yx * along_x + yy * along_y, yy * along_x - yx * along_y
        landing = (origin_x, cxx, cxy, spread, along_x, along_y)
        cone, slants = (slope, reach), (slant[0], slant[1], slant[2], slant[3])
        rim, strip = lenses.rims[kind], seen.strips[kind, 0]
        count, rim_parts = int(seen.counts[kind, 0]), int(lenses.parts[kind])
        steep, blurred = rim[0] < 0.0, varies and not seen.sharp[entry]
        askew = varies and width > 0.0 and stands_askew(to[2:])
        level, lower, upper = lenses.levels[entry], bounds[0], bounds[1]
        rim_boxes(seen, entry, boxes)
        if blurred:
            piece[0], piece[1], piece[2], piece[3] = start, end, first, last
            sums = antiderivatives(seen, entry, piece, boxes, places)
        outside, deep = reach + abs(slope) + 0.75 * width, reach - abs(slope) - 0.75 * width
        felt = abs(up_along) + abs(up_across) + (abs(cyx) + abs(cyy)) * width
        # Where neither pupil nor row matters, the mean of a column is the same all the way down.
        upright = cxy == 0.0 or not varies
        by_column, full_by_column = upright and not blurred, upright and not (blurred and chunks > 0)
        even = not (varies or steep) and rim_parts > 2 and EVEN * (0.5 * width / abs(slope)) ** 1.5 < 4.0 * fine
        beside = math.sqrt((1.0 - 1.0 / (rim_parts * rim_parts)) / 12.0) * width  # the rim's table smooths the rest
        nearer, farther = abs(reach - abs(slope)) + OFF_ENDS * width, reach + abs(slope) - OFF_ENDS * width
        quick = by_column and not steep and (rim_parts == 1 or EDGE * (width / abs(slope)) ** 1.5 < 4.0 * fine)
        steady = np.ones((1 + rim_parts, end - start if full_by_column else 0))
        if full_by_column and blurred:
            for block in range(start, end, BLOCK):
                number = min(BLOCK, end - block)
                for p in range(number):
                    points[EX + p], points[EY + p] = xs[block + p] - centre_x, 0.0
                strip_means(points, number, landing, (0.0, reach), strip, count, sums, places[0], places[0], 0, slants)
                for p in range(number):
                    steady[0, block + p - start] = points[MEAN + p]
        elif full_by_column and varies:
            for column in range(start, end):
                at = origin_x + cxx * (xs[column] - centre_x)
                steady[0, column - start] = moved_mean(at, boxes[0, 0], 0.0, table, law, ways)
                for i in range(rim_parts):
                    shifted = at + cxx * ((i + 0.5) / rim_parts - 0.5) * width
                    steady[1 + i, column - start] = moved_mean(shifted, boxes[1, 0], 0.0, table, law, ways)
        falls = chunks > 0 and not blurred
        clipped = slope if 2.0 * abs(slope) > width else 0.0  # a pixel that holds all of the rim sees the whole pupil
        whole_step, rim_step = table_steps(slope, reach, slant, seen.fall)
        uneven = falls and is_uneven(slope, reach, slant, width, seen.fall)
        rim_tabled = rim_step >= pixel and not uneven
        tabled = falls and (rim_tabled or deep > 0.0)
        apart = min(max(rim_step if rim_tabled else whole_step, 0.5 * pixel), max(end - start, last - first) * pixel)
        corner_x, corner_y = xs[start] - centre_x - 0.5 * pixel, ys[first] - centre_y - 0.5 * pixel
        weights = np.ones((int((last - first) * pixel / apart) + 2, int((end - start) * pixel / apart) + 2) if tabled else (1, 1))
        if tabled:
            seen_weights(corner_x, corner_y, apart, weights, clipped if rim_tabled else 0.0, reach, slant)
        for row in range(first, last):
            dy = ys[row] - centre_y
            room = outside * outside - dy * dy
            if room <= 0.0:
                continue
            half = math.sqrt(room)
            stop = max(start, math.ceil((centre_x - half - xs[0]) / pixel))
            right = min(end, math.floor((centre_x + half - xs[0]) / pixel) + 1)
            height = origin_y + cyx * (xs[0] - centre_x) + cyy * dy
            seen_start, seen_end = columns_between(lower - felt, upper + felt, height, cyx * pixel, len(xs))
            clear_start, clear_end = columns_between(lower + felt, upper - felt, height, cyx * pixel, len(xs))
            half = math.sqrt(max(deep * deep - dy * dy, 0.0))
            full_start, full_end = columns_between(-half, half, xs[0] - centre_x, pixel, len(xs)) if deep > abs(dy) else (0, 0)
            half = math.sqrt(max(farther * farther - dy * dy, 0.0))
            even_start, even_end = columns_between(-half, half, xs[0] - centre_x, pixel, len(xs)) if even and half > 0.0 else (0, 0)
            half = math.sqrt(max(nearer * nearer - dy * dy, 0.0))
            hole_start, hole_end = columns_between(-half, half, xs[0] - centre_x, pixel, len(xs)) if even and half > 0.0 else (0, 0)
            stop, right = max(stop, seen_start), min(right, seen_end)
            while stop < right:
                # The longest run of pixels of one sort.
                column, stop = stop, min(right, stop + BLOCK)
                for change in (full_start, full_end, clear_start, clear_end, even_start, even_end, hole_start, hole_end):
                    if column < change < stop:
                        stop = change
                if wanted.size > 0:
                    while column < stop and not wanted[row, column]:
                        column += 1
                    after = column
                    while after < stop and wanted[row, after]:
                        after += 1
                    stop = max(after, column)
                    if column == stop:
                        continue
                full = full_start <= column < full_end
                clear = clear_start <= column < clear_end
                number = stop - column
                if full and clear and full_by_column:
                    for p in range(number):
                        light[p] = steady[0, column + p - start]
                elif clear and even_start <= column < even_end and not hole_start <= column < hole_end:
                    light[:number] = 0.0
                    for y in (dy - beside, dy + beside):
                        for x in (-beside, beside):
                            rim_shares(points, number, xs, column, x - centre_x, y, rim)
                            for p in range(number):
                                light[p] += 0.25 * points[WEIGHT + p]
                elif clear and quick:
                    light[:number] = 0.0
                    for i in range(rim_parts):
                        rim_shares(points, number, xs, column, ((i + 0.5) / rim_parts - 0.5) * width - centre_x, dy, rim)
                        for p in range(number):
                            light[p] += points[WEIGHT + p] * steady[1 + i, column + p - start]
                    for p in range(number):
                        light[p] /= rim_parts
                else:
                    divide = 1 if full else rim_parts
                    side, near, far = width / divide, places[0 if full else 1], places[0 if full else 2]
                    window[2], window[3] = abs(cyx) * side, abs(cyy) * side
                    box_x, box_y = boxes[0 if full else 1]
                    light[:number] = 0.0
                    for j in range(divide):
                        y = dy + ((j + 0.5) / divide - 0.5) * width
                        for i in range(divide):
                            shift = ((i + 0.5) / divide - 0.5) * width - centre_x
                            for p in range(number):
                                x = xs[column + p] + shift
                                points[EX + p], points[EY + p] = x, y
                                shares[p] = 1.0 if full or steep else rim_share(math.sqrt(x * x + y * y), rim)
                            if steep and not full:
                                for p in range(number):
                                    x = points[EX + p]
                                    shares[p], look = part_share(x, y, side, slope, reach, rim, lenses.nodes)
                                    points[EX + p], points[EY + p] = look * x, look * y
                            if blurred and clear:
                                strip_means(points, number, landing, cone, strip, count, sums, near, far, chunks, slants)
                            for p in range(number):
                                if shares[p] <= 0.0:
                                    continue
                                ex, ey, value = points[EX + p], points[EY + p], 1.0
                                at_x, at_y = origin_x + cxx * ex + cxy * ey, origin_y + cyx * ex + cyy * ey
                                if blurred and clear:
                                    value = points[MEAN + p]
                                elif blurred:
                                    value = end_at(ex, ey, side, landing, entry, seen, sums, near, far, window, moved_to)
                                elif askew and not clear:
                                    value = askew_mean(at_x, at_y, side, to, table, law, ways, window)
                                elif by_column and not full:
                                    value = steady[1 + i, column + p - start]
                                elif varies:
                                    value = moved_mean(at_x, box_x, box_y, table, law, ways)
                                if not (blurred or clear or askew):
                                    value *= window_mean(at_y, window[0], window[1], window[2], window[3])
                                light[p] += shares[p] * min(max(value, 0.0), 1.0) / (divide * divide)
                if falls and (full or rim_tabled):
                    for p in range(number):
                        light[p] *= read_between((xs[column + p] - centre_x - corner_x) / apart, (dy - corner_y) / apart, weights)
                elif uneven:
                    for p in range(number):
                        light[p] *= cut_weight(xs[column + p] - centre_x, dy, width, slope, reach, slant, lenses.nodes)
                elif falls:
                    for p in range(number):
                        light[p] *= seen_weight(xs[column + p] - centre_x, dy, clipped, reach, slant)
                for p in range(number):
                    image[row, column + p] += level * light[p]

"""Images of targets that vary along one direction (bars, chirp), end at a straight line (edge), or are plain white.

The radiance is profile(x') times a window in y', where x' and y' are target axes turned as the target asks. Over the pupil, strips
along the gradient of x' are summed; along each strip the mean of the profile is exact, and so is the mean over the pixel.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.falloff_means import cut_weight, is_uneven, read_between, seen_weight, seen_weights, table_steps
from flflab.image.neighbourhood import RULED
from flflab.image.parallelogram import ruled_parallelogram, stands_askew
from flflab.image.profile import moved_mean, prepare
from flflab.image.rim import part_share, rim_share
from flflab.image.sampled import sampled_mean
from flflab.image.strips import BLOCK, EX, EY, MEAN, ROWS, WEIGHT, strip_means, weighted_mean, window_mean
from flflab.image.tiles import shrink
from flflab.optics.discs import LOOSE

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

EDGE = 0.04  # of white: what is left in the last pixels of a rim, times the 3/2 power of half its width, where only its columns are cut


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
def rim_boxes(slope: float, to: Array, width: float, rim_parts: int, steep: bool, boxes: Array) -> None:
    """Widths on the target of a pixel, of its parts in the rim, and of these where chords end at the rim, into ``boxes`` (3, 2)."""
    for axis in range(2):
        boxes[0, axis] = abs(to[6 + axis]) * width
        boxes[1, axis] = boxes[0, axis] / rim_parts
        moved = 0.0 if steep or slope == 0.0 else to[2 + axis] / slope
        boxes[2, axis] = abs(to[6 + axis] + moved) * width / rim_parts


@numba.njit(cache=True, nogil=True, error_model="numpy")
def antiderivatives(
    window: Whole,
    centre: Array,
    to: Array,
    xs: Array,
    ys: Array,
    pixel: float,
    boxes: Array,
    fine: float,
    table: Array,
    law: Array,
    ways: Array,
    places: Array,
) -> Array:
    """What ``prepare`` makes for the pixels of a window; arguments as in ``add_ruled``, of one entry."""
    middle_x = 0.5 * (xs[window[0]] + xs[window[1] - 1]) - centre[0]
    middle_y = 0.5 * (ys[window[2]] + ys[window[3] - 1]) - centre[1]
    middle = to[0] + to[6] * middle_x + to[7] * middle_y
    half = 0.5 * (abs(to[6]) * ((window[1] - window[0]) * pixel) + abs(to[7]) * ((window[3] - window[2]) * pixel))
    return prepare(middle - half, middle + half, math.hypot(to[2], to[3]), boxes, fine, table, law, ways, places)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_ruled(
    image: Array,
    rows: tuple[int, int],
    windows: Whole,
    kinds: Whole,
    centres: Array,
    cones: Array,
    maps: Array,
    slants: Array,
    levels: Array,
    sharp: Chosen,
    parts: Whole,
    counts: Whole,
    strips: Array,
    grid: Whole,
    grids: Whole,
    rows_of_points: Array,
    chords: Array,
    chunks: int,
    fall: float,
    rims: Array,
    nodes: Array,
    xs: Array,
    ys: Array,
    pixel: float,
    width: float,
    fine: float,
    table: Array,
    law: Array,
    ways: Array,
    bounds: Array,
    numbers: Array,
    no_sums: Array,
    wanted: Chosen,
) -> None:
    """Add the light of every entry to the rows from rows[0] to below rows[1] of an image.

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last, of every entry; shape (N, 4).
        kinds: kind of rim of every entry.
        centres: centre of every micro-image, mm, shape (N, 2).
        cones: slope and reach of every entry, mm, shape (N, 2).
        maps: x', y' = (0, 1) + [[2, 3], [4, 5]] pupil + [[6, 7], [8, 9]] sensor, target mm, shape (N, 10).
        slants: slope (x, y) of the middle ray at the sensor, its change per mm on the sensor and per unit of pupil, shape (N, 4).
        levels: light at full pupil.
        sharp: entries whose blur is negligible.
        parts: parts a side of a pixel in the rim, for each kind of rim.
        counts: number of strips for each kind, (K, 2): of most pixels, and where the window ends.
        strips: see ``strip_nodes``; (K, 2, 3, most strips).
        grid: which of the grids of points across the pupil sums the window's ends in every entry.
        grids: how many points a side each has; 0 where strips do.
        rows_of_points: see ``strip_nodes``; (G, 2, most points).
        chords: see ``chord_nodes``; the same.
        chunks: pieces of a strip for the fall-off; 0 for no fall-off.
        fall: largest error of the fall-off's tables.
        rims: see ``rim_tables``; steep kinds start with a negative distance.
        nodes: pupil points for steep rims.
        xs: positions of the columns, mm.
        ys: positions of the rows, mm.
        pixel: distance of the pixels, mm.
        width: side of a pixel that gathers light, mm.
        fine: largest error of the antiderivatives' tables.
        table: profile, see ``profile_table``; no row where the target does not vary along x'.
        law: its law.
        ways: how far rays end along x' from where they would, mm, at some moments of the exposure; shape (N, moments).
        bounds: lower and upper end of the window, target mm.
        numbers: what ``mean_over`` asks for: the upper end.
        no_sums: of no picture.
        wanted: which pixels to compute, [row, column]; empty for all.
    """
    varies = table.shape[0] > 0
    window, moved_to = np.empty(4), np.empty(maps.shape[1])
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
        kind = kinds[entry]
        slope, reach = cones[entry, 0], cones[entry, 1]
        centre_x, centre_y = centres[entry]
        origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = maps[entry]
        spread = math.hypot(xx, xy)
        along_x, along_y = (xx / spread, xy / spread) if spread > 0.0 else (1.0, 0.0)
        up_along, up_across = yx * along_x + yy * along_y, yy * along_x - yx * along_y
        landing = (origin_x, cxx, cxy, spread, along_x, along_y)
        cone, slant = (slope, reach), (slants[entry, 0], slants[entry, 1], slants[entry, 2], slants[entry, 3])
        rim, strip, strip_end = rims[kind], strips[kind, 0], strips[kind, 1]
        count, count_end, rim_parts = int(counts[kind, 0]), int(counts[kind, 1]), int(parts[kind])
        steep, blurred = rim[0] < 0.0, varies and not sharp[entry]
        askew = varies and width > 0.0 and stands_askew(maps[entry, 2:])
        points_a_side, row_nodes, chord = int(grids[grid[entry]]), rows_of_points[grid[entry]], chords[grid[entry]]
        level, lower, upper = levels[entry], bounds[0], bounds[1]
        rim_boxes(slope, maps[entry], width, rim_parts, steep, boxes)
        if blurred:
            piece[0], piece[1], piece[2], piece[3] = start, end, first, last
            sums = antiderivatives(piece, centres[entry], maps[entry], xs, ys, pixel, boxes, fine, table, law, ways[entry], places)
        outside, deep = reach + abs(slope) + 0.75 * width, reach - abs(slope) - 0.75 * width
        felt = abs(up_along) + abs(up_across) + (abs(cyx) + abs(cyy)) * width
        # Where neither pupil nor row matters, the mean of a column is the same all the way down.
        upright = cxy == 0.0 or not varies
        by_column, full_by_column = upright and not blurred, upright and not (blurred and chunks > 0)
        quick = by_column and not steep and (rim_parts == 1 or EDGE * (width / abs(slope)) ** 1.5 < 4.0 * fine)
        steady = np.ones((1 + rim_parts, end - start if full_by_column else 0))
        if full_by_column and blurred:
            for block in range(start, end, BLOCK):
                number = min(BLOCK, end - block)
                for p in range(number):
                    points[EX + p], points[EY + p] = xs[block + p] - centre_x, 0.0
                strip_means(points, number, landing, (0.0, reach), strip, count, sums, places[0], places[0], 0, slant)
                for p in range(number):
                    steady[0, block + p - start] = points[MEAN + p]
        elif full_by_column and varies:
            for column in range(start, end):
                at = origin_x + cxx * (xs[column] - centre_x)
                steady[0, column - start] = moved_mean(at, boxes[0, 0], 0.0, table, law, ways[entry])
                for i in range(rim_parts):
                    shifted = at + cxx * ((i + 0.5) / rim_parts - 0.5) * width
                    steady[1 + i, column - start] = moved_mean(shifted, boxes[1, 0], 0.0, table, law, ways[entry])
        falls = chunks > 0 and not blurred
        clipped = slope if 2.0 * abs(slope) > width else 0.0  # a pixel that holds all of the rim sees the whole pupil
        whole_step, rim_step = table_steps(slope, reach, slants[entry], fall)
        uneven = falls and is_uneven(slope, reach, slants[entry], width, fall)
        rim_tabled = rim_step >= pixel and not uneven
        tabled = falls and (rim_tabled or deep > 0.0)
        apart = min(max(rim_step if rim_tabled else whole_step, 0.5 * pixel), max(end - start, last - first) * pixel)
        corner_x, corner_y = xs[start] - centre_x - 0.5 * pixel, ys[first] - centre_y - 0.5 * pixel
        weights = np.ones((int((last - first) * pixel / apart) + 2, int((end - start) * pixel / apart) + 2) if tabled else (1, 1))
        if tabled:
            seen_weights(corner_x, corner_y, apart, weights, clipped if rim_tabled else 0.0, reach, slants[entry])
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
            stop, right = max(stop, seen_start), min(right, seen_end)
            while stop < right:
                # The longest run of pixels of one sort.
                column, stop = stop, min(right, stop + BLOCK)
                for change in (full_start, full_end, clear_start, clear_end):
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
                                    shares[p], look = part_share(x, y, side, slope, reach, rim, nodes)
                                    points[EX + p], points[EY + p] = look * x, look * y
                            if blurred and clear:
                                strip_means(points, number, landing, cone, strip, count, sums, near, far, chunks, slant)
                            for p in range(number):
                                ex, ey, value = points[EX + p], points[EY + p], 1.0
                                if shares[p] <= 0.0:
                                    continue
                                if blurred and clear:
                                    value = points[MEAN + p]
                                elif blurred and points_a_side > 0:
                                    value = 0.0
                                    for way in ways[entry]:
                                        moved_to[:] = maps[entry]
                                        moved_to[0] += way
                                        value += sampled_mean(
                                            ex,
                                            ey,
                                            cones[entry],
                                            moved_to,
                                            row_nodes,
                                            chord,
                                            points_a_side,
                                            side,
                                            RULED,
                                            numbers,
                                            table,
                                            law,
                                            no_sums,
                                            slants[entry],
                                        )
                                    value /= ways.shape[1]
                                elif blurred:
                                    across = (origin_y + cyx * ex + cyy * ey, up_along, up_across)
                                    value = weighted_mean(
                                        ex, ey, landing, cone, strip_end, count_end, sums, near, far, chunks, slant, across, window
                                    )
                                elif askew and not clear:
                                    at_x, at_y = origin_x + cxx * ex + cxy * ey, origin_y + cyx * ex + cyy * ey
                                    seen = 0.0
                                    for way in ways[entry]:
                                        seen += ruled_parallelogram(
                                            at_x + way, at_y, cxx * side, cyx * side, cxy * side, cyy * side, lower, upper, table, law
                                        )
                                    value = seen / (ways.shape[1] * abs(cxx * cyy - cxy * cyx) * side * side)
                                elif by_column and not full:
                                    value = steady[1 + i, column + p - start]
                                elif varies:
                                    box = 0 if full else 1
                                    at = origin_x + cxx * ex + cxy * ey
                                    value = moved_mean(at, boxes[box, 0], boxes[box, 1], table, law, ways[entry])
                                if not (blurred or clear or askew):
                                    value *= window_mean(origin_y + cyx * ex + cyy * ey, lower, upper, window[2], window[3])
                                light[p] += shares[p] * min(max(value, 0.0), 1.0) / (divide * divide)
                if falls and (full or rim_tabled):
                    for p in range(number):
                        light[p] *= read_between((xs[column + p] - centre_x - corner_x) / apart, (dy - corner_y) / apart, weights)
                elif uneven:
                    for p in range(number):
                        light[p] *= cut_weight(xs[column + p] - centre_x, dy, width, slope, reach, slants[entry], nodes)
                elif falls:
                    for p in range(number):
                        light[p] *= seen_weight(xs[column + p] - centre_x, dy, clipped, reach, slants[entry])
                for p in range(number):
                    image[row, column + p] += level * light[p]

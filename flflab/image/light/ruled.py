"""Images of targets that vary along one direction (bars, chirp), end at a straight line (edge), or
are plain white.

The radiance is profile(x') times a window in y', where x' and y' are target axes turned as the
target asks. Over the pupil, strips along the gradient of x' are summed; along each strip the mean
of the profile is exact, and so is the mean over the pixel.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.falloff_means import (
    CUT,
    EACH,
    READ,
    is_uneven,
    read_around,
    seen_weights,
    table_steps,
    weigh_cells,
)
from flflab.image.geometry.rim import part_share, rim_share
from flflab.image.geometry.tiles import shrink
from flflab.image.light.ruled_seen import (
    EVENLY,
    RuledSeen,
    antiderivatives,
    askew_mean,
    columns_between,
    end_at,
    lit_columns,
    rim_boxes,
    rim_shares,
)
from flflab.image.light.strips import BLOCK, EX, EY, MEAN, ROWS, WEIGHT, strip_means, window_mean
from flflab.image.radiance.parallelogram import stands_askew
from flflab.image.radiance.profile import moved_mean

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# of white: what is left in the last pixels of a rim, times the 3/2 power of half its width, where
# only its columns are cut
EDGE = 0.04
# of white, times the same power of its whole width: what four points of a pixel leave that is
# OFF_ENDS from a rim's ends
EVEN = 0.0015
OFF_ENDS = 1.25  # pixels


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_ruled(image: Array, rows: tuple[int, int], windows: Whole, seen: RuledSeen) -> None:
    """Add the light of every entry to the rows from rows[0] to below rows[1] of an image.

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last, of every entry;
            shape (N, 4).
        seen: the target.
    """
    lenses = seen.lenses
    xs, ys, pixel, width, wanted = lenses.xs, lenses.ys, lenses.pixel, lenses.width, lenses.wanted
    chunks, fine, table, law, bounds = seen.chunks, seen.fine, seen.table, seen.law, seen.bounds
    varies = table.shape[0] > 0
    window, moved_to = np.empty(4), np.empty(lenses.maps.shape[1])
    window[:2] = bounds
    lit = np.zeros((2, 0))
    places, boxes, sums, piece = (
        np.zeros((3, 4)),
        np.zeros((3, 2)),
        np.zeros(2),
        np.zeros(4, dtype=np.int64),
    )
    points, shares, light, aside = (
        np.zeros(ROWS * BLOCK),
        np.zeros(BLOCK),
        np.zeros(BLOCK),
        np.zeros(BLOCK),
    )
    cells = np.zeros((int(seen.divided.max()) ** 2, BLOCK))
    for entry in range(windows.shape[0]):
        first, last = max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])
        start, end = windows[entry, 0], windows[entry, 1]
        if wanted.size > 0:
            start, end, first, last = shrink(wanted, start, end, first, last)
        if first >= last or start >= end:
            continue
        kind, to, slant, ways = (
            lenses.kinds[entry],
            lenses.maps[entry],
            lenses.slants[entry],
            seen.ways[entry],
        )
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
        whole, divided = int(seen.whole[kind]), int(seen.divided[kind])
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
        by_column, full_by_column = (
            upright and not blurred,
            upright and not (blurred and chunks > 0),
        )
        even = (
            not (varies or steep)
            and divided == 1
            and rim_parts > 2
            and EVEN * (0.5 * width / abs(slope)) ** 1.5 < 4.0 * fine
        )
        beside = (
            math.sqrt((1.0 - 1.0 / (rim_parts * rim_parts)) / 12.0) * width
        )  # the rim's table smooths the rest
        nearer, farther = (
            abs(reach - abs(slope)) + OFF_ENDS * width,
            reach + abs(slope) - OFF_ENDS * width,
        )
        quick = (
            by_column
            and divided == 1
            and not steep
            and (rim_parts == 1 or EDGE * (width / abs(slope)) ** 1.5 < 4.0 * fine)
        )
        steady = np.ones((1 + rim_parts, end - start if full_by_column else 0))
        if full_by_column and blurred:
            for block in range(start, end, BLOCK):
                number = min(BLOCK, end - block)
                for p in range(number):
                    points[EX + p], points[EY + p] = xs[block + p] - centre_x, 0.0
                strip_means(
                    points,
                    number,
                    landing,
                    (0.0, reach),
                    strip,
                    count,
                    sums,
                    places[0],
                    places[0],
                    0,
                    slants,
                )
                for p in range(number):
                    steady[0, block + p - start] = points[MEAN + p]
        elif full_by_column and varies:
            for column in range(start, end):
                at = origin_x + cxx * (xs[column] - centre_x)
                steady[0, column - start] = moved_mean(
                    at, whole * boxes[0, 0], 0.0, table, law, ways
                )
                for i in range(rim_parts):
                    shifted = at + cxx * ((i + 0.5) / rim_parts - 0.5) * width
                    steady[1 + i, column - start] = moved_mean(
                        shifted, boxes[1, 0], 0.0, table, law, ways
                    )
        falls = chunks > 0 and not blurred
        if falls and divided > 1 and full_by_column:
            lit = np.zeros((2, end - start))
            for column in range(start, end):
                at = origin_x + cxx * (xs[column] - centre_x)
                lit[0, column - start], lit[1, column - start] = lit_columns(
                    at, cxx, width, whole, table, law, ways
                )
        clipped = (
            slope if 2.0 * abs(slope) > width / divided else 0.0
        )  # what holds all of the rim sees the whole pupil
        whole_step, rim_step = table_steps(slope, reach, slant, seen.fall)
        uneven = falls and is_uneven(slope, reach, slant, width / divided, seen.fall)
        rim_tabled = rim_step >= pixel / divided and not uneven
        tabled = falls and (rim_tabled or deep > 0.0)
        apart = min(
            max(rim_step if rim_tabled else whole_step, 0.5 * pixel / divided),
            max(end - start, last - first) * pixel,
        )
        corner_x, corner_y = xs[start] - centre_x - 0.5 * pixel, ys[first] - centre_y - 0.5 * pixel
        grid, cones = (
            (corner_x, corner_y, apart, clipped if rim_tabled else 0.0, reach),
            (slope, clipped, reach),
        )
        places_y, places_x = (
            int((last - first) * pixel / apart) + 2,
            int((end - start) * pixel / apart) + 2,
        )
        asked = (
            4
            * divided
            * divided
            * (
                np.sum(wanted[first:last, start:end])
                if wanted.size > 0
                else (last - first) * (end - start)
            )
        )
        tabled = (
            tabled and places_x * places_y <= asked
        )  # else what pixels read of it is worked out for each
        weights = np.ones((places_y, places_x) if tabled else (0, 0))
        if tabled:
            seen_weights(corner_x, corner_y, apart, weights, grid[3], reach, slant)
        for row in range(first, last):
            dy = ys[row] - centre_y
            room = outside * outside - dy * dy
            if room <= 0.0:
                continue
            half = math.sqrt(room)
            stop = max(start, math.ceil((centre_x - half - xs[0]) / pixel))
            right = min(end, math.floor((centre_x + half - xs[0]) / pixel) + 1)
            height = origin_y + cyx * (xs[0] - centre_x) + cyy * dy
            seen_start, seen_end = columns_between(
                lower - felt, upper + felt, height, cyx * pixel, len(xs)
            )
            clear_start, clear_end = columns_between(
                lower + felt, upper - felt, height, cyx * pixel, len(xs)
            )
            half = math.sqrt(max(deep * deep - dy * dy, 0.0))
            full_start, full_end = (
                columns_between(-half, half, xs[0] - centre_x, pixel, len(xs))
                if deep > abs(dy)
                else (0, 0)
            )
            half = math.sqrt(max(farther * farther - dy * dy, 0.0))
            even_start, even_end = (
                columns_between(-half, half, xs[0] - centre_x, pixel, len(xs))
                if even and half > 0.0
                else (0, 0)
            )
            half = math.sqrt(max(nearer * nearer - dy * dy, 0.0))
            hole_start, hole_end = (
                columns_between(-half, half, xs[0] - centre_x, pixel, len(xs))
                if even and half > 0.0
                else (0, 0)
            )
            stop, right = max(stop, seen_start), min(right, seen_end)
            while stop < right:
                # The longest run of pixels of one sort.
                column, stop = stop, min(right, stop + BLOCK)
                for change in (
                    full_start,
                    full_end,
                    clear_start,
                    clear_end,
                    even_start,
                    even_end,
                    hole_start,
                    hole_end,
                ):
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
                number, weighed, by = (
                    stop - column,
                    False,
                    READ if full or rim_tabled else (CUT if uneven else EACH),
                )
                for p in range(number):
                    aside[p] = xs[column + p] - centre_x
                if full and clear and full_by_column:
                    for p in range(number):
                        light[p] = steady[0, column + p - start]
                    weighed = falls and divided > 1
                    if weighed:
                        for p in range(number):
                            x = xs[column + p] - centre_x + lit[0, column + p - start]
                            light[p] *= read_around(
                                x,
                                dy,
                                lit[1, column + p - start],
                                EVENLY * width,
                                weights,
                                grid,
                                slant,
                            )
                elif (
                    clear
                    and even_start <= column < even_end
                    and not hole_start <= column < hole_end
                ):
                    light[:number] = 0.0
                    for y in (dy - beside, dy + beside):
                        for x in (-beside, beside):
                            rim_shares(points, number, xs, column, x - centre_x, y, rim)
                            for p in range(number):
                                light[p] += 0.25 * points[WEIGHT + p]
                elif clear and quick:
                    light[:number] = 0.0
                    for i in range(rim_parts):
                        rim_shares(
                            points,
                            number,
                            xs,
                            column,
                            ((i + 0.5) / rim_parts - 0.5) * width - centre_x,
                            dy,
                            rim,
                        )
                        for p in range(number):
                            light[p] += points[WEIGHT + p] * steady[1 + i, column + p - start]
                    for p in range(number):
                        light[p] /= rim_parts
                else:
                    divide, weighed = whole if full else rim_parts, divided > 1
                    side, near, far, grain = (
                        width / divide,
                        places[0 if full else 1],
                        places[0 if full else 2],
                        min(divided, divide),
                    )
                    if falls and weighed:
                        weigh_cells(
                            cells,
                            number,
                            aside,
                            dy,
                            grain,
                            width,
                            by,
                            weights,
                            grid,
                            cones,
                            slant,
                            lenses.nodes,
                        )
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
                                shares[p] = (
                                    1.0
                                    if full or steep
                                    else rim_share(math.sqrt(x * x + y * y), rim)
                                )
                            if steep and not full:
                                for p in range(number):
                                    x = points[EX + p]
                                    shares[p], look = part_share(
                                        x, y, side, slope, reach, rim, lenses.nodes
                                    )
                                    points[EX + p], points[EY + p] = look * x, look * y
                            if falls and weighed:
                                cell = (j * grain // divide) * grain + i * grain // divide
                                for p in range(number):
                                    shares[p] *= cells[cell, p]
                            if blurred and clear:
                                strip_means(
                                    points,
                                    number,
                                    landing,
                                    cone,
                                    strip,
                                    count,
                                    sums,
                                    near,
                                    far,
                                    chunks,
                                    slants,
                                )
                            for p in range(number):
                                if shares[p] <= 0.0:
                                    continue
                                ex, ey, value = points[EX + p], points[EY + p], 1.0
                                at_x, at_y = (
                                    origin_x + cxx * ex + cxy * ey,
                                    origin_y + cyx * ex + cyy * ey,
                                )
                                if blurred and clear:
                                    value = points[MEAN + p]
                                elif blurred:
                                    value = end_at(
                                        ex,
                                        ey,
                                        side,
                                        landing,
                                        entry,
                                        seen,
                                        sums,
                                        near,
                                        far,
                                        window,
                                        moved_to,
                                    )
                                elif askew and not clear:
                                    value = askew_mean(
                                        at_x, at_y, side, to, table, law, ways, window
                                    )
                                elif by_column and not full:
                                    value = steady[1 + i, column + p - start]
                                elif varies:
                                    value = moved_mean(at_x, box_x, box_y, table, law, ways)
                                if not (blurred or clear or askew):
                                    value *= window_mean(
                                        at_y, window[0], window[1], window[2], window[3]
                                    )
                                light[p] += (
                                    shares[p] * min(max(value, 0.0), 1.0) / (divide * divide)
                                )
                if falls and not weighed:
                    weigh_cells(
                        cells,
                        number,
                        aside,
                        dy,
                        1,
                        width,
                        by,
                        weights,
                        grid,
                        cones,
                        slant,
                        lenses.nodes,
                    )
                    for p in range(number):
                        light[p] *= cells[0, p]
                for p in range(number):
                    image[row, column + p] += level * light[p]

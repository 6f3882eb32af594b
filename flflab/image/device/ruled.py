"""One pixel of bars, an edge or white, as a thread works it out: by the same formulas as ``add_ruled``, which does whole rows at a time.

Long for its lists of arguments: a kernel takes arrays and numbers.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.falloff_means import cut_weight, is_uneven, seen_weight, table_steps
from flflab.image.neighbourhood import RULED
from flflab.image.parallelogram import ruled_parallelogram, stands_askew
from flflab.image.profile import moved_mean
from flflab.image.rim import part_share, rim_share
from flflab.image.ruled import EDGE, antiderivatives, columns_between, rim_boxes
from flflab.image.sampled import sampled_mean
from flflab.image.strips import weighted_mean, window_mean

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

ROOM = 14  # numbers to work in


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_tables(
    pieces: Whole,
    entries: Whole,
    kinds: Whole,
    centres: Array,
    cones: Array,
    maps: Array,
    sharp: Chosen,
    parts: Whole,
    rims: Array,
    xs: Array,
    ys: Array,
    pixel: float,
    width: float,
    fine: float,
    table: Array,
    law: Array,
    ways: Array,
    most: int,
) -> tuple[Array, Whole, Array, Array]:
    """The antiderivatives of the profile that every piece of a micro-image reads from.

    ``pieces`` and ``entries`` are as in ``cut_windows``, the rest as in ``add_ruled``. Where there are more than ``most``, those that
    follow are missing.

    Returns:
        Antiderivatives one behind the other, where each piece's begin in them (M + 1), and each piece's places (M, 3, 4) and boxes
        (M, 3, 2); see ``prepare``.
    """
    count = pieces.shape[0]
    begins, places, boxes = np.zeros(count + 1, dtype=np.int64), np.zeros((count, 3, 4)), np.zeros((count, 3, 2))
    held = np.empty(1024)
    for piece in range(count):
        entry, begin = entries[piece], begins[piece]
        kind = kinds[entry]
        rim_boxes(cones[entry, 0], maps[entry], width, int(parts[kind]), rims[kind, 0] < 0.0, boxes[piece])
        begins[piece + 1] = begin
        if table.shape[0] > 0 and not sharp[entry] and begin <= most:
            sums = antiderivatives(
                pieces[piece], centres[entry], maps[entry], xs, ys, pixel, boxes[piece], fine, table, law, ways[entry], places[piece]
            )
            begins[piece + 1] += sums.size
            if begins[piece + 1] > held.size:
                larger = np.empty(2 * begins[piece + 1])
                larger[:begin] = held[:begin]
                held = larger
            held[begin : begins[piece + 1]] = sums
    return held[: begins[-1]].copy(), begins, places, boxes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weight_between(column: float, row: float, left: float, bottom: float, step: float, slope: float, reach: float, slant: Array) -> float:
    """What ``read_between`` reads from the table that ``seen_weights`` makes: the four places round one are worked out at once."""
    i, j = int(column), int(row)
    u, v = column - i, row - j
    x, y = left + i * step, bottom + j * step
    low = (1.0 - u) * seen_weight(x, y, slope, reach, slant) + u * seen_weight(left + (i + 1) * step, y, slope, reach, slant)
    y = bottom + (j + 1) * step
    high = (1.0 - u) * seen_weight(x, y, slope, reach, slant) + u * seen_weight(left + (i + 1) * step, y, slope, reach, slant)
    return (1.0 - v) * low + v * high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_light(
    row: int,
    column: int,
    window: Whole,
    centre: Array,
    cone: Array,
    to: Array,
    slant: Array,
    sharp: bool,
    rim_parts: int,
    counts: Whole,
    strips: Array,
    points: int,
    row_nodes: Array,
    chord: Array,
    chunks: int,
    fall: float,
    rim: Array,
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
    sums: Array,
    places: Array,
    boxes: Array,
    moved_to: Array,
    ends: Array,
) -> float:
    """Share of the full cone that a pixel gets through one entry: what ``add_ruled`` makes of a row of pixels.

    Args:
        row: of the pixel.
        column: the same.
        window: the piece of the entry's window that the pixel lies in, see ``cut_windows``.
        centre: the entry's own, as the following up to ``chord``; see ``add_ruled``.
        cone: the same.
        to: the same: its maps to the target.
        slant: the same.
        sharp: the same.
        rim_parts: the same.
        counts: the same, shape (2,).
        strips: the same, shape (2, 3, most strips).
        points: points a side across the pupil at the window's ends; 0 for strips.
        row_nodes: the same.
        chord: the same.
        chunks: see ``add_ruled``, as the following up to ``bounds``.
        fall: the same.
        rim: the same, of the entry's kind.
        nodes: the same.
        xs: the same.
        ys: the same.
        pixel: the same.
        width: the same.
        fine: the same.
        table: the same.
        law: the same.
        ways: the same, of the entry.
        bounds: the same.
        numbers: what ``mean_over`` asks for: the upper bound.
        no_sums: of no picture.
        sums: the piece's antiderivatives, see ``ruled_tables``.
        places: the same.
        boxes: the same.
        moved_to: scratch, shape (10,).
        ends: scratch, shape (4,).
    """
    slope, reach = cone[0], cone[1]
    dx, dy = xs[column] - centre[0], ys[row] - centre[1]
    outside, deep = reach + abs(slope) + 0.75 * width, reach - abs(slope) - 0.75 * width
    room = outside * outside - dy * dy
    if room <= 0.0:
        return 0.0
    half = math.sqrt(room)
    if column < math.ceil((centre[0] - half - xs[0]) / pixel) or column > math.floor((centre[0] + half - xs[0]) / pixel):
        return 0.0
    origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = to
    spread = math.hypot(xx, xy)
    along_x, along_y = (xx / spread, xy / spread) if spread > 0.0 else (1.0, 0.0)
    up_along, up_across = yx * along_x + yy * along_y, yy * along_x - yx * along_y
    lower, upper = bounds[0], bounds[1]
    felt = abs(up_along) + abs(up_across) + (abs(cyx) + abs(cyy)) * width
    height = origin_y + cyx * (xs[0] - centre[0]) + cyy * dy
    first, last = columns_between(lower - felt, upper + felt, height, cyx * pixel, len(xs))
    if not first <= column < last:
        return 0.0
    first, last = columns_between(lower + felt, upper - felt, height, cyx * pixel, len(xs))
    clear = first <= column < last
    half = math.sqrt(max(deep * deep - dy * dy, 0.0))
    first, last = columns_between(-half, half, xs[0] - centre[0], pixel, len(xs)) if deep > abs(dy) else (0, 0)
    full = first <= column < last
    landing, slants = (origin_x, cxx, cxy, spread, along_x, along_y), (slant[0], slant[1], slant[2], slant[3])
    varies, steep = table.shape[0] > 0, rim[0] < 0.0
    blurred, upright = varies and not sharp, cxy == 0.0 or not varies
    quick = upright and not blurred and not steep and (rim_parts == 1 or EDGE * (width / abs(slope)) ** 1.5 < 4.0 * fine)
    everywhere = (0.0, 0.0, 0.0)
    ends[0], ends[1], ends[2], ends[3] = -math.inf, math.inf, 0.0, 0.0
    light = 0.0
    if full and clear and upright and not (blurred and chunks > 0):
        light = 1.0
        if blurred:
            whole = (0.0, reach)
            light = weighted_mean(
                dx, 0.0, landing, whole, strips[0], int(counts[0]), sums, places[0], places[0], 0, slants, everywhere, ends
            )
        elif varies:
            light = moved_mean(origin_x + cxx * dx, boxes[0, 0], 0.0, table, law, ways)
    elif clear and quick:
        for i in range(rim_parts):
            shift = ((i + 0.5) / rim_parts - 0.5) * width
            seen = moved_mean(origin_x + cxx * dx + cxx * shift, boxes[1, 0], 0.0, table, law, ways) if varies else 1.0
            light += seen * rim_share(math.sqrt((dx + shift) ** 2 + dy * dy), rim) / rim_parts
    else:
        askew = varies and width > 0.0 and stands_askew(to[2:])
        divide = 1 if full else rim_parts
        side, near, far = width / divide, places[0 if full else 1], places[0 if full else 2]
        for j in range(divide):
            y = dy + ((j + 0.5) / divide - 0.5) * width
            for i in range(divide):
                x, value = dx + ((i + 0.5) / divide - 0.5) * width, 1.0
                share, look = (1.0, 1.0) if full else part_share(x, y, side, slope, reach, rim, nodes)
                if share <= 0.0:
                    continue
                ex, ey = look * x, look * y
                at_x, at_y = origin_x + cxx * ex + cxy * ey, origin_y + cyx * ex + cyy * ey
                if blurred and clear:
                    value = weighted_mean(
                        ex, ey, landing, (slope, reach), strips[0], int(counts[0]), sums, near, far, chunks, slants, everywhere, ends
                    )
                elif blurred and points > 0:
                    value = 0.0
                    for k in range(10):
                        moved_to[k] = to[k]
                    for m in range(ways.size):
                        moved_to[0] = to[0] + ways[m]
                        value += sampled_mean(
                            ex, ey, cone, moved_to, row_nodes, chord, points, side, RULED, numbers, table, law, no_sums, slant
                        )
                    value /= ways.size
                elif blurred:
                    across = (at_y, up_along, up_across)
                    ends[0], ends[1], ends[2], ends[3] = lower, upper, abs(cyx) * side, abs(cyy) * side
                    value = weighted_mean(
                        ex, ey, landing, (slope, reach), strips[1], int(counts[1]), sums, near, far, chunks, slants, across, ends
                    )
                elif askew and not clear:
                    value = 0.0
                    for m in range(ways.size):
                        value += ruled_parallelogram(
                            at_x + ways[m], at_y, cxx * side, cyx * side, cxy * side, cyy * side, lower, upper, table, law
                        )
                    value /= ways.size * abs(cxx * cyy - cxy * cyx) * side * side
                elif varies:
                    box = 0 if full else 1
                    other = 0.0 if upright and not full else boxes[box, 1]
                    at = origin_x + cxx * x if upright and not full else at_x
                    value = moved_mean(at, boxes[box, 0], other, table, law, ways)
                if not (blurred or clear or askew):
                    value *= window_mean(at_y, lower, upper, abs(cyx) * side, abs(cyy) * side)
                light += share * min(max(value, 0.0), 1.0) / (divide * divide)
    if chunks > 0 and not blurred:
        clipped = slope if 2.0 * abs(slope) > width else 0.0  # a pixel that holds all of the rim sees the whole pupil
        whole_step, rim_step = table_steps(slope, reach, slant, fall)
        uneven = is_uneven(slope, reach, slant, width, fall)
        tabled = rim_step >= pixel and not uneven
        if full or tabled:
            span = max(window[1] - window[0], window[3] - window[2]) * pixel
            apart = min(max(rim_step if tabled else whole_step, 0.5 * pixel), span)
            left, bottom = xs[window[0]] - centre[0] - 0.5 * pixel, ys[window[2]] - centre[1] - 0.5 * pixel
            seen = clipped if tabled else 0.0
            light *= weight_between((dx - left) / apart, (dy - bottom) / apart, left, bottom, apart, seen, reach, slant)
        elif uneven:
            light *= cut_weight(dx, dy, width, slope, reach, slant, nodes)
        else:
            light *= seen_weight(dx, dy, clipped, reach, slant)
    return light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_pixel(
    light: float,
    row: int,
    column: int,
    near: Whole,
    room: Array,
    pieces: Whole,
    entries: Whole,
    held: Array,
    begins: Whole,
    places: Array,
    boxes: Array,
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
) -> float:
    """The light of a pixel with what it gets through the entries near it, in their order.

    ``near`` are the pieces that may hold the pixel (see ``pieces_by_block``), ``room`` is scratch of shape (ROOM,), what follows up to
    ``boxes`` is as in ``cut_windows`` and ``ruled_tables``, and from there on as in ``add_ruled``.
    """
    if wanted.size > 0 and not wanted[row, column]:
        return light
    for piece in near:
        window = pieces[piece]
        if column < window[0] or column >= window[1] or row < window[2] or row >= window[3]:
            continue
        entry = entries[piece]
        kind, own = kinds[entry], grid[entry]
        light += float(levels[entry]) * ruled_light(
            row,
            column,
            window,
            centres[entry],
            cones[entry],
            maps[entry],
            slants[entry],
            bool(sharp[entry]),
            int(parts[kind]),
            counts[kind],
            strips[kind],
            int(grids[own]),
            rows_of_points[own],
            chords[own],
            chunks,
            fall,
            rims[kind],
            nodes,
            xs,
            ys,
            pixel,
            width,
            fine,
            table,
            law,
            ways[entry],
            bounds,
            numbers,
            no_sums,
            held[begins[piece] : begins[piece + 1]],
            places[piece],
            boxes[piece],
            room[:10],
            room[10:],
        )
    return light

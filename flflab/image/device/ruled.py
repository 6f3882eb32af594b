"""One pixel of bars, an edge or white, as a thread works it out: by the same formulas as
``add_ruled``, which does whole rows at a time.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.device.pieces import Pieces, holds
from flflab.image.geometry.falloff_means import (
    cut_weight,
    is_uneven,
    read_weight,
    seen_weight,
    table_steps,
)
from flflab.image.geometry.rim import part_share, rim_share
from flflab.image.light.ruled import EDGE, EVEN, OFF_ENDS
from flflab.image.light.ruled_seen import (
    EVENLY,
    RuledSeen,
    antiderivatives,
    askew_mean,
    columns_between,
    end_at,
    lit_columns,
    rim_boxes,
)
from flflab.image.light.strips import weighted_mean, window_mean
from flflab.image.radiance.parallelogram import stands_askew
from flflab.image.radiance.profile import moved_mean

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

ROOM = 14  # numbers to work in


class RuledTables(NamedTuple):
    """The antiderivatives of the profile that every piece of a micro-image reads from.

    Attributes:
        held: all of them, one piece's behind the other's.
        begins: where each piece's begin, (M + 1).
        places: see ``prepare``, (M, 3, 4).
        boxes: see ``rim_boxes``, (M, 3, 2).
    """

    held: Array
    begins: Whole
    places: Array
    boxes: Array


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_tables(pieces: Pieces, seen: RuledSeen, most: int) -> RuledTables:
    """Make what the pieces read from; where there is more than ``most``, what follows is
    missing.
    """
    count = len(pieces.entries)
    begins, places, boxes = (
        np.zeros(count + 1, dtype=np.int64),
        np.zeros((count, 3, 4)),
        np.zeros((count, 3, 2)),
    )
    held = np.empty(1024)
    for piece in range(count):
        entry, begin = int(pieces.entries[piece]), begins[piece]
        rim_boxes(seen, entry, boxes[piece])
        begins[piece + 1] = begin
        if seen.table.shape[0] > 0 and not seen.sharp[entry] and begin <= most:
            sums = antiderivatives(seen, entry, pieces.windows[piece], boxes[piece], places[piece])
            begins[piece + 1] += sums.size
            if begins[piece + 1] > held.size:
                larger = np.empty(2 * begins[piece + 1])
                larger[:begin] = held[:begin]
                held = larger
            held[begin : begins[piece + 1]] = sums
    return RuledTables(held[: begins[-1]].copy(), begins, places, boxes)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def falling_weight(
    x: float, y: float, full: bool, window: Whole, entry: int, seen: RuledSeen
) -> float:
    """What the fall-off leaves of a pixel, or of a part of it, where blur is negligible, as
    ``add_ruled`` has it from its tables.
    """
    lenses = seen.lenses
    slope, reach, slant, pixel = (
        lenses.cones[entry, 0],
        lenses.cones[entry, 1],
        lenses.slants[entry],
        lenses.pixel,
    )
    grain = int(seen.divided[lenses.kinds[entry]])
    side = lenses.width / grain
    clipped = (
        slope if 2.0 * abs(slope) > side else 0.0
    )  # what holds all of the rim sees the whole pupil
    whole_step, rim_step = table_steps(slope, reach, slant, seen.fall)
    uneven = is_uneven(slope, reach, slant, side, seen.fall)
    tabled = rim_step >= pixel / grain and not uneven
    if full or tabled:
        span = max(window[1] - window[0], window[3] - window[2]) * pixel
        apart = min(max(rim_step if tabled else whole_step, 0.5 * pixel / grain), span)
        left = lenses.xs[window[0]] - lenses.centres[entry, 0] - 0.5 * pixel
        bottom = lenses.ys[window[2]] - lenses.centres[entry, 1] - 0.5 * pixel
        return read_weight(
            x, y, seen.table[:0], (left, bottom, apart, clipped if tabled else 0.0, reach), slant
        )
    if uneven:
        return cut_weight(x, y, side, slope, reach, slant, lenses.nodes)
    return seen_weight(x, y, clipped, reach, slant)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_light(
    row: int,
    column: int,
    window: Whole,
    entry: int,
    seen: RuledSeen,
    sums: Array,
    places: Array,
    boxes: Array,
    moved_to: Array,
    ends: Array,
) -> float:
    """Share of the full cone that a pixel gets through one entry: what ``add_ruled`` makes of a row
    of pixels.

    Args:
        row: of the pixel.
        column: the same.
        window: the piece of the entry's window that the pixel lies in.
        entry: the entry.
        seen: the target.
        sums: the piece's antiderivatives, see ``RuledTables``.
        places: the same.
        boxes: the same.
        moved_to: scratch, shape (10,).
        ends: scratch, shape (4,).
    """
    lenses, table, law, ways, chunks = (
        seen.lenses,
        seen.table,
        seen.law,
        seen.ways[entry],
        seen.chunks,
    )
    kind, slant, xs, pixel, width = (
        lenses.kinds[entry],
        lenses.slants[entry],
        lenses.xs,
        lenses.pixel,
        lenses.width,
    )
    slope, reach = lenses.cones[entry, 0], lenses.cones[entry, 1]
    dx, dy = xs[column] - lenses.centres[entry, 0], lenses.ys[row] - lenses.centres[entry, 1]
    outside, deep = reach + abs(slope) + 0.75 * width, reach - abs(slope) - 0.75 * width
    room = outside * outside - dy * dy
    if room <= 0.0:
        return 0.0
    half, centre = math.sqrt(room), lenses.centres[entry, 0]
    if column < math.ceil((centre - half - xs[0]) / pixel) or column > math.floor(
        (centre + half - xs[0]) / pixel
    ):
        return 0.0
    origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = lenses.maps[entry]
    spread = math.hypot(xx, xy)
    along_x, along_y = (xx / spread, xy / spread) if spread > 0.0 else (1.0, 0.0)
    lower, upper = seen.bounds[0], seen.bounds[1]
    felt = (
        abs(yx * along_x + yy * along_y)
        + abs(yy * along_x - yx * along_y)
        + (abs(cyx) + abs(cyy)) * width
    )
    height = origin_y + cyx * (xs[0] - centre) + cyy * dy
    first, last = columns_between(lower - felt, upper + felt, height, cyx * pixel, len(xs))
    if not first <= column < last:
        return 0.0
    first, last = columns_between(lower + felt, upper - felt, height, cyx * pixel, len(xs))
    clear = first <= column < last
    half = math.sqrt(max(deep * deep - dy * dy, 0.0))
    first, last = (
        columns_between(-half, half, xs[0] - centre, pixel, len(xs)) if deep > abs(dy) else (0, 0)
    )
    full = first <= column < last
    landing, slants = (
        (origin_x, cxx, cxy, spread, along_x, along_y),
        (slant[0], slant[1], slant[2], slant[3]),
    )
    rim, rim_parts, strips, count = (
        lenses.rims[kind],
        int(lenses.parts[kind]),
        seen.strips[kind, 0],
        int(seen.counts[kind, 0]),
    )
    varies, steep, everywhere = table.shape[0] > 0, rim[0] < 0.0, (0.0, 0.0, 0.0)
    whole, divided = int(seen.whole[kind]), int(seen.divided[kind])
    blurred, upright, weighed = varies and not seen.sharp[entry], cxy == 0.0 or not varies, False
    quick = (
        upright
        and divided == 1
        and not blurred
        and not steep
        and (rim_parts == 1 or EDGE * (width / abs(slope)) ** 1.5 < 4.0 * seen.fine)
    )
    light, distance, beside = (
        0.0,
        math.hypot(dx, dy),
        math.sqrt((1.0 - 1.0 / (rim_parts * rim_parts)) / 12.0) * width,
    )
    even = (
        not (varies or steep)
        and divided == 1
        and rim_parts > 2
        and EVEN * (0.5 * width / abs(slope)) ** 1.5 < 4.0 * seen.fine
    )
    off_ends = (
        abs(reach - abs(slope)) + OFF_ENDS * width
        < distance
        <= reach + abs(slope) - OFF_ENDS * width
    )
    ends[0], ends[1], ends[2], ends[3] = -math.inf, math.inf, 0.0, 0.0
    if full and clear and upright and not (blurred and chunks > 0):
        light = 1.0
        if blurred:
            unclipped = (0.0, reach)
            light = weighted_mean(
                dx,
                0.0,
                landing,
                unclipped,
                strips,
                count,
                sums,
                places[0],
                places[0],
                0,
                slants,
                everywhere,
                ends,
            )
        elif varies:
            light = moved_mean(origin_x + cxx * dx, whole * boxes[0, 0], 0.0, table, law, ways)
        weighed = chunks > 0 and divided > 1
        if weighed:
            middle, beside_x = lit_columns(origin_x + cxx * dx, cxx, width, whole, table, law, ways)
            total = 0.0
            for y in (dy - EVENLY * width, dy + EVENLY * width):
                for x in (dx + middle - beside_x, dx + middle + beside_x):
                    total += 0.25 * falling_weight(x, y, True, window, entry, seen)
            light *= total
    elif clear and even and off_ends:
        for y in (dy - beside, dy + beside):
            for x in (dx - beside, dx + beside):
                light += 0.25 * rim_share(math.sqrt(x * x + y * y), rim)
    elif clear and quick:
        for i in range(rim_parts):
            x = dx + ((i + 0.5) / rim_parts - 0.5) * width
            value = (
                moved_mean(origin_x + cxx * x, boxes[1, 0], 0.0, table, law, ways)
                if varies
                else 1.0
            )
            light += value * rim_share(math.sqrt(x * x + dy * dy), rim) / rim_parts
    else:
        askew, divide = (
            varies and width > 0.0 and stands_askew(lenses.maps[entry, 2:]),
            whole if full else rim_parts,
        )
        weighed, grain = divided > 1, min(divided, divide)
        side, near, far = width / divide, places[0 if full else 1], places[0 if full else 2]
        for j in range(divide):
            y = dy + ((j + 0.5) / divide - 0.5) * width
            for i in range(divide):
                x = dx + ((i + 0.5) / divide - 0.5) * width
                share, look = (
                    (1.0, 1.0) if full else part_share(x, y, side, slope, reach, rim, lenses.nodes)
                )
                if share <= 0.0:
                    continue
                if weighed and chunks > 0 and not blurred:
                    cell_x = ((i * grain // divide + 0.5) / grain - 0.5) * width
                    cell_y = ((j * grain // divide + 0.5) / grain - 0.5) * width
                    share *= falling_weight(dx + cell_x, dy + cell_y, full, window, entry, seen)
                ex, ey, value = look * x, look * y, 1.0
                if blurred and clear:
                    value = weighted_mean(
                        ex,
                        ey,
                        landing,
                        (slope, reach),
                        strips,
                        count,
                        sums,
                        near,
                        far,
                        chunks,
                        slants,
                        everywhere,
                        ends,
                    )
                else:
                    at_x, at_y = origin_x + cxx * ex + cxy * ey, origin_y + cyx * ex + cyy * ey
                    ends[0], ends[1], ends[2], ends[3] = (
                        lower,
                        upper,
                        abs(cyx) * side,
                        abs(cyy) * side,
                    )
                    if blurred:
                        value = end_at(
                            ex, ey, side, landing, entry, seen, sums, near, far, ends, moved_to
                        )
                    elif askew and not clear:
                        value = askew_mean(
                            at_x, at_y, side, lenses.maps[entry], table, law, ways, ends
                        )
                    elif upright and not full and varies:
                        value = moved_mean(origin_x + cxx * x, boxes[1, 0], 0.0, table, law, ways)
                    elif varies:
                        box = 0 if full else 1
                        value = moved_mean(at_x, boxes[box, 0], boxes[box, 1], table, law, ways)
                    if not (blurred or clear or askew):
                        value *= window_mean(at_y, lower, upper, ends[2], ends[3])
                light += share * min(max(value, 0.0), 1.0) / (divide * divide)
    if weighed or blurred or chunks == 0:
        return light
    return light * falling_weight(dx, dy, full, window, entry, seen)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ruled_pixel(
    light: float,
    row: int,
    column: int,
    near: Whole,
    room: Array,
    pieces: Pieces,
    tables: RuledTables,
    seen: RuledSeen,
) -> float:
    """The light of a pixel with what it gets through the entries near it, in their order.

    Args:
        light: of the pixel before.
        row: of the pixel.
        column: the same.
        near: the pieces that may hold the pixel, see ``pieces_by_block``.
        room: scratch, shape (ROOM,).
        pieces: all pieces.
        tables: what they read from.
        seen: the target.
    """
    for piece in near:
        window = pieces.windows[piece]
        if holds(window, row, column, seen.lenses.wanted):
            entry, sums = (
                int(pieces.entries[piece]),
                tables.held[tables.begins[piece] : tables.begins[piece + 1]],
            )
            places, boxes = tables.places[piece], tables.boxes[piece]
            seen_light = ruled_light(
                row, column, window, entry, seen, sums, places, boxes, room[:10], room[10:]
            )
            light += float(seen.lenses.levels[entry]) * seen_light
    return light

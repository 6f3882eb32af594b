"""Images of pictures: along strips of the pupil on which y' stays the same, the mean over chord and pixel is exact.

The mean over a box of pixel size is a second difference of the picture's summed-area table; along a strip it is a difference of that
table's antiderivative in x'. Both tables are made for the part of the picture that an entry sees, so that no digits are lost.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.clipping import clip, lens_span
from flflab.image.falloff_means import seen_weight
from flflab.image.neighbourhood import PICTURE
from flflab.image.parallelogram import parallelogram_sum
from flflab.image.rim import part_share
from flflab.image.sampled import sampled_mean
from flflab.image.tiles import shrink
from flflab.optics.discs import lens_chord

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

LEAST_BOX = 1e-3  # texels; a smaller pixel sees as much as this
FRAME = 17  # numbers, see ``seen_texels``


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_sums(values: Array, column: int, row: int, columns: int, rows: int) -> Array:
    """Summed-area table and its antiderivative in x' for texels from (column, row) on; texels outside the picture are black.

    Returns:
        Shape (rows + 1, columns + 1, 2), in units of a texel's area, and of that times a texel's width.
    """
    sums = np.zeros((rows + 1, columns + 1, 2))
    for j in range(rows):
        total = 0.0
        for i in range(columns):
            if 0 <= row + j < values.shape[0] and 0 <= column + i < values.shape[1]:
                total += values[row + j, column + i]
            sums[j + 1, i + 1, 0] = sums[j, i + 1, 0] + total
            sums[j + 1, i + 1, 1] = sums[j + 1, i, 1] + 0.5 * (sums[j + 1, i, 0] + sums[j + 1, i + 1, 0])
    return sums


@numba.njit(cache=True, nogil=True, error_model="numpy")
def row_of(sums: Array, y: float) -> tuple[int, float]:
    """Row of the tables and part of the next one at a height in texels."""
    y = min(max(y, 0.0), sums.shape[0] - 1.0)
    row = min(int(y), sums.shape[0] - 2)
    return row, y - row


@numba.njit(cache=True, nogil=True, error_model="numpy")
def column_sum(sums: Array, column: int, table: int, row1: int, part1: float, row2: int, part2: float) -> float:
    """One of the tables at a column, summed between two heights; differences of neighbouring rows first, that no digits are lost."""
    if row1 == row2:
        return (part2 - part1) * (sums[row1 + 1, column, table] - sums[row1, column, table])
    total = (1.0 - part1) * (sums[row1 + 1, column, table] - sums[row1, column, table])
    total += part2 * (sums[row2 + 1, column, table] - sums[row2, column, table])
    return total + sums[row2, column, table] - sums[row1 + 1, column, table]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def summed(sums: Array, x: float, row1: int, part1: float, row2: int, part2: float) -> tuple[float, float]:
    """Both tables at x texels from the first texel on, between two heights."""
    inside = min(max(x, 0.0), sums.shape[1] - 1.0)
    i = min(int(inside), sums.shape[1] - 2)
    u = inside - i
    area = column_sum(sums, i, 0, row1, part1, row2, part2)
    step = column_sum(sums, i + 1, 0, row1, part1, row2, part2) - area
    start = column_sum(sums, i, 1, row1, part1, row2, part2) + u * (area + 0.5 * u * step)
    area += u * step
    return area, start + area * (x - inside)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def boxed_sum(sums: Array, x: float, y: float, width: float, height: float, order: int) -> float:
    """Mean radiance in a box round (x, y) (order 0), or its antiderivative in x (order 1); all in texels."""
    row1, part1 = row_of(sums, y - 0.5 * height)
    row2, part2 = row_of(sums, y + 0.5 * height)
    right = summed(sums, x + 0.5 * width, row1, part1, row2, part2)[order]
    left = summed(sums, x - 0.5 * width, row1, part1, row2, part2)[order]
    return (right - left) / (width * height)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texels_mean(
    x: float,
    y: float,
    spread: Array,
    clip_x: float,
    clip_y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    boxes: Array,
    chunks: int,
    slant: tuple[float, float, float],
    sums: Array,
) -> float:
    """Mean radiance over a clipped pupil.

    Args:
        x: x' at the pupil's centre, texels of the tables.
        y: y' there.
        spread: change of x' along the strips, of x' across them, and of y' across them, over the pupil's radius, texels.
        clip_x: centre of the clipping disc along the strips, in units of the pupil.
        clip_y: the same across them.
        radius: of the clipping disc.
        low: where the strips begin.
        high: where they end.
        strips: see ``strip_nodes``.
        count: how many there are.
        boxes: width of a pixel on the target, the same for ends at the clipping disc, height; texels.
        chunks: into how many pieces a strip is cut for the fall-off; 0 for none.
        slant: slope at the sensor of the ray through the pupil's centre along the strips and across them, its change over the radius.
        sums: the tables.
    """
    light, area = 0.0, 0.0
    pieces = max(chunks, 1)
    for strip in range(count):
        at = 0.5 * (low + high) + 0.5 * (high - low) * strips[0, strip]
        left, right = lens_chord(clip_x, clip_y, radius, at)
        if right <= left:
            continue
        own = math.sqrt(max(0.0, 1.0 - at * at))
        area += strips[1, strip] * (right - left)
        height = y + spread[2] * at
        thick = spread[2] * 0.5 * (high - low) * strips[1, strip]
        tall = math.sqrt(boxes[2] * boxes[2] + thick * thick)
        base = x + spread[1] * at
        before = boxed_sum(sums, base + spread[0] * left, height, boxes[0] if left <= -own else boxes[1], tall, 1)
        part = (right - left) / pieces
        for piece in range(pieces):
            end = left + part * (piece + 1)
            cut = piece == pieces - 1 and right < own
            after = boxed_sum(sums, base + spread[0] * end, height, boxes[1] if cut else boxes[0], tall, 1)
            weight = strips[1, strip]
            if chunks > 0:
                along, across = slant[0] + slant[2] * (end - 0.5 * part), slant[1] + slant[2] * at
                weight /= (1.0 + along * along + across * across) ** 2
            light += weight * (after - before)
            before = after
    return light / (spread[0] * area) if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_texels(
    window: Whole, centre: Array, to: Array, blurred: bool, xs: Array, ys: Array, width: float, texel: float, values: Array, frame: Array
) -> tuple[int, int, int, int]:
    """Which texels an entry sees through a window on the sensor, and its maps to them.

    Args:
        window: first column, column after the last, first row, row after the last.
        centre: of the micro-image, mm.
        to: the maps to the target, see ``add_ruled``.
        blurred: whether strips will be summed.
        xs: positions of the columns, mm.
        ys: positions of the rows, mm.
        width: side of a pixel that gathers light, mm.
        texel: side of a texel, mm.
        values: the radiance [row, column].
        frame: filled, FRAME numbers: the maps in texels from the middle of those seen, the changes along and across the strips (see
            ``texels_mean``), the strips' direction, and where x' and y' are 0, in texels from the first one seen.

    Returns:
        First column, first row, number of columns, number of rows; no texel is seen where a number is not above 0.
    """
    frame[:10] = to / texel
    origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = frame[:10]
    along_x, along_y = 1.0, 0.0
    if blurred:
        steepest = math.hypot(yx, yy)
        sign = 1.0 if xx * yy - xy * yx > 0.0 else -1.0
        along_x, along_y = sign * yy / steepest, -sign * yx / steepest
    frame[10] = xx * along_x + xy * along_y
    frame[11] = xy * along_x - xx * along_y
    frame[12] = yy * along_x - yx * along_y
    frame[13], frame[14] = along_x, along_y
    middle_x, middle_y = 0.5 * (xs[window[0]] + xs[window[1] - 1]) - centre[0], 0.5 * (ys[window[2]] + ys[window[3] - 1]) - centre[1]
    half_x, half_y = 0.5 * (xs[window[1] - 1] - xs[window[0]]) + width, 0.5 * (ys[window[3] - 1] - ys[window[2]]) + width
    reach_x = abs(cxx) * half_x + abs(cxy) * half_y + 2.0 * math.hypot(xx, xy) + 2.0
    reach_y = abs(cyx) * half_x + abs(cyy) * half_y + 2.0 * math.hypot(yx, yy) + 2.0
    seen_x = origin_x + cxx * middle_x + cxy * middle_y + 0.5 * values.shape[1]
    seen_y = origin_y + cyx * middle_x + cyy * middle_y + 0.5 * values.shape[0]
    column = int(min(max(math.floor(seen_x - reach_x), -1.0), values.shape[1]))
    row = int(min(max(math.floor(seen_y - reach_y), -1.0), values.shape[0]))
    columns = int(min(max(math.ceil(seen_x + reach_x), 0.0), values.shape[1] + 1.0)) - column
    rows = int(min(max(math.ceil(seen_y + reach_y), 0.0), values.shape[0] + 1.0)) - row
    frame[15], frame[16] = origin_x + 0.5 * values.shape[1] - column, origin_y + 0.5 * values.shape[0] - row
    frame[0], frame[1] = frame[15] - 0.5 * columns, frame[16] - 0.5 * rows
    return column, row, columns, rows


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_light(
    dx: float,
    dy: float,
    width: float,
    cone: Array,
    frame: Array,
    slants: Array,
    sharp: bool,
    parts: int,
    askew: bool,
    divided: int,
    points: int,
    row_nodes: Array,
    chord: Array,
    count: int,
    strips: Array,
    chunks: int,
    rim: Array,
    nodes: Array,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
    areas: Array,
    boxes: Array,
) -> float:
    """Share of the full cone that a pixel gets from a picture through one microlens.

    Args:
        dx: the pixel's middle from the micro-image's centre, mm.
        dy: the same along y.
        width: its side, mm.
        cone: slope and reach, mm.
        frame: see ``seen_texels``.
        slants: see ``add_ruled``; 0 where no fall-off is asked for.
        sharp: whether the blur is negligible.
        parts: parts a side of a pixel in the rim.
        askew: whether pixels do not lie along the target's axes.
        divided: then parts a side of a blurred pixel, which count as squares along those axes.
        points: points a side across the pupil; 0 for strips.
        row_nodes: see ``strip_nodes``.
        chord: see ``chord_nodes``.
        count: number of strips.
        strips: see ``strip_nodes``.
        chunks: pieces of a strip for the fall-off; 0 for no fall-off.
        rim: see ``rim_tables``; a steep one starts with a negative distance.
        nodes: pupil points for steep rims.
        numbers: what ``mean_over`` asks for: a texel's side in texels.
        table: of no picture.
        law: the same.
        sums: see ``fill_sums``.
        areas: its first table alone.
        boxes: scratch, shape (3,).
    """
    slope, reach = cone[0], cone[1]
    distance = math.sqrt(dx * dx + dy * dy)
    if distance > reach + abs(slope) + 0.75 * width:
        return 0.0
    xx, cxx, cxy, cyx, cyy, along_x, along_y = frame[2], frame[6], frame[7], frame[8], frame[9], frame[13], frame[14]
    blurred, steep = not sharp and points == 0, rim[0] < 0.0
    divided = divided if blurred else 1
    radius = reach / abs(slope) if slope != 0.0 else 2.0
    full = distance <= reach - abs(slope) - 0.75 * width
    divide = divided if full else max(divided, parts)
    side = width / divide
    if not askew:
        boxes[0], boxes[2] = abs(cxx) * side, abs(cyy) * side
        boxes[1] = abs(cxx + xx / slope) * side if blurred and not steep and slope != 0.0 else boxes[0]
    else:
        boxes[0] = math.sqrt(abs(cxx * cyy - cxy * cyx)) * side
        boxes[1], boxes[2] = boxes[0], boxes[0]
    for index in range(3):
        boxes[index] = max(boxes[index], LEAST_BOX)
    light = 0.0
    for j in range(divide):
        y = dy + ((j + 0.5) / divide - 0.5) * width
        for i in range(divide):
            x = dx + ((i + 0.5) / divide - 0.5) * width
            share, look = (1.0, 1.0) if full else part_share(x, y, side, slope, reach, rim, nodes)
            if share <= 0.0:
                continue
            ex, ey = look * x, look * y
            if points > 0:
                value = sampled_mean(ex, ey, cone, frame[:10], row_nodes, chord, points, side, PICTURE, numbers, table, law, areas, slants)
                light += share * min(max(value, 0.0), 1.0)
                continue
            at_x, at_y = frame[15] + cxx * ex + cxy * ey, frame[16] + cyx * ex + cyy * ey
            if blurred:
                clip_x, clip_y = clip(ex, ey, along_x, along_y, slope, reach)
                low, high = lens_span(clip_x, clip_y, radius)
                slant_x, slant_y = slants[0] + slants[2] * ex, slants[1] + slants[2] * ey
                slant = (slant_x * along_x + slant_y * along_y, slant_y * along_x - slant_x * along_y, slants[3])
                value = texels_mean(at_x, at_y, frame[10:13], clip_x, clip_y, radius, low, high, strips, count, boxes, chunks, slant, sums)
            elif askew and boxes[0] > LEAST_BOX:
                seen = parallelogram_sum(at_x, at_y, cxx * side, cyx * side, cxy * side, cyy * side, areas)
                value = seen / (boxes[0] * boxes[0])
            else:
                value = boxed_sum(sums, at_x, at_y, boxes[0], boxes[2], 0)
            if not blurred and chunks > 0:
                value *= seen_weight(ex, ey, slope, reach, slants)
            light += share * min(max(value, 0.0), 1.0)
    return light / (divide * divide)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_texels(
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
    askew: bool,
    divisions: Whole,
    grid: Whole,
    grids: Whole,
    rows_of_points: Array,
    chords: Array,
    counts: Whole,
    strips: Array,
    chunks: int,
    rims: Array,
    nodes: Array,
    xs: Array,
    ys: Array,
    width: float,
    texel: float,
    values: Array,
    numbers: Array,
    table: Array,
    law: Array,
    wanted: Chosen,
) -> None:
    """Add the light of a picture, seen by every entry, to a band of rows.

    Arguments as in ``add_ruled`` and ``texel_light``, and: ``divisions`` of every entry and ``counts`` for each kind; ``grid``, which of
    the ``grids`` (points a side across the pupil; ``rows_of_points`` and ``chords`` are their nodes) an entry is summed by; ``texel``,
    side of a texel in mm; ``values``, the radiance [row, column].
    """
    boxes, frame, window = np.empty(3), np.empty(FRAME), np.empty(4, dtype=np.int64)
    for entry in range(windows.shape[0]):
        first, last = max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])
        start, end = windows[entry, 0], windows[entry, 1]
        if wanted.size > 0:
            start, end, first, last = shrink(wanted, start, end, first, last)
        if first >= last or start >= end:
            continue
        kind, own = kinds[entry], grid[entry]
        points = int(grids[own])
        window[0], window[1], window[2], window[3] = start, end, first, last
        blurred = not sharp[entry] and points == 0
        column, row, columns, deep = seen_texels(window, centres[entry], maps[entry], blurred, xs, ys, width, texel, values, frame)
        if columns <= 0 or deep <= 0:
            continue
        sums = fill_sums(values, column, row, columns, deep)
        areas = np.ascontiguousarray(sums[:, :, 0])
        for y in range(first, last):
            for x in range(start, end):
                if wanted.size > 0 and not wanted[y, x]:
                    continue
                image[y, x] += levels[entry] * texel_light(
                    xs[x] - centres[entry, 0],
                    ys[y] - centres[entry, 1],
                    width,
                    cones[entry],
                    frame,
                    slants[entry],
                    sharp[entry],
                    int(parts[kind]),
                    askew,
                    int(divisions[entry]),
                    points,
                    rows_of_points[own],
                    chords[own],
                    int(counts[kind]),
                    strips[kind],
                    chunks,
                    rims[kind],
                    nodes,
                    numbers,
                    table,
                    law,
                    sums,
                    areas,
                    boxes,
                )

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
    wanted: Chosen,
) -> None:
    """Add the light of a picture, seen by every entry, to a band of rows.

    Arguments as in ``add_ruled``, and: ``askew``, whether pixels do not lie along the target's axes; then ``divisions``, parts a side of
    a blurred pixel of every entry, which count as squares along those axes, and ``grid``, which of the ``grids`` (points a side across
    the pupil, 0 for strips; ``rows_of_points`` and ``chords`` are their nodes) an entry is summed by; ``counts`` strips for each kind;
    ``texel``, side of a texel in mm; ``values``, the radiance [row, column].
    """
    boxes, spread = np.empty(3), np.zeros(3)
    to, still, numbers, table, law = np.empty(10), np.zeros(4), np.array([1.0, 0.0, 0.0]), np.zeros((0, 8)), np.zeros(5)
    for entry in range(windows.shape[0]):
        first, last = max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])
        start, end = windows[entry, 0], windows[entry, 1]
        if wanted.size > 0:
            start, end, first, last = shrink(wanted, start, end, first, last)
        if first >= last or start >= end:
            continue
        kind = kinds[entry]
        slope, reach = cones[entry, 0], cones[entry, 1]
        origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = maps[entry] / texel
        points = int(grids[grid[entry]])
        blurred = not sharp[entry] and points == 0
        divided = divisions[entry] if blurred else 1
        along_x, along_y = 1.0, 0.0
        if blurred:
            steepest = math.hypot(yx, yy)
            sign = 1.0 if xx * yy - xy * yx > 0.0 else -1.0
            along_x, along_y = sign * yy / steepest, -sign * yx / steepest
            spread[0] = xx * along_x + xy * along_y
            spread[1] = xy * along_x - xx * along_y
            spread[2] = yy * along_x - yx * along_y
        across_x, across_y = math.hypot(xx, xy), math.hypot(yx, yy)
        middle_x, middle_y = 0.5 * (xs[start] + xs[end - 1]) - centres[entry, 0], 0.5 * (ys[first] + ys[last - 1]) - centres[entry, 1]
        half_x, half_y = 0.5 * (xs[end - 1] - xs[start]) + width, 0.5 * (ys[last - 1] - ys[first]) + width
        reach_x = abs(cxx) * half_x + abs(cxy) * half_y + 2.0 * across_x + 2.0
        reach_y = abs(cyx) * half_x + abs(cyy) * half_y + 2.0 * across_y + 2.0
        seen_x = origin_x + cxx * middle_x + cxy * middle_y + 0.5 * values.shape[1]
        seen_y = origin_y + cyx * middle_x + cyy * middle_y + 0.5 * values.shape[0]
        column = int(min(max(math.floor(seen_x - reach_x), -1.0), values.shape[1]))
        row = int(min(max(math.floor(seen_y - reach_y), -1.0), values.shape[0]))
        columns = int(min(max(math.ceil(seen_x + reach_x), 0.0), values.shape[1] + 1.0)) - column
        deep_rows = int(min(max(math.ceil(seen_y + reach_y), 0.0), values.shape[0] + 1.0)) - row
        if columns <= 0 or deep_rows <= 0:
            continue
        sums = fill_sums(values, column, row, columns, deep_rows)
        areas = np.ascontiguousarray(sums[:, :, 0])
        to[:] = maps[entry] / texel
        to[0] += 0.5 * values.shape[1] - column - 0.5 * columns
        to[1] += 0.5 * values.shape[0] - row - 0.5 * deep_rows
        corner_x, corner_y = origin_x + 0.5 * values.shape[1] - column, origin_y + 0.5 * values.shape[0] - row
        rim, strip, count = rims[kind], strips[kind], int(counts[kind])
        steep = rim[0] < 0.0
        radius = reach / abs(slope) if slope != 0.0 else 2.0
        deep, outside = reach - abs(slope) - 0.75 * width, reach + abs(slope) + 0.75 * width
        for y_index in range(first, last):
            dy = ys[y_index] - centres[entry, 1]
            for x_index in range(start, end):
                if wanted.size > 0 and not wanted[y_index, x_index]:
                    continue
                dx = xs[x_index] - centres[entry, 0]
                distance = math.sqrt(dx * dx + dy * dy)
                if distance > outside:
                    continue
                full = distance <= deep
                divide = divided if full else max(divided, int(parts[kind]))
                side = width / divide
                light = 0.0
                if not askew:
                    boxes[0], boxes[2] = abs(cxx) * side, abs(cyy) * side
                    boxes[1] = abs(cxx + xx / slope) * side if blurred and not steep and slope != 0.0 else boxes[0]
                else:
                    boxes[0] = math.sqrt(abs(cxx * cyy - cxy * cyx)) * side
                    boxes[1], boxes[2] = boxes[0], boxes[0]
                for index in range(3):
                    boxes[index] = max(boxes[index], LEAST_BOX)
                for j in range(divide):
                    y = dy + ((j + 0.5) / divide - 0.5) * width
                    for i in range(divide):
                        x = dx + ((i + 0.5) / divide - 0.5) * width
                        share, look = (1.0, 1.0) if full else part_share(x, y, side, slope, reach, rim, nodes)
                        if share <= 0.0:
                            continue
                        ex, ey = look * x, look * y
                        if points > 0:
                            value = sampled_mean(
                                ex,
                                ey,
                                cones[entry],
                                to,
                                rows_of_points[grid[entry]],
                                chords[grid[entry]],
                                points,
                                side,
                                PICTURE,
                                numbers,
                                table,
                                law,
                                areas,
                                slants[entry] if chunks > 0 else still,
                            )
                            light += share * min(max(value, 0.0), 1.0)
                            continue
                        at_x, at_y = corner_x + cxx * ex + cxy * ey, corner_y + cyx * ex + cyy * ey
                        clip_x, clip_y = clip(ex, ey, along_x, along_y, slope, reach)
                        low, high = lens_span(clip_x, clip_y, radius)
                        slant_x, slant_y = slants[entry, 0] + slants[entry, 2] * ex, slants[entry, 1] + slants[entry, 2] * ey
                        slant = (slant_x * along_x + slant_y * along_y, slant_y * along_x - slant_x * along_y, slants[entry, 3])
                        if blurred:
                            value = texels_mean(
                                at_x, at_y, spread, clip_x, clip_y, radius, low, high, strip, count, boxes, chunks, slant, sums
                            )
                        elif askew and boxes[0] > LEAST_BOX:
                            seen = parallelogram_sum(at_x, at_y, cxx * side, cyx * side, cxy * side, cyy * side, areas)
                            value = seen / (boxes[0] * boxes[0])
                        else:
                            value = boxed_sum(sums, at_x, at_y, boxes[0], boxes[2], 0)
                        if not blurred and chunks > 0:
                            value *= seen_weight(ex, ey, slope, reach, slants[entry])
                        light += share * min(max(value, 0.0), 1.0)
                image[y_index, x_index] += levels[entry] * light / (divide * divide)

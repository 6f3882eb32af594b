"""Means of a picture over boxes and along chords of the pupil, from sums of its texels.

The mean over a box of pixel size is a second difference of the picture's summed-area table; along a strip it is a difference of that
table's antiderivative in x'. Both tables are made for the part of the picture that an entry sees, so that no digits are lost.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.optics.discs import lens_chord

Array = npt.NDArray[np.float64]


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

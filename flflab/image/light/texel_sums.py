"""Means of a picture over boxes and along chords of the pupil, from sums of its texels.

The mean over a box of pixel size is a second difference of the picture's summed-area table; along a
strip it is a difference of that table's antiderivative in x'. Both tables are made for the part of
the picture that an entry sees, so that no digits are lost.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.optics.discs import lens_chord

Array = npt.NDArray[np.float64]
Rows = tuple[int, float, int, float]  # see ``rows_between``

SHORT = 2.0  # texels, chord and pixel together: below, chords are summed texel by texel


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_sums(values: Array, column: int, row: int, columns: int, rows: int) -> Array:
    """Summed-area table and its antiderivative in x' for texels from (column, row) on; texels
    outside the picture are black.

    Returns:
        Shape (rows + 1, columns + 1, 2), in units of a texel's area, and of that times a texel's
        width.
    """
    sums = np.zeros((rows + 1, columns + 1, 2))
    for j in range(rows):
        total = 0.0
        for i in range(columns):
            if 0 <= row + j < values.shape[0] and 0 <= column + i < values.shape[1]:
                total += values[row + j, column + i]
            sums[j + 1, i + 1, 0] = sums[j, i + 1, 0] + total
            sums[j + 1, i + 1, 1] = sums[j + 1, i, 1] + 0.5 * (
                sums[j + 1, i, 0] + sums[j + 1, i + 1, 0]
            )
    return sums


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rows_between(sums: Array, y: float, height: float) -> Rows:
    """Row of the tables and part of the next one at the lower end of a box round y, and the same at
    its upper end; all in texels.
    """
    low, high = (
        min(max(y - 0.5 * height, 0.0), sums.shape[0] - 1.0),
        min(max(y + 0.5 * height, 0.0), sums.shape[0] - 1.0),
    )
    first, last = min(int(low), sums.shape[0] - 2), min(int(high), sums.shape[0] - 2)
    return first, low - first, last, high - last


@numba.njit(cache=True, nogil=True, error_model="numpy")
def column_sum(sums: Array, column: int, table: int, rows: Rows) -> float:
    """One of the tables at a column, summed between two heights; differences of neighbouring rows
    first, that no digits are lost.
    """
    row1, part1, row2, part2 = rows
    if row1 == row2:
        return (part2 - part1) * (sums[row1 + 1, column, table] - sums[row1, column, table])
    total = (1.0 - part1) * (sums[row1 + 1, column, table] - sums[row1, column, table])
    total += part2 * (sums[row2 + 1, column, table] - sums[row2, column, table])
    return total + sums[row2, column, table] - sums[row1 + 1, column, table]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def summed(sums: Array, x: float, rows: Rows) -> tuple[float, float]:
    """Both tables at x texels from the first texel on, between two heights."""
    inside = min(max(x, 0.0), sums.shape[1] - 1.0)
    i = min(int(inside), sums.shape[1] - 2)
    u = inside - i
    area = column_sum(sums, i, 0, rows)
    step = column_sum(sums, i + 1, 0, rows) - area
    start = column_sum(sums, i, 1, rows) + u * (area + 0.5 * u * step)
    area += u * step
    return area, start + area * (x - inside)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texels_between(sums: Array, column: int, rows: Rows) -> float:
    """Sum of a column of texels between two heights."""
    if column < 0 or column > sums.shape[1] - 2:
        return 0.0
    return column_sum(sums, column + 1, 0, rows) - column_sum(sums, column, 0, rows)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def summed_from(sums: Array, column: int, x: float, rows: Rows) -> float:
    """The second table at x texels from a column's left side on, between two heights, were both
    tables 0 there.
    """
    area, start = 0.0, 0.0
    while x > 1.0:
        texels = texels_between(sums, column, rows)
        start += area + 0.5 * texels
        area += texels
        column, x = column + 1, x - 1.0
    while x < 0.0:
        column, x = column - 1, x + 1.0
        texels = texels_between(sums, column, rows)
        start -= area - 0.5 * texels
        area -= texels
    return start + x * (area + 0.5 * x * texels_between(sums, column, rows))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def boxed_sum(sums: Array, x: float, y: float, width: float, height: float) -> float:
    """Mean radiance in a box round (x, y); all in texels."""
    rows = rows_between(sums, y, height)
    return (summed(sums, x + 0.5 * width, rows)[0] - summed(sums, x - 0.5 * width, rows)[0]) / (
        width * height
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def chord_sum(
    sums: Array, x: float, left: float, right: float, left_box: float, right_box: float, rows: Rows
) -> float:
    """Radiance summed along a chord, between two heights, in a box that may be wider at the chord's
    one end than at its other.

    Short chords are counted from the texel they lie in: as a difference of the tables' large
    numbers a sliver of the pupil, a millionth of a texel wide, would lose its digits.

    Args:
        sums: the tables.
        x: where the chord is counted from, texels of the tables.
        left: where it begins, texels from there.
        right: where it ends, the same.
        left_box: width of the box at its beginning.
        right_box: the same at its end.
        rows: see ``rows_between``.
    """
    left1, left2, right1, right2 = (
        left - 0.5 * left_box,
        left + 0.5 * left_box,
        right - 0.5 * right_box,
        right + 0.5 * right_box,
    )
    if right2 - left1 < SHORT:
        column = int(x + 0.5 * (left + right))
        x -= column
        before = summed_from(sums, column, x + left2, rows) - summed_from(
            sums, column, x + left1, rows
        )
        after = summed_from(sums, column, x + right2, rows) - summed_from(
            sums, column, x + right1, rows
        )
    else:
        before = summed(sums, x + left2, rows)[1] - summed(sums, x + left1, rows)[1]
        after = summed(sums, x + right2, rows)[1] - summed(sums, x + right1, rows)[1]
    return after / right_box - before / left_box


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
        spread: change of x' along the strips, of x' across them, and of y' across them, over the
            pupil's radius, texels.
        clip_x: centre of the clipping disc along the strips, in units of the pupil.
        clip_y: the same across them.
        radius: of the clipping disc.
        low: where the strips begin.
        high: where they end.
        strips: see ``strip_nodes``.
        count: how many there are.
        boxes: width of a pixel on the target, the same for ends at the clipping disc, height;
            texels.
        chunks: into how many pieces a strip is cut for the fall-off; 0 for none.
        slant: slope at the sensor of the ray through the pupil's centre along the strips and across
            them, its change over the radius.
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
        thick = spread[2] * 0.5 * (high - low) * strips[1, strip]
        tall = math.sqrt(boxes[2] * boxes[2] + thick * thick)
        rows = rows_between(sums, y + spread[2] * at, tall)
        base, part = x + spread[1] * at, (right - left) / pieces
        for piece in range(pieces):
            begin, end = left + part * piece, left + part * (piece + 1)
            first_box = boxes[1] if piece == 0 and left > -own else boxes[0]
            last_box = boxes[1] if piece == pieces - 1 and right < own else boxes[0]
            weight = strips[1, strip] / tall
            if chunks > 0:
                along, across = slant[0] + slant[2] * (end - 0.5 * part), slant[1] + slant[2] * at
                weight /= (1.0 + along * along + across * across) ** 2
            light += weight * chord_sum(
                sums, base, spread[0] * begin, spread[0] * end, first_box, last_box, rows
            )
    return light / (spread[0] * area) if area > 0.0 else 0.0

"""Images of pictures: along strips of the pupil on which y' stays the same, the mean over chord and
pixel is exact (``texel_sums``).
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.clipping import clip, lens_span
from flflab.image.geometry.falloff_means import seen_weight
from flflab.image.geometry.rim import part_share
from flflab.image.geometry.tiles import shrink
from flflab.image.light.even_texels import even_radiance
from flflab.image.light.lenses import Lenses
from flflab.image.light.sampled import LEAST_BOX, sampled_mean
from flflab.image.light.texel_sums import boxed_sum, fill_sums, texels_mean
from flflab.image.radiance.neighbourhood import PICTURE
from flflab.image.radiance.parallelogram import parallelogram_sum

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

FRAME = 19  # numbers, see ``seen_texels``


class PictureSeen(NamedTuple):
    """A picture round x' = y' = 0 as all entries see it.

    Attributes:
        lenses: the entries.
        sharp: entries whose blur is negligible.
        askew: whether pixels do not lie along the target's axes.
        divisions: parts a side of a pixel of every entry: for its fall-off, and where it is blurred
            and askew, as parts count as squares along those axes.
        grid: which of the grids of points across the pupil an entry is summed by.
        grids: how many points a side each has; 0 for strips.
        rows_of_points: see ``strip_nodes``; (G, 2, most points).
        chords: see ``chord_nodes``; the same.
        counts: number of strips for each kind of rim.
        strips: see ``strip_nodes``; (K, 3, most strips).
        chunks: pieces of a strip for the fall-off; 0 for no fall-off.
        texel: side of a texel, mm.
        values: the radiance [row, column].
        borders: see ``count_borders``.
        numbers: what ``mean_over`` asks for: a texel's side in texels.
        table: of no bars.
        law: the same.
    """

    lenses: Lenses
    sharp: Chosen
    askew: bool
    divisions: Whole
    grid: Whole
    grids: Whole
    rows_of_points: Array
    chords: Array
    counts: Whole
    strips: Array
    chunks: int
    texel: float
    values: Array
    borders: npt.NDArray[np.int32]
    numbers: Array
    table: Array
    law: Array


class PictureLens(NamedTuple):
    """What every pixel of an entry needs: the arrays of ``PictureSeen`` and ``Lenses`` at that
    entry.

    Gathered once an entry, for handing a pixel all arrays takes longer than a sharp picture does.
    """

    cone: Array
    slants: Array
    width: float
    parts: int
    rim: Array
    nodes: Array
    blurred: bool
    askew: bool
    divided: int
    points: int
    row_nodes: Array
    chord: Array
    strip_count: int
    strips: Array
    chunks: int
    values: Array
    borders: npt.NDArray[np.int32]
    numbers: Array
    table: Array
    law: Array


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_blurred(seen: PictureSeen, entry: int) -> bool:
    """Whether an entry's light is summed over strips of the pupil."""
    return not seen.sharp[entry] and seen.grids[seen.grid[entry]] == 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_texels(
    seen: PictureSeen, entry: int, window: Whole, frame: Array
) -> tuple[int, int, int, int]:
    """Which texels an entry sees through a window on the sensor, and its maps to them.

    Args:
        seen: the picture.
        entry: the entry.
        window: first column, column after the last, first row, row after the last.
        frame: filled, FRAME numbers: the maps in texels from the middle of those seen, the changes
            along and across the strips (see ``texels_mean``), the strips' direction, where x' and
            y' are 0, in texels from the first one seen, and that one's column and row.

    Returns:
        First column, first row, number of columns, number of rows; no texel is seen where a number
        is not above 0.
    """
    lenses, high, wide = seen.lenses, seen.values.shape[0], seen.values.shape[1]
    xs, ys = lenses.xs, lenses.ys
    frame[:10] = lenses.maps[entry] / seen.texel
    origin_x, origin_y, xx, xy, yx, yy, cxx, cxy, cyx, cyy = frame[:10]
    along_x, along_y = 1.0, 0.0
    if is_blurred(seen, entry):
        steepest = math.hypot(yx, yy)
        sign = 1.0 if xx * yy - xy * yx > 0.0 else -1.0
        along_x, along_y = sign * yy / steepest, -sign * yx / steepest
    frame[10] = xx * along_x + xy * along_y
    frame[11] = xy * along_x - xx * along_y
    frame[12] = yy * along_x - yx * along_y
    frame[13], frame[14] = along_x, along_y
    middle_x = 0.5 * (xs[window[0]] + xs[window[1] - 1]) - lenses.centres[entry, 0]
    middle_y = 0.5 * (ys[window[2]] + ys[window[3] - 1]) - lenses.centres[entry, 1]
    half_x, half_y = (
        0.5 * (xs[window[1] - 1] - xs[window[0]]) + lenses.width,
        0.5 * (ys[window[3] - 1] - ys[window[2]]) + lenses.width,
    )
    reach_x = abs(cxx) * half_x + abs(cxy) * half_y + 2.0 * math.hypot(xx, xy) + 2.0
    reach_y = abs(cyx) * half_x + abs(cyy) * half_y + 2.0 * math.hypot(yx, yy) + 2.0
    seen_x = origin_x + cxx * middle_x + cxy * middle_y + 0.5 * wide
    seen_y = origin_y + cyx * middle_x + cyy * middle_y + 0.5 * high
    column = int(min(max(math.floor(seen_x - reach_x), -1.0), wide))
    row = int(min(max(math.floor(seen_y - reach_y), -1.0), high))
    columns = int(min(max(math.ceil(seen_x + reach_x), 0.0), wide + 1.0)) - column
    rows = int(min(max(math.ceil(seen_y + reach_y), 0.0), high + 1.0)) - row
    frame[15], frame[16] = origin_x + 0.5 * wide - column, origin_y + 0.5 * high - row
    frame[0], frame[1] = frame[15] - 0.5 * columns, frame[16] - 0.5 * rows
    frame[17], frame[18] = column, row
    return column, row, columns, rows


@numba.njit(cache=True, nogil=True, error_model="numpy")
def picture_lens(seen: PictureSeen, entry: int) -> PictureLens:
    """Gather what the pixels of an entry need."""
    lenses, kind, own = seen.lenses, seen.lenses.kinds[entry], seen.grid[entry]
    blurred = is_blurred(seen, entry)
    return PictureLens(
        lenses.cones[entry],
        lenses.slants[entry],
        lenses.width,
        int(lenses.parts[kind]),
        lenses.rims[kind],
        lenses.nodes,
        blurred,
        seen.askew,
        int(seen.divisions[entry]),
        int(seen.grids[own]),
        seen.rows_of_points[own],
        seen.chords[own],
        int(seen.counts[kind]),
        seen.strips[kind],
        seen.chunks,
        seen.values,
        seen.borders,
        seen.numbers,
        seen.table,
        seen.law,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_light(
    dx: float, dy: float, lens: PictureLens, frame: Array, sums: Array, areas: Array, boxes: Array
) -> float:
    """Share of the full cone that a pixel gets from a picture through one entry.

    Args:
        dx: the pixel's middle from the micro-image's centre, mm.
        dy: the same along y.
        lens: the entry.
        frame: see ``seen_texels``.
        sums: see ``fill_sums``.
        areas: its first table alone.
        boxes: scratch, shape (3,).
    """
    slope, reach, slant, width, blurred = (
        lens.cone[0],
        lens.cone[1],
        lens.slants,
        lens.width,
        lens.blurred,
    )
    distance = math.sqrt(dx * dx + dy * dy)
    if distance > reach + abs(slope) + 0.75 * width:
        return 0.0
    xx, cxx, cxy, cyx, cyy, along_x, along_y = (
        frame[2],
        frame[6],
        frame[7],
        frame[8],
        frame[9],
        frame[13],
        frame[14],
    )
    radius = reach / abs(slope) if slope != 0.0 else 2.0
    full = distance <= reach - abs(slope) - 0.75 * width
    divide = lens.divided if full else max(lens.divided, lens.parts)
    side = width / divide
    if not lens.askew:
        boxes[0], boxes[2] = abs(cxx) * side, abs(cyy) * side
        boxes[1] = (
            abs(cxx + xx / slope) * side
            if blurred and lens.rim[0] >= 0.0 and slope != 0.0
            else boxes[0]
        )
    else:
        boxes[0] = math.sqrt(abs(cxx * cyy - cxy * cyx)) * side
        boxes[1], boxes[2] = boxes[0], boxes[0]
    for index in range(3):
        boxes[index] = max(boxes[index], LEAST_BOX)
    spread, even = blurred or lens.points > 0, -1.0
    if spread:
        at_x, at_y = frame[15] + cxx * dx + cxy * dy, frame[16] + cyx * dx + cyy * dy
        even = even_radiance(at_x, at_y, frame, width, lens.values, lens.borders)
        if even == 0.0:
            return 0.0
    light = 0.0
    for j in range(divide):
        y = dy + ((j + 0.5) / divide - 0.5) * width
        for i in range(divide):
            x = dx + ((i + 0.5) / divide - 0.5) * width
            share, look = (
                (1.0, 1.0) if full else part_share(x, y, side, slope, reach, lens.rim, lens.nodes)
            )
            if share <= 0.0:
                continue
            ex, ey = look * x, look * y
            at_x, at_y = frame[15] + cxx * ex + cxy * ey, frame[16] + cyx * ex + cyy * ey
            value = (
                even_radiance(at_x, at_y, frame, side, lens.values, lens.borders)
                if spread and even < 0.0 and divide > 1
                else even
            )
            if value >= 0.0:
                if value > 0.0 and slant[3] != 0.0:
                    value *= seen_weight(ex, ey, slope, reach, slant)
            elif lens.points > 0:
                value = sampled_mean(
                    ex,
                    ey,
                    lens.cone,
                    frame[:10],
                    lens.row_nodes,
                    lens.chord,
                    lens.points,
                    side,
                    PICTURE,
                    lens.numbers,
                    lens.table,
                    lens.law,
                    areas,
                    slant,
                )
            elif blurred:
                clip_x, clip_y = clip(ex, ey, along_x, along_y, slope, reach)
                low, high = lens_span(clip_x, clip_y, radius)
                slant_x, slant_y = slant[0] + slant[2] * ex, slant[1] + slant[2] * ey
                turned = (
                    slant_x * along_x + slant_y * along_y,
                    slant_y * along_x - slant_x * along_y,
                    slant[3],
                )
                value = texels_mean(
                    at_x,
                    at_y,
                    frame[10:13],
                    clip_x,
                    clip_y,
                    radius,
                    low,
                    high,
                    lens.strips,
                    lens.strip_count,
                    boxes,
                    lens.chunks,
                    turned,
                    sums,
                )
            elif lens.askew and boxes[0] > LEAST_BOX:
                inside = parallelogram_sum(
                    at_x, at_y, cxx * side, cyx * side, cxy * side, cyy * side, areas
                )
                value = inside / (boxes[0] * boxes[0])
            else:
                value = boxed_sum(sums, at_x, at_y, boxes[0], boxes[2])
            if lens.points == 0 and not blurred and lens.chunks > 0:
                value *= seen_weight(ex, ey, slope, reach, slant)
            light += share * min(max(value, 0.0), 1.0)
    return light / (divide * divide)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_texels(image: Array, rows: tuple[int, int], windows: Whole, seen: PictureSeen) -> None:
    """Add the light of a picture, seen by every entry, to a band of rows; windows as in
    ``add_ruled``.
    """
    lenses = seen.lenses
    boxes, frame, window = np.empty(3), np.empty(FRAME), np.empty(4, dtype=np.int64)
    for entry in range(windows.shape[0]):
        first, last = max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])
        start, end = windows[entry, 0], windows[entry, 1]
        if lenses.wanted.size > 0:
            start, end, first, last = shrink(lenses.wanted, start, end, first, last)
        if first >= last or start >= end:
            continue
        window[0], window[1], window[2], window[3] = start, end, first, last
        column, row, columns, deep = seen_texels(seen, entry, window, frame)
        if columns <= 0 or deep <= 0:
            continue
        sums = fill_sums(seen.values, column, row, columns, deep)
        areas, lens, level = (
            np.ascontiguousarray(sums[:, :, 0]),
            picture_lens(seen, entry),
            lenses.levels[entry],
        )
        for y in range(first, last):
            dy = lenses.ys[y] - lenses.centres[entry, 1]
            for x in range(start, end):
                if lenses.wanted.size > 0 and not lenses.wanted[y, x]:
                    continue
                dx = lenses.xs[x] - lenses.centres[entry, 0]
                image[y, x] += level * texel_light(dx, dy, lens, frame, sums, areas, boxes)

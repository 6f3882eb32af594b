"""Targets that vary along the sensor's columns (bars, a chirp, white), column by column: strips
across the pupil that are the same for all pixels of a column.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.fast.lines import (
    CORNER,
    ELEMENTWISE,
    OF_CHORD,
    SHARP,
    SLIVER,
    Sampling,
    add_pixel_by_pixel,
    light_of,
    mean_cos4,
    seen_through,
)
from flflab.image.fast.profile import NARROW, Profile, mean_and_moment_sums, mean_over_two
from flflab.image.fast.share import look_up, slope_of
from flflab.image.microlenses import Record

Array = npt.NDArray[np.float64]

BLURRED = (
    2.0  # pixels: behind a wider blur rows at three heights stand for a pixel at a target's end
)
ENDLESS = 1e9
HEIGHTS = 0.5 * math.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])  # of a pixel, by Gauss
SHARES = np.array([5.0, 8.0, 5.0]) / 18
ROOT3 = math.sqrt(3.0)
# The strips of a column lie in blocks of columns, [block, strip, field and column]: a block's loop
# has constant bounds, which lets it be vectorised.
BLOCK = 32  # columns
OWN = 0 * BLOCK  # half the pupil's chord
OTHER = 1 * BLOCK  # half the chord of the wider aperture's shadow
WIDTH = 2 * BLOCK  # of the strip
LIGHT = 3 * BLOCK  # its mean radiance, times its width
BENT = 4 * BLOCK  # what the shadow's edge cuts off more on one side of a pixel than on the other
SLANT = 5 * BLOCK  # square of the rays' slope along the columns' axis
FIELDS = 6


@numba.njit(cache=True, nogil=True, error_model="numpy")
def strips_of(
    lens: Record, line: Record, profile: Profile, xs: Array, how: Sampling
) -> tuple[Array, Array, Array]:
    """Strips across the pupil for every column of a micro-image whose target varies along the
    columns' axis; the mean radiance each column sees through the whole pupil; and, where the blur
    is below a pixel, the light for a change of the share with the squared distance, mm^2.
    """
    count, first = how.strips, lens.first_column
    columns = lens.end_column - first
    strips = np.zeros((-(-columns // BLOCK), count, FIELDS * BLOCK))
    whole = np.zeros(strips.shape[0] * BLOCK)
    edge = lens.reach + abs(lens.slope)
    box = math.sqrt((line.sensor * how.pixel) ** 2 + how.smear**2)
    near = np.zeros(columns)
    blurred = 2 * abs(line.pupil) > SHARP * abs(line.sensor) * how.pixel
    # The pixel's part of the box is all that has a moment: per mm on the sensor.
    aside = line.sensor * how.pixel**2 / box**2 if box > 0.0 else 0.0
    cut = 0.5 * how.pixel / lens.slope if lens.slope != 0.0 and blurred else 0.0
    borders = np.cos(math.pi / count * np.arange(count + 1))
    middles = np.cos(math.pi / count * (np.arange(count) + 0.5))
    for column in range(columns):
        block, place = column // BLOCK, column % BLOCK
        ex = xs[first + column] - lens.x
        centre = line.origin + line.sensor * ex
        seen, moment = mean_over_two(profile, centre, box, ROOT3 * line.pupil)
        if not blurred:
            near[column] = 2 * ex * moment * aside
        if count == 1:
            whole[column] = seen
            strip = strips[block, 0]
            strip[WIDTH + place], strip[LIGHT + place] = 1.0, seen
            strip[OWN + place], strip[OTHER + place] = 1.0, 1e9
            continue
        shadow, radius = 0.0, 1e9
        if lens.slope != 0.0:
            shadow = max(-edge * SLIVER, min(edge * SLIVER, ex)) / lens.slope
            radius = lens.reach / abs(lens.slope)
        low, high = max(-1.0, shadow - radius), min(1.0, shadow + radius)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        before, passed = low, mean_and_moment_sums(profile, centre + line.pupil * low, box)
        total, area = 0.0, 0.0
        for index in range(count):
            strip = strips[block, index]
            after = middle - half * borders[index + 1]
            at = middle - half * middles[index]
            own, off, step = _half_chord(1.0, at), at - shadow, after - before
            reached = mean_and_moment_sums(profile, centre + line.pupil * after, box)
            if abs(line.pupil * step) > NARROW * box:
                seen = (reached[0] - passed[0]) / line.pupil
                moment = (reached[1] - passed[1]) / line.pupil
            else:
                seen, moment = mean_over_two(profile, centre + line.pupil * at, box, 0.0)
                seen, moment = seen * step, moment * step
            grown = _half_chord(radius, off - cut) - _half_chord(radius, off + cut)
            across = lens.slant_x + lens.slant_scale * ex + lens.slant_spread * at
            strip[OWN + place], strip[OTHER + place] = own, _half_chord(radius, off)
            strip[WIDTH + place], strip[LIGHT + place] = step, seen
            strip[BENT + place] = moment * aside * grown / max(how.pixel, 1e-300)
            strip[SLANT + place] = across * across
            total += own * seen
            area += own * step
            before, passed = after, reached
        whole[column] = total / area if area > 0.0 else 0.0
    return strips, whole, near


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _half_chord(radius: float, off: float) -> float:
    return math.sqrt(max(0.0, (radius - off) * (radius + off)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=ELEMENTWISE)
def _sum_block(
    strips: Array, shadow: float, ends: tuple[float, float], part: float, sums: Array
) -> None:
    """Add a part of what the strips of a block let through within the shadow centred at a height:
    light, area, and what the shadow's edge bends, one after the other in ``sums``. Light comes from
    between the ``ends`` of the target, as the pupil sees them.
    """
    for index in range(strips.shape[0]):
        strip = strips[index]
        for column in range(BLOCK):
            half, cut = strip[OWN + column], strip[OTHER + column]
            high, low = min(half, shadow + cut), max(-half, shadow - cut)
            chord = max(0.0, high - low)
            edges = (1.0 if high < half else 0.0) + (1.0 if low > -half else 0.0)
            seen = max(0.0, min(high, ends[1]) - max(low, ends[0]))
            sums[column] += part * seen * strip[LIGHT + column]
            sums[BLOCK + column] += part * chord * strip[WIDTH + column]
            bend = strip[BENT + column] if seen > 0.0 else 0.0
            sums[2 * BLOCK + column] += part * edges * bend


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=ELEMENTWISE)
def _sum_weighted_block(
    strips: Array,
    shadow: float,
    ends: tuple[float, float],
    part: float,
    sums: Array,
    slope: float,
    spread: float,
) -> None:
    """The same with rays weighted by cos^4 = (1 + slope^2)^-2; the slope along the rows' axis is
    ``slope`` at the pupil's centre and changes by ``spread`` per unit of pupil.
    """
    for index in range(strips.shape[0]):
        strip = strips[index]
        for column in range(BLOCK):
            half, cut = strip[OWN + column], strip[OTHER + column]
            high, low = min(half, shadow + cut), max(-half, shadow - cut)
            chord = max(0.0, high - low)
            edges = (1.0 if high < half else 0.0) + (1.0 if low > -half else 0.0)
            along, aside = slope + 0.5 * spread * (high + low), OF_CHORD * spread * chord
            weight = mean_cos4(1.0 + strip[SLANT + column], along, aside)
            seen = max(0.0, min(high, ends[1]) - max(low, ends[0]))
            sums[column] += part * weight * seen * strip[LIGHT + column]
            sums[BLOCK + column] += part * chord * strip[WIDTH + column]
            bend = strip[BENT + column] if seen > 0.0 else 0.0
            sums[2 * BLOCK + column] += part * weight * edges * bend


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_by_columns(
    image: Array,
    lens: Record,
    line: Record,
    profile: Profile,
    table: Array,
    places: tuple[Array, Array],
    rows: tuple[int, int],
    how: Sampling,
) -> None:
    """Add the light of one microlens to some rows; the target varies along the columns' axis.

    Rows that see an end of the target, and vignetting edges without a table, are formed pixel by
    pixel.
    """
    xs, ys = places
    first_row, end_row = max(rows[0], lens.first_row), min(rows[1], lens.end_row)
    if first_row >= end_row:
        return
    strips, seen, near = strips_of(lens, line, profile, xs, how)
    wide, first, sums = abs(lens.slope), lens.first_column, np.zeros(3 * BLOCK)
    inner = max(0.0, lens.reach - wide - CORNER * how.pixel)
    outer = lens.reach + wide + CORNER * how.pixel
    tall = abs(line.across_sensor) * how.pixel
    margin = abs(line.across_pupil) + tall
    for row in range(first_row, end_row):
        ey = ys[row] - lens.y
        beyond = abs(line.across + line.across_sensor * ey) - how.half_height
        if beyond >= margin:
            continue
        ended = beyond > -margin
        if ended and 2 * abs(line.across_pupil) <= BLURRED * tall:
            add_pixel_by_pixel(image, lens, line, profile, table, places, (row, row + 1), how)
            continue
        lit = _columns(lens, xs, outer * outer - ey * ey)
        whole = _columns(lens, xs, inner * inner - ey * ey)
        if table.size == 0:
            for start, end in ((lit[0], min(whole[0], lit[1])), (max(whole[1], lit[0]), lit[1])):
                for column in range(start, end):
                    ex = xs[first + column] - lens.x
                    image[row, first + column] += light_of(
                        lens, line, profile, ex, ey, how.parts, how
                    )
            lit = whole
        shadow = ey / lens.slope if lens.slope != 0.0 else 0.0
        for block in range(lit[0] // BLOCK, -(-lit[1] // BLOCK)):
            start, end = max(lit[0], block * BLOCK), min(lit[1], (block + 1) * BLOCK)
            if not how.weighted and not ended and whole[0] <= start and end <= whole[1]:
                for column in range(start, end):
                    image[row, first + column] += lens.level * seen[column]
                continue
            sums[:] = 0.0
            slope = lens.slant_y + lens.slant_scale * ey
            for height in range(3 if ended else 1):
                ends, part = (-ENDLESS, ENDLESS), 1.0
                if ended:
                    up = line.across + line.across_sensor * (ey + HEIGHTS[height] * how.pixel)
                    half = abs(how.half_height / line.across_pupil)
                    ends = (-up / line.across_pupil - half, -up / line.across_pupil + half)
                    part = SHARES[height]
                if how.weighted:
                    _sum_weighted_block(
                        strips[block], shadow, ends, part, sums, slope, lens.slant_spread
                    )
                else:
                    _sum_block(strips[block], shadow, ends, part, sums)
            for column in range(start, end):
                ex, place = xs[first + column] - lens.x, column - block * BLOCK
                inside = whole[0] <= column < whole[1]
                share = 1.0 if inside else look_up(table, ex * ex + ey * ey)
                area = sums[BLOCK + place]
                if area > 1e-9:
                    light = share * sums[place] / area + sums[2 * BLOCK + place] / math.pi
                else:
                    light = seen_through(lens, line, profile, ex, ey, how.pixel, how)[0] * share
                if not inside and near[column] != 0.0:
                    light += slope_of(table, ex * ex + ey * ey) * near[column]
                image[row, first + column] += lens.level * max(0.0, light)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _columns(lens: Record, xs: Array, squared: float) -> tuple[int, int]:
    """Columns within a squared distance (mm^2) of the micro-image's centre along a row, counted
    from the window's first.
    """
    count = lens.end_column - lens.first_column
    if squared <= 0.0 or count <= 0:
        return 0, 0
    half, start = math.sqrt(squared), xs[lens.first_column]
    step = xs[1] - xs[0] if xs.size > 1 else 1.0
    low = math.ceil((lens.x - half - start) / step)
    high = math.floor((lens.x + half - start) / step) + 1
    return min(max(low, 0), count), max(min(high, count), 0)

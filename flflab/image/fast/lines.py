"""Targets that vary along one direction (bars, a chirp, an edge, white), upright before the camera:
strips across the pupil that are the same for a whole column of pixels.

Along the direction a strip of the pupil and a pixel together average the target over two boxes,
exactly. Across it a strip counts by its chord within the microlens and the main lens's shadow.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.fast.profile import (
    NARROW,
    Profile,
    is_even,
    mean_and_moment_sums,
    mean_over_two,
    piece_at,
    radiance,
)
from flflab.image.fast.share import look_up, share_at, share_in, slope_of
from flflab.image.microlenses import Record
from flflab.optics.discs import lens_chord, lens_rows

Array = npt.NDArray[np.float64]
Lines = npt.NDArray[np.void]

SLIVER = 1.0 - 1e-6  # of the way to the edge of the light; what lies further out looks from there
SHARP = 0.3  # pixels; a smaller blur sees the target as one box
ROOT3 = math.sqrt(3.0)
OF_CHORD = 0.5 / ROOT3  # from its middle to Gauss's two points
# for kernels in which nothing is infinite or not a number
ELEMENTWISE = {"contract", "nsz", "nnan", "ninf"}
BLURRED = 2.0  # pixels: a wider blur softens a target's ends more than the pixel does
ENDLESS = 1e9
CORNER = math.sqrt(0.5)  # of a pixel's side: from its middle to a corner
# Along the target's direction a ray ends at origin + sensor e_u + pupil t_u, across it at across +
# across_sensor e_v + across_pupil t_v; (cos, sin) is the direction u on the sensor.
LINE = np.dtype(
    [
        (name, np.float64)
        for name in (
            "origin", "sensor", "pupil", "across", "across_sensor", "across_pupil", "cos", "sin",
        )
    ]
)  # fmt: skip


class Sampling(NamedTuple):
    """How finely a microlens is formed.

    Attributes:
        strips: across the pupil; 1 takes the pupil as one box.
        parts: of a pixel's side where one point does not stand for all of it.
        pixel: side over which a pixel gathers light, mm; 0 for its centre alone.
        smear: width of the box on the target that motion adds to a pixel's, mm.
        half_height: of the target across its direction, mm; infinite for a boundless one.
        weighted: whether rays count by cos^4 of their slopes at the sensor.
    """

    strips: int
    parts: int
    pixel: float
    smear: float
    half_height: float
    weighted: bool


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=ELEMENTWISE)
def mean_cos4(square: float, along: float, aside: float) -> float:
    """Mean of cos^4 = (1 + slope^2)^-2 over a chord, by Gauss's two points.

    Args:
        square: 1 and the square of the slope across the chord.
        along: slope along the chord in its middle.
        aside: how much it changes from there to a point.
    """
    one, other = square + (along - aside) ** 2, square + (along + aside) ** 2
    both = one * other
    return 0.5 * (one * one + other * other) / (both * both)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_through(
    lens: Record, line: Record, profile: Profile, ex: float, ey: float, side: float, how: Sampling
) -> tuple[float, float]:
    """Mean radiance, weighted by fall-off, that a square round a sensor point sees through its part
    of the pupil; and the light that comes because the square's parts see unlike parts of the pupil.

    Args:
        lens: the microlens.
        line: its map to the target.
        profile: the target.
        ex: the point, mm from the micro-image's centre.
        ey: the same along y.
        side: of the square, mm.
        how: the sampling.
    """
    away, edge = math.sqrt(ex * ex + ey * ey), lens.reach + abs(lens.slope)
    inward = min(1.0, edge * SLIVER / max(away, 1e-300))
    eu, ev = (ex * line.cos + ey * line.sin), (ey * line.cos - ex * line.sin)
    u, v, radius = 0.0, 0.0, 2.0
    if lens.slope != 0.0:
        u, v = eu * inward / lens.slope, ev * inward / lens.slope
        radius = lens.reach / abs(lens.slope)
    low, high = lens_rows(v, u, radius)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    centre = line.origin + line.sensor * eu
    wide = abs(line.sensor) * side * max(abs(line.cos), abs(line.sin))
    narrow = abs(line.sensor) * side * min(abs(line.cos), abs(line.sin))
    wide = math.sqrt(wide * wide + how.smear * how.smear)
    reach = abs(line.pupil) * half + 0.5 * (wide + narrow)
    at = centre + line.pupil * middle
    first, last = piece_at(profile, at - reach), piece_at(profile, at + reach)
    even = first == last and (first < 0 or is_even(profile, first))
    even_light = radiance(profile, at) if even else 0.0
    up, tall = line.across + line.across_sensor * ev, abs(line.across_sensor) * 0.5 * side
    bounded = abs(up) + tall + abs(line.across_pupil) > how.half_height
    if even and (even_light == 0.0 or not (how.weighted or bounded)):
        return even_light, 0.0
    # What the chords grow by from one side of the square to the other goes with the target's
    # moment.
    cut = 0.5 * side / abs(lens.slope) if lens.slope != 0.0 and side < edge else 0.0
    aside = (1.0 + (narrow / wide) ** 2) / (side * line.sensor) if wide > 0.0 else 0.0
    aside *= math.copysign(1.0, lens.slope)
    slant_u = lens.slant_x * line.cos + lens.slant_y * line.sin + lens.slant_scale * eu
    slant_v = lens.slant_y * line.cos - lens.slant_x * line.sin + lens.slant_scale * ev
    light, area, bends, before = 0.0, 0.0, 0.0, low
    for strip in range(how.strips):
        angle = math.pi / how.strips
        after = middle - half * math.cos(angle * (strip + 1))
        place = middle - half * math.cos(angle * (strip + 0.5))
        left, right = lens_chord(v, u, radius, place)
        width = after - before
        area += width * max(0.0, right - left)
        if right > left:
            part, bend = even_light, 0.0
            if not even:
                box = line.pupil * width
                at = centre + line.pupil * 0.5 * (after + before)
                part, moment = mean_over_two(
                    profile, at, wide, math.sqrt(box * box + narrow * narrow)
                )
                if cut > 0.0:
                    near = lens_chord(v, u + cut, radius, place)
                    far = lens_chord(v, u - cut, radius, place)
                    grown = max(0.0, near[1] - near[0]) - max(0.0, far[1] - far[0])
                    bend = width * grown * moment * aside
            part *= width * (right - left)
            if bounded:
                ends = up + line.across_pupil * left, up + line.across_pupil * right
                part *= _within_height(min(ends), max(ends), tall, how.half_height)
            if how.weighted:
                across = slant_u + lens.slant_spread * place
                along = slant_v + lens.slant_spread * 0.5 * (left + right)
                aside_v = OF_CHORD * lens.slant_spread * (right - left)
                weight = mean_cos4(1.0 + across * across, along, aside_v)
                part, bend = weight * part, weight * bend
            light += part
            bends += bend
        before = after
    return (light / area if area > 0.0 else even_light), bends / math.pi


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _within_height(low: float, high: float, tall: float, half_height: float) -> float:
    """Part of a target's height from ``low`` to ``high`` that lies between its ends, in the mean
    over a pixel of half the height ``tall``, mm.
    """
    tall, long = max(tall, 1e-12 * half_height), max(high - low, 1e-12 * half_height)
    part = 0.0
    for end, sign in ((half_height, 1.0), (-half_height, -1.0)):
        below = 0.0
        for place, turn in ((low + tall, -1.0), (low - tall, 1.0)):
            below += turn * max(0.0, end - place) ** 2
            below -= turn * max(0.0, end - place - long) ** 2
        part += sign * below / (4 * tall * long)
    return min(1.0, max(0.0, part))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def light_of(
    lens: Record, line: Record, profile: Profile, ex: float, ey: float, parts: int, how: Sampling
) -> float:
    """Light of a pixel, of white, as the mean of so many parts a side."""
    side, total = how.pixel / parts, 0.0
    for row in range(parts):
        y = ey + side * (row + 0.5 - 0.5 * parts)
        for column in range(parts):
            x = ex + side * (column + 0.5 - 0.5 * parts)
            share = share_in(x, y, side, lens.slope, lens.reach)
            if share > 0.0:
                seen, bend = seen_through(lens, line, profile, x, y, side, how)
                total += share * seen + bend
    return lens.level * max(0.0, total) / (parts * parts)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_pixel_by_pixel(
    image: Array,
    lens: Record,
    line: Record,
    profile: Profile,
    table: Array,
    places: tuple[Array, Array],
    rows: tuple[int, int],
    how: Sampling,
) -> None:
    """Add the light of one microlens to some rows, each pixel with strips of its own.

    A pixel is one point where the vignetting edge is wider than it; else it is cut into parts.
    """
    steep = table.size == 0
    xs, ys = places
    inner = lens.reach - abs(lens.slope) - CORNER * how.pixel
    outer = lens.reach + abs(lens.slope) + CORNER * how.pixel
    for row in range(max(rows[0], lens.first_row), min(rows[1], lens.end_row)):
        ey = ys[row] - lens.y
        for column in range(lens.first_column, lens.end_column):
            ex = xs[column] - lens.x
            squared = ex * ex + ey * ey
            if squared >= outer * outer:
                continue
            whole = inner > 0.0 and squared <= inner * inner
            if steep and not whole and how.parts > 1:
                image[row, column] += light_of(lens, line, profile, ex, ey, how.parts, how)
                continue
            if whole:
                share = 1.0
            elif steep:
                share = share_at(ex, ey, lens.slope, lens.reach)
            else:
                share = look_up(table, squared)
            if share > 0.0:
                seen, bend = seen_through(lens, line, profile, ex, ey, how.pixel, how)
                image[row, column] += lens.level * max(0.0, share * seen + bend)


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
def _sum_block(strips: Array, shadow: float, ends: tuple[float, float], sums: Array) -> None:
    """What the strips of a block let through within the shadow centred at a height: light, area,
    and what the shadow's edge bends, one after the other in ``sums``. Light comes from between the
    ``ends`` of the target, as the pupil sees them.
    """
    sums[:] = 0.0
    for index in range(strips.shape[0]):
        strip = strips[index]
        for column in range(BLOCK):
            half, cut = strip[OWN + column], strip[OTHER + column]
            high, low = min(half, shadow + cut), max(-half, shadow - cut)
            chord = max(0.0, high - low)
            edges = (1.0 if high < half else 0.0) + (1.0 if low > -half else 0.0)
            seen = max(0.0, min(high, ends[1]) - max(low, ends[0]))
            sums[column] += seen * strip[LIGHT + column]
            sums[BLOCK + column] += chord * strip[WIDTH + column]
            bend = strip[BENT + column] if seen > 0.0 else 0.0
            sums[2 * BLOCK + column] += edges * bend


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=ELEMENTWISE)
def _sum_weighted_block(
    strips: Array,
    shadow: float,
    ends: tuple[float, float],
    sums: Array,
    slope: float,
    spread: float,
) -> None:
    """The same with rays weighted by cos^4 = (1 + slope^2)^-2; the slope along the rows' axis is
    ``slope`` at the pupil's centre and changes by ``spread`` per unit of pupil.
    """
    sums[:] = 0.0
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
            sums[column] += weight * seen * strip[LIGHT + column]
            sums[BLOCK + column] += chord * strip[WIDTH + column]
            bend = strip[BENT + column] if seen > 0.0 else 0.0
            sums[2 * BLOCK + column] += weight * edges * bend


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
        ends = (-ENDLESS, ENDLESS)
        if beyond > -margin and 2 * abs(line.across_pupil) > BLURRED * tall:
            up = line.across + line.across_sensor * ey
            middle = -up / line.across_pupil
            half = abs(how.half_height / line.across_pupil)
            ends = (middle - half, middle + half)
        elif beyond > -margin:
            add_pixel_by_pixel(image, lens, line, profile, table, places, (row, row + 1), how)
            continue
        lit = _columns(lens, xs, outer * outer - ey * ey)
        whole = _columns(lens, xs, inner * inner - ey * ey)
        if table.size == 0:
            pixels = image[row, first:]
            _add_in_parts(pixels, lens, line, profile, xs, ey, (lit[0], min(whole[0], lit[1])), how)
            _add_in_parts(pixels, lens, line, profile, xs, ey, (max(whole[1], lit[0]), lit[1]), how)
            lit = whole
        shadow = ey / lens.slope if lens.slope != 0.0 else 0.0
        for block in range(lit[0] // BLOCK, -(-lit[1] // BLOCK)):
            start, end = max(lit[0], block * BLOCK), min(lit[1], (block + 1) * BLOCK)
            if how.weighted:
                slope = lens.slant_y + lens.slant_scale * ey
                _sum_weighted_block(strips[block], shadow, ends, sums, slope, lens.slant_spread)
            elif whole[0] <= start and end <= whole[1] and ends[1] == ENDLESS:
                for column in range(start, end):
                    image[row, first + column] += lens.level * seen[column]
                continue
            else:
                _sum_block(strips[block], shadow, ends, sums)
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
def _add_in_parts(
    pixels: Array,
    lens: Record,
    line: Record,
    profile: Profile,
    xs: Array,
    ey: float,
    columns: tuple[int, int],
    how: Sampling,
) -> None:
    """Add the light of some columns of a row, counted from the window's first, each cut into
    parts.
    """
    for column in range(columns[0], columns[1]):
        ex = xs[lens.first_column + column] - lens.x
        pixels[column] += light_of(lens, line, profile, ex, ey, how.parts, how)


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

"""Targets that vary along one direction (bars, a chirp, an edge, white), pixel by pixel in strips
across the pupil.

Along the direction a strip of the pupil and a pixel together average the target over two boxes,
exactly. Across it a strip counts by its chord within the microlens and the main lens's shadow.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.fast.profile import (
    Profile,
    is_even,
    mean_over_two,
    piece_at,
    radiance,
)
from flflab.image.fast.share import look_up, share_at, share_in
from flflab.image.microlenses import Record
from flflab.optics.discs import lens_chord, lens_rows

Array = npt.NDArray[np.float64]
Lines = npt.NDArray[np.void]

SLIVER = 1.0 - 1e-6  # of the way to the edge of the light; what lies further out looks from there
SHARP = 0.3  # pixels; a smaller blur sees the target as one box
OF_CHORD = 0.5 / math.sqrt(3.0)  # from its middle to Gauss's two points
# for kernels in which nothing is infinite or not a number
ELEMENTWISE = {"contract", "nsz", "nnan", "ninf"}
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
    aside = side * line.sensor * math.copysign(1.0, lens.slope)  # the pixel's part of the box
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
                # three boxes as two; wider strips would overlap, and show bars of their own
                box, both = abs(line.pupil) * width, wide
                if box < narrow:
                    box = math.sqrt(box * box + narrow * narrow)
                else:
                    both = math.sqrt(wide * wide + narrow * narrow)
                at = centre + line.pupil * 0.5 * (after + before)
                part, moment = mean_over_two(profile, at, both, box)
                if cut > 0.0 and both > 0.0:
                    near = lens_chord(v, u + cut, radius, place)
                    far = lens_chord(v, u - cut, radius, place)
                    grown = max(0.0, near[1] - near[0]) - max(0.0, far[1] - far[0])
                    bend = width * grown * moment * aside / (both * both)
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

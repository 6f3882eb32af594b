"""Round dots in closed form: the area common to the pupil, the main lens's shadow and the dot,
three discs.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.fast.lines import CORNER, OF_CHORD, Sampling, mean_cos4
from flflab.image.fast.share import look_up, share_in
from flflab.image.microlenses import Record
from flflab.optics.discs import (
    disc_rectangle_area,
    lens_chord,
    lens_rows,
    three_disc_area,
    two_disc_area,
)

Array = npt.NDArray[np.float64]

CHORDS = 6  # of the common area, that tell the mean of cos^4 over it


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_dots(
    image: Array,
    lens: Record,
    line: Record,
    centres: Array,
    radius: float,
    table: Array,
    places: tuple[Array, Array],
    rows: tuple[int, int],
    how: Sampling,
) -> None:
    """Add the light of dots through one microlens to some rows.

    Args:
        image: [row, column].
        lens: the microlens.
        line: its map to the target; the same scale along and across.
        centres: of the dots on the target, mm, shape (N, 2).
        radius: of the dots, mm.
        table: ``share_table`` of the microlens, empty where its edge is narrower than a pixel.
        places: x of the columns and y of the rows, mm.
        rows: first row, and row after the last.
        how: the sampling; ``parts`` a side of each pixel, which sees the target through the middle
            of the pupil where that is one strip.
    """
    xs, ys = places
    scale = abs(line.sensor)
    outer = lens.reach + abs(lens.slope) + CORNER * how.pixel
    for index in range(centres.shape[0]):
        du, dv = centres[index, 0] - line.origin, centres[index, 1] - line.across
        aside = du * line.cos - dv * line.sin, du * line.sin + dv * line.cos
        reach = (radius + abs(line.pupil)) / max(scale, 1e-12 * radius) + CORNER * how.pixel
        x, y = lens.x, lens.y
        if scale > 1e-12 * radius:
            x, y = x + aside[0] / line.sensor, y + aside[1] / line.sensor
        elif math.hypot(aside[0], aside[1]) >= radius + abs(line.pupil):
            continue
        start = max(lens.first_column, np.searchsorted(xs, x - reach))
        end = min(lens.end_column, np.searchsorted(xs, x + reach, side="right"))
        first = max(rows[0], lens.first_row, np.searchsorted(ys, y - reach))
        last = min(rows[1], lens.end_row, np.searchsorted(ys, y + reach, side="right"))
        for row in range(first, last):
            for column in range(start, end):
                ex, ey = xs[column] - lens.x, ys[row] - lens.y
                away = math.hypot(xs[column] - x, ys[row] - y)
                if away >= reach or math.hypot(ex, ey) >= outer:
                    continue
                if how.strips == 1:
                    dot = (xs[column] - x, ys[row] - y, radius / scale)
                    light = _sharp(lens, line, dot, table, ex, ey, how)
                else:
                    light = _blurred(lens, line, aside, radius, ex, ey, how)
                image[row, column] += lens.level * light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sharp(
    lens: Record,
    line: Record,
    dot: tuple[float, float, float],
    table: Array,
    ex: float,
    ey: float,
    how: Sampling,
) -> float:
    """Share of a pixel's light where the blur is below a pixel: its square, or that of each of its
    parts, sees the target through the centre of its part of the pupil, widened by the blur.
    """
    turn, middle = -line.pupil / line.sensor, (1.0, 0.0, 0.0)
    if how.weighted or math.hypot(ex, ey) > lens.reach - abs(lens.slope):
        middle = mean_over_pupil(lens, ex, ey, (0.0, 0.0, 2.0))
    weight = middle[0] if how.weighted else 1.0
    x, y = dot[0] - turn * middle[1], dot[1] - turn * middle[2]
    # A part's square is widened until it has the variance of the part and of the pupil's disc.
    side = how.pixel / how.parts
    wide = math.sqrt(side * side + 3.0 * turn * turn)
    half = 0.5 * (how.pixel - side + wide)
    far, near = math.hypot(abs(x) + half, abs(y) + half), math.hypot(x, y) - 2 * half
    if near >= dot[2]:
        return 0.0
    if far <= dot[2] and table.size > 0:
        return weight * look_up(table, ex * ex + ey * ey)
    total = 0.0
    for row in range(how.parts):
        down = side * (row + 0.5 - 0.5 * how.parts)
        for column in range(how.parts):
            aside = side * (column + 0.5 - 0.5 * how.parts)
            at_x, at_y = x + aside, y + down
            if wide > 0.0:
                part = disc_rectangle_area(
                    dot[2], at_x - wide / 2, at_x + wide / 2, at_y - wide / 2, at_y + wide / 2
                ) / (wide * wide)
            else:
                part = 1.0 if at_x * at_x + at_y * at_y <= dot[2] * dot[2] else 0.0
            if part > 0.0:
                total += part * share_in(ex + aside, ey + down, side, lens.slope, lens.reach)
    return weight * total / how.parts**2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _blurred(
    lens: Record,
    line: Record,
    aside: tuple[float, float],
    radius: float,
    ex: float,
    ey: float,
    how: Sampling,
) -> float:
    """Share of the full cone, in the mean over a pixel, that comes from a dot so far (mm) aside of
    where the ray through both centres ends.
    """
    total, side = 0.0, how.pixel / how.parts
    turn, size = line.sensor / line.pupil, radius / abs(line.pupil)
    wide = abs(lens.slope)
    for row in range(how.parts):
        down = side * (row + 0.5 - 0.5 * how.parts)
        for column in range(how.parts):
            x, y = ex + side * (column + 0.5 - 0.5 * how.parts), ey + down
            at_x, at_y = aside[0] / line.pupil - turn * x, aside[1] / line.pupil - turn * y
            away = math.hypot(x, y)
            if away >= lens.reach + wide:
                continue
            if away <= lens.reach - wide:
                share = two_disc_area(1.0, size, math.hypot(at_x, at_y))
            else:
                share = three_disc_area(
                    0.0, 0.0, 1.0, x / lens.slope, y / lens.slope, lens.reach / wide,
                    at_x, at_y, size,
                )  # fmt: skip
            if share > 0.0 and how.weighted:
                share *= mean_over_pupil(lens, x, y, (at_x, at_y, size))[0]
            total += share
    return total / (math.pi * how.parts**2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_over_pupil(
    lens: Record, ex: float, ey: float, disc: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Mean of cos^4 of the rays' slopes at the sensor over the part of the pupil that a sensor
    point sees, within a disc (x, y, radius) of it; and that part's centre.
    """
    x, y, radius = 0.0, 0.0, 2.0
    if lens.slope != 0.0:
        x, y, radius = ex / lens.slope, ey / lens.slope, lens.reach / abs(lens.slope)
    low, high = lens_rows(x, y, radius)
    lowest, highest = lens_rows(disc[0], disc[1], disc[2])
    low, high = max(low, lowest), min(high, highest)
    slope_x = lens.slant_x + lens.slant_scale * ex
    slope_y = lens.slant_y + lens.slant_scale * ey
    light, area, middle_x, middle_y = 0.0, 0.0, 0.0, 0.0
    for chord in range(CHORDS):
        at = 0.5 * (low + high) - 0.5 * (high - low) * math.cos(math.pi * (chord + 0.5) / CHORDS)
        left, right = lens_chord(x, y, radius, at)
        half = math.sqrt(max(0.0, (disc[2] - (at - disc[1])) * (disc[2] + (at - disc[1]))))
        left, right = max(left, disc[0] - half), min(right, disc[0] + half)
        if right <= left:
            continue
        weight = math.sin(math.pi * (chord + 0.5) / CHORDS) * (right - left)
        across = slope_x + 0.5 * lens.slant_spread * (left + right)
        along = slope_y + lens.slant_spread * at
        aside = OF_CHORD * lens.slant_spread * (right - left)
        light += weight * mean_cos4(1.0 + along * along, across, aside)
        area += weight
        middle_x += weight * 0.5 * (left + right)
        middle_y += weight * at
    if area > 0.0:
        return light / area, middle_x / area, middle_y / area
    return 1.0 / (1.0 + slope_x * slope_x + slope_y * slope_y) ** 2, 0.0, 0.0

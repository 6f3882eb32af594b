"""What rays see on a target, each averaged over a box that stands for its part of pixel and pupil;
and how much of the light a card stops.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.fast.profile import (
    Profile,
    is_even,
    mean_over_two,
    piece_at,
    profile_of,
    radiance,
)
from flflab.optics.discs import disc_rectangle_area
from flflab.targets import Bars, Black, Edge, FourDot, Picture, Target

Array = npt.NDArray[np.float64]
Sight = Callable[[Array, Array, "Boxes", tuple[float, float]], Array]

ENDLESS = (math.inf, math.inf)


class Boxes(NamedTuple):
    """Sides of the box of each of P pixels, along the target's own axes, mm; shape (P,).

    Attributes:
        pixel_u: of the pixel alone.
        pixel_v: the same along v.
        other_u: of the pupil's cell and the motion.
        other_v: the same along v.
    """

    pixel_u: Array
    pixel_v: Array
    other_u: Array
    other_v: Array


class Summed(NamedTuple):
    """A picture's radiance summed over all texels before each corner, [row, column].

    Attributes:
        table: shape (rows + 1, columns + 1), of radiance times texels.
        texel: side of one, mm.
    """

    table: Array
    texel: float


def sight_of(target: Target) -> Sight:
    """What is seen of a target: a function of where rays meet it in its own axes, shape (N, P)
    each, of the boxes of each pixel's rays, and of its card's half sides, mm, infinite without one.

    It gives the mean radiance over the box of each ray, as far as it lies on the card: what is on a
    card is not mixed with what would be beyond its rim.
    """
    if isinstance(target, Picture):
        table = np.zeros((target.values.shape[0] + 1, target.values.shape[1] + 1))
        table[1:, 1:] = target.values.cumsum(axis=0).cumsum(axis=1)
        summed = Summed(table, target.texel)
        return lambda u, v, boxes, half: see_texels(summed, u, v, boxes, half)
    if isinstance(target, Edge):
        edge, along = profile_of(target), (math.cos(target.angle), math.sin(target.angle))
        return lambda u, v, boxes, _: see_lines(edge, u, v, boxes, along, math.inf, ENDLESS)
    if isinstance(target, Bars):
        bars, tall = profile_of(target), target.height / 2
        return lambda u, v, boxes, half: see_lines(bars, u, v, boxes, (1.0, 0.0), tall, half)
    if isinstance(target, FourDot):
        centres, radius = target.centres, target.diameter / 2
        return lambda u, v, boxes, _: see_dots(centres, radius, u, v, boxes)
    return lambda u, v, boxes, half: np.full(u.shape, 0.0 if isinstance(target, Black) else 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see_lines(
    profile: Profile,
    u: Array,
    v: Array,
    boxes: Boxes,
    along: tuple[float, float],
    half_height: float,
    half: tuple[float, float],
) -> Array:
    """Mean radiance of a target that varies along one direction, up to its ends across it."""
    light = np.zeros(u.shape)
    cos, sin = abs(along[0]), abs(along[1])
    for index in range(u.shape[1]):
        one, two = boxes.pixel_u[index] * cos, boxes.pixel_v[index] * sin
        aside = (boxes.other_u[index] * cos) ** 2 + (boxes.other_v[index] * sin) ** 2
        narrow = math.sqrt(aside + min(one, two) ** 2)
        wide = max(one, two)
        full = wide + narrow
        tall = math.hypot(boxes.pixel_v[index], boxes.other_v[index])
        for point in range(u.shape[0]):
            part = 1.0
            if half_height < math.inf:
                part = overlap(*_clipped(v[point, index], tall, half[1]), half_height)
            if part > 0.0:
                place = u[point, index] * along[0] + v[point, index] * along[1]
                place, length = _clipped(place, full, half[0])
                share = length / full if full > 0.0 else 1.0
                reach = 0.5 * length
                first, last = piece_at(profile, place - reach), piece_at(profile, place + reach)
                if first == last and (first < 0 or is_even(profile, first)):
                    light[point, index] = part * radiance(profile, place)
                else:
                    light[point, index] = (
                        part * mean_over_two(profile, place, share * wide, share * narrow)[0]
                    )
    return light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see_dots(centres: Array, radius: float, u: Array, v: Array, boxes: Boxes) -> Array:
    """Mean radiance of round dots on black."""
    light = np.zeros(u.shape)
    for index in range(u.shape[1]):
        wide = max(math.hypot(boxes.pixel_u[index], boxes.other_u[index]), 1e-6 * radius)
        tall = max(math.hypot(boxes.pixel_v[index], boxes.other_v[index]), 1e-6 * radius)
        for point in range(u.shape[0]):
            for dot in range(centres.shape[0]):
                x, y = u[point, index] - centres[dot, 0], v[point, index] - centres[dot, 1]
                if abs(x) < radius + wide and abs(y) < radius + tall:
                    area = disc_rectangle_area(
                        radius, x - wide / 2, x + wide / 2, y - tall / 2, y + tall / 2
                    )
                    light[point, index] += area / (wide * tall)
    return light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see_texels(
    summed: Summed, u: Array, v: Array, boxes: Boxes, half: tuple[float, float]
) -> Array:
    """Mean radiance of a picture, black around it."""
    light = np.zeros(u.shape)
    table, texel = summed.table, summed.texel
    rows, columns = table.shape[0] - 1, table.shape[1] - 1
    for index in range(u.shape[1]):
        whole_u = max(math.hypot(boxes.pixel_u[index], boxes.other_u[index]), 1e-6 * texel)
        whole_v = max(math.hypot(boxes.pixel_v[index], boxes.other_v[index]), 1e-6 * texel)
        for point in range(u.shape[0]):
            x, wide = _clipped(u[point, index], whole_u, half[0])
            y, tall = _clipped(v[point, index], whole_v, half[1])
            x, wide = x / texel + 0.5 * columns, wide / texel
            y, tall = y / texel + 0.5 * rows, tall / texel
            left, right = max(x - wide / 2, 0.0), min(x + wide / 2, float(columns))
            low, high = max(y - tall / 2, 0.0), min(y + tall / 2, float(rows))
            if right > left and high > low:
                total = _corner(table, high, right) - _corner(table, high, left)
                total += _corner(table, low, left) - _corner(table, low, right)
                light[point, index] = total / (wide * tall)
    return light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _corner(table: Array, row: float, column: float) -> float:
    """Sum of the radiance before a place between corners."""
    i = min(int(row), table.shape[0] - 2)
    j = min(int(column), table.shape[1] - 2)
    y, x = row - i, column - j
    above = table[i, j] * (1.0 - x) + table[i, j + 1] * x
    below = table[i + 1, j] * (1.0 - x) + table[i + 1, j + 1] * x
    return above * (1.0 - y) + below * y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _clipped(place: float, side: float, half: float) -> tuple[float, float]:
    """Middle and length of the part of a box that lies between -half and half; the box itself
    where none does.
    """
    low, high = max(place - side / 2, -half), min(place + side / 2, half)
    if high <= low:
        return place, side
    return (low + high) / 2, high - low


@numba.njit(cache=True, nogil=True, error_model="numpy")
def overlap(place: float, box: float, half: float) -> float:
    """Part of a box round a place that lies between -half and half."""
    if box <= 0.0:
        return 1.0 if abs(place) <= half else 0.0
    inside = min(place + box / 2, half) - max(place - box / 2, -half)
    return min(1.0, max(0.0, inside / box))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def covered(u: Array, v: Array, boxes: Boxes, half_width: float, half_height: float) -> Array:
    """Part of each ray's box that a card of these half sides stops."""
    part = np.zeros(u.shape)
    for index in range(u.shape[1]):
        wide = math.hypot(boxes.pixel_u[index], boxes.other_u[index])
        tall = math.hypot(boxes.pixel_v[index], boxes.other_v[index])
        for point in range(u.shape[0]):
            across = overlap(u[point, index], wide, half_width)
            if across > 0.0:
                part[point, index] = across * overlap(v[point, index], tall, half_height)
    return part


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_light(
    image: Array, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64],
    light: Array, weight: Array, level: float,
) -> None:  # fmt: skip
    """Add the weighted light of all rays to their pixels."""
    for index in range(rows.size):
        total = 0.0
        for point in range(light.shape[0]):
            total += weight[point, index] * light[point, index]
        image[rows[index], columns[index]] += level * total

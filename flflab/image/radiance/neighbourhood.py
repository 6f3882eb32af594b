"""What a ray's neighbourhood sees: mean radiance of a target, share of a card, and both together
where edges cross it.

A neighbourhood is what a part of the pixel and a cell of the pupil cover on a surface: two boxes
along each of the surface's axes.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.radiance.profile import profile_mean, profile_table, step_mean
from flflab.optics.discs import disc_rectangle_area
from flflab.targets import Bars, Edge, FourDot, Picture, Target

Array = npt.NDArray[np.float64]

PLAIN, DOTS, RULED, EDGE, PICTURE, DISC = range(6)  # a disc is one dot round the origin
STILL = (
    0.1  # of a neighbourhood's squared width: so little a movement may be left to the next moments
)
NARROW = 0.05  # of the wider box of a neighbourhood; a narrower one only widens it
BY_HALVES = 2 / math.sqrt(
    3.0
)  # of a box: of two halves so long together the middles are as far apart as Gauss looks at the box
SWING = math.sqrt(6.0)  # width of the box that spreads light as a swing of amplitude 1 does


def described(target: Target) -> tuple[int, Array, Array, Array, Array]:
    """A target for the kernel: its kind, three numbers, the table and law of a profile, and the
    sums of a picture.
    """
    numbers, table, law, sums = np.zeros(3), np.zeros((0, 8)), np.zeros(6), np.zeros((2, 2))
    match target:
        case FourDot():
            numbers[:2] = target.diameter / 2, target.spacing / 2
            return DOTS, numbers, table, law, sums
        case Bars():
            table, law = profile_table(target, target.width)
            numbers[0] = target.height / 2
            return RULED, numbers, table, law, sums
        case Edge():
            numbers[:2] = math.cos(target.angle), math.sin(target.angle)
            return EDGE, numbers, table, law, sums
        case Picture():
            numbers[0] = target.texel
            return (
                PICTURE,
                numbers,
                table,
                law,
                np.pad(target.values.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0))),
            )
        case _:
            return PLAIN, numbers, table, law, sums


@numba.njit(cache=True, nogil=True, error_model="numpy")
def summed_value(sums: Array, column: float, row: float) -> float:
    """Integral of a picture from its first corner to a place in texels, from its summed-area table;
    constant beyond its ends.
    """
    column = min(max(column, 0.0), sums.shape[1] - 1.0)
    row = min(max(row, 0.0), sums.shape[0] - 1.0)
    i = min(int(column), sums.shape[1] - 2)
    j = min(int(row), sums.shape[0] - 2)
    u = column - i
    v = row - j
    return (1 - v) * ((1 - u) * sums[j, i] + u * sums[j, i + 1]) + v * (
        (1 - u) * sums[j + 1, i] + u * sums[j + 1, i + 1]
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def two_boxes(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[float, float]:
    """Two boxes that smooth about as six (signed) do: the widest, and one as wide as the others'
    root of summed squares.
    """
    widest = max(max(max(abs(a), abs(b)), max(abs(c), abs(d))), max(abs(e), abs(f)))
    return widest, math.sqrt(
        max(0.0, a * a + b * b + c * c + d * d + e * e + f * f - widest * widest)
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def way_round(surface: Array, motion: Array, drifts: int, swings: int, boxes: Array) -> None:
    """Boxes as wide as a surface moves along its x and y around each of so many moments of drift
    and of vibration, from the fifth on.
    """
    for axis in range(2):
        cos, sin = surface[6 + 2 * axis], surface[7 + 2 * axis]
        boxes[4 + 2 * axis] = (cos * motion[0, 0] + sin * motion[0, 1]) / drifts
        boxes[5 + 2 * axis] = SWING * (cos * motion[1, 0] + sin * motion[1, 1]) / swings


@numba.njit(cache=True, nogil=True, error_model="numpy")
def boxes_round(by: Array, parts: int, width: float, height: float, boxes: Array) -> None:
    """The two boxes along x and the two along y of a surface that a part of a pixel and a cell of
    the pupil cover, from its maps.

    What the surface moves meanwhile is in ``boxes`` from the fifth on.
    """
    boxes[0], boxes[1] = two_boxes(
        by[4] / parts, by[5] / parts, by[0] * width, by[1] * height, boxes[4], boxes[5]
    )
    boxes[2], boxes[3] = two_boxes(
        by[6] / parts, by[7] / parts, by[2] * width, by[3] * height, boxes[6], boxes[7]
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def moves_little(boxes: Array) -> bool:
    """Whether what a surface moves around a moment is a small part of a neighbourhood, along both
    its axes; boxes of ``boxes_round``.
    """
    x = boxes[4] ** 2 + boxes[5] ** 2 <= STILL * (boxes[0] ** 2 + boxes[1] ** 2)
    return x and boxes[6] ** 2 + boxes[7] ** 2 <= STILL * (boxes[2] ** 2 + boxes[3] ** 2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def card_share(x: float, y: float, surface: Array, boxes: Array) -> float:
    """Share of a neighbourhood at (x, y) that lies on a card."""
    half_x, half_y = surface[10], surface[11]
    across = step_mean(x + half_x, boxes[0], boxes[1]) - step_mean(x - half_x, boxes[0], boxes[1])
    return across * (
        step_mean(y + half_y, boxes[2], boxes[3]) - step_mean(y - half_y, boxes[2], boxes[3])
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def leads_alike(by: Array, target: Array, parts: int, width: float, height: float) -> bool:
    """Whether of the boxes of pixel and pupil cell the same is the wider one on a surface and on
    the target, along both axes.
    """
    for k in range(0, 4, 2):
        here = (
            math.hypot(by[4 + k], by[5 + k])
            >= math.hypot(by[k] * width, by[k + 1] * height) * parts
        )
        there = (
            math.hypot(target[4 + k], target[5 + k])
            >= math.hypot(target[k] * width, target[k + 1] * height) * parts
        )
        if here != there:
            return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _common_boxes(
    by: Array, target: Array, axis: int, part: float, width: float, height: float
) -> tuple[float, float]:
    """The two boxes that smooth a surface along an axis, pixel and pupil cell, the one that is
    wider on the target first.

    The first holds half of the second, whose halves are looked at one by one. A pixel that stands
    askew is two boxes itself: where the lesser is wider than the cell it is the second, as long as
    its halves' middles stand for it alone. Negative where the surface runs against the target.
    """
    k = 2 * axis
    one, other = (4 + k, 5 + k) if abs(target[4 + k]) >= abs(target[5 + k]) else (5 + k, 4 + k)
    on_target, least = (
        math.hypot(target[k] * width, target[k + 1] * height),
        abs(target[other]) * part,
    )
    cell = math.hypot(by[k] * width, by[k + 1] * height)
    if least > on_target:
        lead = math.copysign(max(math.hypot(by[one] * part, cell), 1e-300), by[one] * target[one])
        return lead, math.copysign(BY_HALVES * by[other] * part, by[other] * target[other])
    pixel = math.hypot(by[4 + k], by[5 + k]) * part
    if by[4 + k] * target[4 + k] + by[5 + k] * target[5 + k] < 0.0:
        pixel = -pixel
    if by[k] * target[k] + by[k + 1] * target[k + 1] < 0.0:
        cell = -cell
    if math.hypot(target[4 + k], target[5 + k]) * part < on_target:
        pixel, cell = cell, pixel
    return math.copysign(max(math.hypot(pixel, 0.5 * cell), 1e-300), pixel), cell


@numba.njit(cache=True, nogil=True, error_model="numpy")
def radiance_round(
    x: float,
    y: float,
    boxes: Array,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean radiance of a target in a neighbourhood at (x, y) of two boxes along x and two along
    y.
    """
    box_x, box_y = (boxes[0], boxes[1]), (boxes[2], boxes[3])
    if kind == PLAIN:
        return 1.0
    if kind == RULED:
        seen = step_mean(y + numbers[0], box_y[0], box_y[1]) - step_mean(
            y - numbers[0], box_y[0], box_y[1]
        )
        return seen * profile_mean(x, box_x[0], box_x[1], table, law) if seen > 0.0 else 0.0
    if kind == EDGE:
        cos, sin = numbers[0], numbers[1]
        along = two_boxes(cos * box_x[0], cos * box_x[1], sin * box_y[0], sin * box_y[1], 0.0, 0.0)
        return step_mean(x * cos + y * sin, along[0], along[1])
    width, first_x = _places_along(box_x, 1e-3 * numbers[0])
    height, first_y = _places_along(box_y, 1e-3 * numbers[0])
    total, count = 0.0, 0
    for shift_y in (first_y, -first_y):
        for shift_x in (first_x, -first_x):
            if kind == DOTS:
                total += _dots_mean(x + shift_x, y + shift_y, width, height, numbers)
            else:
                total += _picture_mean(x + shift_x, y + shift_y, width, height, numbers[0], sums)
            count += 1
            if first_x == 0.0:
                break
        if first_y == 0.0:
            break
    return total / count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _places_along(box: tuple[float, float], least: float) -> tuple[float, float]:
    """Side of the box that is looked at, and how far from the middle: the wider box, from the two
    places that stand for the other.

    One box in place of both would smooth an edge along it too much in the middle of its step, in
    every part of a pixel alike.
    """
    if box[1] <= NARROW * box[0]:
        return max(math.sqrt(box[0] * box[0] + box[1] * box[1]), least), 0.0
    return max(box[0], least), box[1] / math.sqrt(12.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _dots_mean(x: float, y: float, width: float, height: float, numbers: Array) -> float:
    """Mean radiance of four dots in a box round (x, y)."""
    size = numbers[0]
    x, y = abs(x) - numbers[1], abs(y) - numbers[1]
    if abs(x) > size + width or abs(y) > size + height:
        return 0.0
    area = disc_rectangle_area(
        size, x - 0.5 * width, x + 0.5 * width, y - 0.5 * height, y + 0.5 * height
    )
    return max(0.0, area) / (width * height)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _picture_mean(
    x: float, y: float, width: float, height: float, size: float, sums: Array
) -> float:
    """Mean radiance of a picture, of texels of this size, in a box round (x, y)."""
    left = (x - 0.5 * width) / size + 0.5 * (sums.shape[1] - 1)
    bottom = (y - 0.5 * height) / size + 0.5 * (sums.shape[0] - 1)
    right = left + width / size
    top = bottom + height / size
    total = (
        summed_value(sums, right, top)
        - summed_value(sums, left, top)
        - summed_value(sums, right, bottom)
    )
    return max(0.0, total + summed_value(sums, left, bottom)) * size * size / (width * height)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_on_card(
    x: float,
    y: float,
    card: Array,
    boxes: Array,
    scratch: Array,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean of a target's radiance in a neighbourhood at (x, y), black beyond its own card, over one
    movement of both.

    The lesser box is looked at by halves, as in ``seen_jointly``.
    """
    wide, high = (
        max(math.hypot(boxes[0], 0.5 * boxes[1]), 1e-300),
        max(math.hypot(boxes[2], 0.5 * boxes[3]), 1e-300),
    )
    total = 0.0
    scratch[1] = scratch[3] = 0.0
    for choice in range(4):
        at_x, at_y = (
            x + (0.25 - 0.5 * (choice & 1)) * boxes[1],
            y + (0.25 - 0.25 * (choice & 2)) * boxes[3],
        )
        left, right = max(at_x - 0.5 * wide, -card[10]), min(at_x + 0.5 * wide, card[10])
        bottom, top = max(at_y - 0.5 * high, -card[11]), min(at_y + 0.5 * high, card[11])
        if left >= right or bottom >= top:
            continue
        scratch[0], scratch[2] = right - left, top - bottom
        part = (right - left) * (top - bottom) / (wide * high)
        total += (
            0.25
            * part
            * radiance_round(
                0.5 * (left + right), 0.5 * (bottom + top), scratch, kind, numbers, table, law, sums
            )
        )
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_jointly(
    x: float,
    y: float,
    surfaces: Array,
    maps: Array,
    places: Array,
    boxes: Array,
    crossed: int,
    parts: int,
    width: float,
    height: float,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
) -> float:
    """Mean of radiance times visibility in a neighbourhood that the edges of cards cross, all of
    them along its sides, at one moment.

    A place of the neighbourhood is (u, v), both from -1/2 to 1/2, the same for all surfaces. What a
    card leaves visible is all less what it covers, so that the mean is a sum of means over
    rectangles, one for each choice among the cards. In ``places`` are x, y and the surface of each
    card; the other columns are scratch.
    """
    part = 1.0 / parts
    wide, slip_x = _common_boxes(maps[0], maps[0], 0, part, width, height)
    high, slip_y = _common_boxes(maps[0], maps[0], 1, part, width, height)
    for card in range(crossed):
        index = int(places[card, 2])
        for axis in range(2):
            places[card, 3 + 2 * axis], places[card, 4 + 2 * axis] = _common_boxes(
                maps[index], maps[0], axis, part, width, height
            )
    total = 0.0
    boxes[1] = boxes[3] = 0.0
    for choice in range(4 << crossed):
        left, right, bottom, top, sign = -0.5, 0.5, -0.5, 0.5, 0.25
        shift_x, shift_y = 0.25 - 0.5 * (choice & 1), 0.25 - 0.25 * (choice & 2)
        for card in range(crossed):
            index = int(places[card, 2])
            own = surfaces[index, 12] > 0.0
            if (choice >> (card + 2)) & 1 == 0:
                sign = 0.0 if own else sign
                continue
            sign = sign if own else -sign
            middle = -(places[card, 0] + shift_x * places[card, 4]) / places[card, 3]
            reach = surfaces[index, 10] / abs(places[card, 3])
            left, right = max(left, middle - reach), min(right, middle + reach)
            middle = -(places[card, 1] + shift_y * places[card, 6]) / places[card, 5]
            reach = surfaces[index, 11] / abs(places[card, 5])
            bottom, top = max(bottom, middle - reach), min(top, middle + reach)
        if sign == 0.0 or left >= right or bottom >= top:
            continue
        at_x = x + shift_x * slip_x + wide * 0.5 * (left + right)
        at_y = y + shift_y * slip_y + high * 0.5 * (bottom + top)
        boxes[0], boxes[2] = abs(wide) * (right - left), abs(high) * (top - bottom)
        total += (
            sign
            * (right - left)
            * (top - bottom)
            * radiance_round(at_x, at_y, boxes, kind, numbers, table, law, sums)
        )
    return max(0.0, total)

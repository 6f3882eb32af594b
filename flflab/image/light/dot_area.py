"""The light of a dot in a pixel by closed form: of the area common to the pupil, the other
aperture's shadow and the dot, three discs.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.falloff_means import ACROSS
from flflab.optics.discs import GAUSS, lens_chord, lens_rows, three_disc_area, two_disc_area

Array = npt.NDArray[np.float64]

MOST_SQUARES = 64  # that wait to be summed: three more with each halving
# how much less four Gauss points miss than the middle at any second derivative that is no larger
# than so much
GAINED = 4.0
# cos^4 bends by up to 4 times the square of the change of slopes: of a disc, the mean misses a
# sixth; times 12
UNEVEN = 8.0 * math.pi
ROUNDED = 1.15  # 18 parts a side may be 16


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _seen_disc(ex: float, ey: float, to: Array, radius: float) -> tuple[float, float, float]:
    """Middle (x, y) and radius, in the pupil's, of the disc through which a sensor point sees a
    dot.
    """
    determinant = to[2] * to[5] - to[3] * to[4]
    at_x = to[0] + to[6] * ex + to[7] * ey
    at_y = to[1] + to[8] * ex + to[9] * ey
    x = (to[3] * at_y - to[5] * at_x) / determinant
    y = (to[4] * at_x - to[2] * at_y) / determinant
    return x, y, radius / math.sqrt(abs(determinant))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def spot_share(ex: float, ey: float, cone: Array, to: Array, radius: float) -> float:
    """Part of the full cone at (ex, ey) mm that comes from a dot of this radius (target mm): the
    area common to three discs over pi.

    The map from the pupil to the target counts as a turn and one scale.
    """
    slope, reach = cone[0], cone[1]
    x, y, size = _seen_disc(ex, ey, to, radius)
    distance = math.hypot(ex, ey)
    if slope == 0.0 or distance <= reach - abs(slope):
        return two_disc_area(1.0, size, math.hypot(x, y)) / math.pi
    return (
        three_disc_area(0.0, 0.0, 1.0, ex / slope, ey / slope, reach / abs(slope), x, y, size)
        / math.pi
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weighted_share(
    ex: float, ey: float, cone: Array, to: Array, radius: float, slant: Array, weighing: Array
) -> float:
    """``spot_share``, its rays counted by cos^4 of their slopes at the sensor.

    Args:
        ex: place of the sensor point from the micro-image's centre, mm.
        ey: the same along y.
        cone: slope and reach, mm.
        to: the maps to the target.
        radius: of the dot, mm on the target.
        slant: slope (x, y) of the middle ray at the sensor, its change per mm on the sensor and per
            unit of pupil.
        weighing: heights and weights of chords of the area common to the three discs, see
            ``strip_nodes``, shape (2, n), that tell the mean of cos^4 over it; with none all rays
            count alike.
    """
    share = spot_share(ex, ey, cone, to, radius)
    if share <= 0.0 or weighing.shape[1] == 0:
        return share
    x, y, size = _seen_disc(ex, ey, to, radius)
    lens_x, lens_y, lens = (
        (ex / cone[0], ey / cone[0], cone[1] / abs(cone[0])) if cone[0] != 0.0 else (0.0, 0.0, 2.0)
    )
    low, high = lens_rows(lens_x, lens_y, lens)
    lowest, highest = lens_rows(x, y, size)
    low, high = max(low, lowest), min(high, highest)
    slope_x, slope_y = slant[0] + slant[2] * ex, slant[1] + slant[2] * ey
    light, area = 0.0, 0.0
    for index in range(weighing.shape[1]):
        at = 0.5 * (low + high) + 0.5 * (high - low) * weighing[0, index]
        left, right = lens_chord(lens_x, lens_y, lens, at)
        half = math.sqrt(max(0.0, (size - (at - y)) * (size + (at - y))))
        left, right = max(left, x - half), min(right, x + half)
        if right <= left:
            continue
        weight = weighing[1, index] * (right - left)
        area += weight
        up = 1.0 + (slope_y + slant[3] * at) ** 2
        middle, aside = (
            slope_x + slant[3] * 0.5 * (left + right),
            slant[3] * 0.5 * (right - left) * ACROSS,
        )
        sides = (up + (middle - aside) ** 2) ** -2 + (up + (middle + aside) ** 2) ** -2
        light += weight * (8.0 * (up + middle * middle) ** -2 + 5.0 * sides) / 18.0
    return (
        share * light / area
        if area > 0.0
        else share / (1.0 + slope_x * slope_x + slope_y * slope_y) ** 2
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bend(one: float, other: float, away: float, half: float) -> tuple[float, float]:
    """By how much the middle of a square, and four Gauss points, may miss the mean over it of an
    area that two discs bound; times 12.

    Where their circles cross at an angle g, the area's second derivative by their movement is at
    most 1 / sin g for each crossing; with sin g = sqrt(q) / (2 r s), q = ((r + s)^2 - D^2) (D^2 -
    (r - s)^2), for radii r and s at a distance D. The fourth is at most 3 / u^2 of that where they
    move by u until they touch.

    Args:
        one: radius of a disc.
        other: of the other.
        away: from centre to centre in the middle of the square.
        half: how far they move against each other from there to a corner.

    Returns:
        0 where the circles do not cross, infinity where they begin or cease to.
    """
    near, far, touch, hold = away - half, away + half, one + other, abs(one - other)
    if near >= touch or far <= hold:
        return 0.0, 0.0
    if near <= hold or far >= touch:
        return math.inf, math.inf
    least = min(
        (touch * touch - near * near) * (near * near - hold * hold),
        (touch * touch - far * far) * (far * far - hold * hold),
    )
    bend = 4.0 * one * other * half * half / math.sqrt(least)
    return bend, bend * (half / min(near - hold, touch - far)) ** 2 / 15.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meets(
    x: float, y: float, size: float, other_x: float, other_y: float, other: float, moved: float
) -> bool:
    """Whether a crossing of the unit circle with one of radius ``size`` round (x, y) comes to a
    third circle, if both move by ``moved``.
    """
    away = math.sqrt(x * x + y * y)
    along = (away * away + 1.0 - size * size) / (2.0 * away)
    aside = math.sqrt(max(0.0, 1.0 - along * along))
    for side in (-aside, aside):
        at_x, at_y = (along * x - side * y) / away, (along * y + side * x) / away
        if abs(math.sqrt((at_x - other_x) ** 2 + (at_y - other_y) ** 2) - other) <= moved:
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def spot_light(
    dx: float,
    dy: float,
    width: float,
    cone: Array,
    to: Array,
    radius: float,
    full: bool,
    parts: int,
    allowed: float,
    slant: Array,
    weighing: Array,
    squares: Array,
) -> float:
    """Mean of ``weighted_share`` over a pixel, which is quartered, and its quarters, until one or
    four points of each square tell its mean.

    Args:
        dx: the pixel's middle from the micro-image's centre, mm.
        dy: the same along y.
        width: its side, mm.
        cone: slope and reach, mm.
        to: the maps to the target.
        radius: of the dot, mm on the target.
        full: whether the pixel lies in the bright field, which the microlens does not cut.
        parts: how many of the smallest squares a side of the pixel holds, or up to ``ROUNDED``
            times fewer.
        allowed: error of the mean, of white.
        slant: see ``weighted_share``.
        weighing: the same.
        squares: scratch for those that are left to sum.
    """
    scale, slope, limit = (
        math.sqrt(abs(to[2] * to[5] - to[3] * to[4])),
        abs(cone[0]),
        12.0 * math.pi * allowed,
    )
    turn = math.sqrt(0.5 * (to[6] * to[6] + to[7] * to[7] + to[8] * to[8] + to[9] * to[9])) / scale
    light, left = 0.0, 1
    squares[0, 0], squares[0, 1], squares[0, 2] = dx, dy, width
    while left > 0:
        left -= 1
        ex, ey, side = squares[left, 0], squares[left, 1], squares[left, 2]
        gauss = False
        if side * parts > ROUNDED * width:
            x, y, size = _seen_disc(ex, ey, to, radius)
            half = math.sqrt(0.5) * side
            bend, fourth = _bend(1.0, size, math.sqrt(x * x + y * y), half * turn)
            if not full:
                lens_x, lens_y, lens = ex / cone[0], ey / cone[0], cone[1] / slope
                of_lens = _bend(
                    1.0, lens, math.sqrt(lens_x * lens_x + lens_y * lens_y), half / slope
                )
                of_both = _bend(
                    size,
                    lens,
                    math.sqrt((x - lens_x) ** 2 + (y - lens_y) ** 2),
                    half * (turn + 1.0 / slope),
                )
                crossing = bend > 0.0 and of_lens[0] > 0.0 and of_both[0] > 0.0
                moved = bend / (2.0 * half * turn) + half / slope
                bend += of_lens[0] + of_both[0]
                fourth += of_lens[1] + of_both[1]
                if crossing and fourth <= limit and _meets(x, y, size, lens_x, lens_y, lens, moved):
                    fourth = math.inf  # the second derivative jumps where all three meet in a point
            if weighing.shape[1] > 0:
                bend += UNEVEN * (min(size, 1.0) * slant[3] * half * turn) ** 2
            gauss = bend > limit
            if gauss and bend > GAINED * limit and fourth > limit:
                for quarter in range(4):
                    squares[left, 0] = ex + (quarter % 2 - 0.5) * 0.5 * side
                    squares[left, 1] = ey + (quarter // 2 - 0.5) * 0.5 * side
                    squares[left, 2] = 0.5 * side
                    left += 1
                continue
        if gauss:
            seen = 0.0
            for place in range(4):
                at_x, at_y = (
                    ex + (place % 2 - 0.5) * 2.0 * GAUSS * side,
                    ey + (place // 2 - 0.5) * 2.0 * GAUSS * side,
                )
                seen += weighted_share(at_x, at_y, cone, to, radius, slant, weighing)
            light += 0.25 * side * side * seen
        else:
            light += side * side * weighted_share(ex, ey, cone, to, radius, slant, weighing)
    return light / (width * width)

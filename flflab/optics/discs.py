"""Areas of overlapping discs, of a disc and a rectangle, and the strips of a lens-shaped region;
compiled, callable from kernels.

Lengths in any one unit. The textbook formula for two discs loses every digit near tangency and for
unlike radii; here all differences that vanish at a tangency are formed first, exactly, and
everything after them only multiplies.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Array = npt.NDArray[np.float64]

# For kernels whose sums may be taken in any order, in which nothing is infinite or not a number.
LOOSE = {"contract", "nsz", "nnan", "ninf", "reassoc", "arcp"}
SERIES_TERMS = 34
SERIES_LIMIT = 0.35
# Coefficients of (integral of sqrt(z (1 - z)) from 0 to z) / z^(3/2): (-1)^n binomial(1/2, n) / (n
# + 3/2).
SERIES = tuple(
    float(np.prod([(k - 0.5) / (k + 1) for k in range(n)])) / (n + 1.5) for n in range(SERIES_TERMS)
)


@numba.njit(cache=True, error_model="numpy")
def gap(a: float, b: float, c: float) -> float:
    """a + b - c with one rounding, by two-term sums."""
    total = a + b
    part = total - a
    lost = (a - (total - part)) + (b - part)
    rest = total - c
    part = rest - total
    lost += (total - (rest - part)) + (-c - part)
    return rest + lost


@numba.njit(cache=True, error_model="numpy")
def segment(z: float, complement: float) -> float:
    """Area of a circular segment of radius 1 and half angle a: a - sin a cos a, from z = sin^2(a/2)
    and 1 - z.

    The integral of 8 sqrt(z (1 - z)) from 0 to z; its series where the difference would cancel.
    """
    if z > 0.5:
        return math.pi - segment_small(complement, z)
    return segment_small(z, complement)


@numba.njit(cache=True, error_model="numpy")
def segment_small(z: float, complement: float) -> float:
    """``segment`` for z up to 1/2."""
    if z > SERIES_LIMIT:
        half = math.sqrt(z)
        other = math.sqrt(complement)
        return 2 * math.atan2(half, other) - 2 * half * other * (complement - z)
    total = 0.0
    for n in range(SERIES_TERMS - 1, -1, -1):
        total = total * z + SERIES[n]
    return 8 * z * math.sqrt(z) * total


@numba.njit(cache=True, error_model="numpy")
def two_disc_area(radius1: float, radius2: float, distance: float) -> float:
    """Area common to two closed discs of these radii whose centres lie ``distance`` apart; all
    three at least 0.
    """
    small = min(radius1, radius2)
    large = max(radius1, radius2)
    between = gap(small, large, distance)
    if between <= 0.0:
        return 0.0
    beyond = gap(distance, small, large)
    if beyond <= 0.0:
        return math.pi * small * small
    toward = gap(distance, large, small)
    whole = gap(distance, small, -large)
    in_small = segment(
        toward * between / (4 * distance * small), whole * beyond / (4 * distance * small)
    )
    in_large = segment(
        beyond * between / (4 * distance * large), whole * toward / (4 * distance * large)
    )
    return small * small * in_small + large * large * in_large


@numba.njit(cache=True, error_model="numpy")
def _two_disc_areas(radius1: Array, radius2: Array, distance: Array, areas: Array) -> None:
    for index in range(areas.size):
        areas[index] = two_disc_area(radius1[index], radius2[index], distance[index])


def two_disc_areas(
    radius1: npt.ArrayLike, radius2: npt.ArrayLike, distance: npt.ArrayLike
) -> Array:
    """Area common to two discs, element by element of broadcast arrays.

    Raises:
        InputError: a radius or distance is negative or not a number.
    """
    given = np.broadcast_arrays(
        *(np.asarray(part, dtype=np.float64) for part in (radius1, radius2, distance))
    )
    for name, part in zip(("radius1", "radius2", "distance"), given, strict=True):
        if not np.all(part >= 0) or not np.all(np.isfinite(part)):
            raise InputError(
                f"two_disc_areas: {name} holds a negative or not finite number; numbers from 0 up"
                " are allowed"
            )
    areas = np.empty(given[0].size)
    _two_disc_areas(given[0].flatten(), given[1].flatten(), given[2].flatten(), areas)
    return areas.reshape(given[0].shape)


@numba.njit(cache=True, error_model="numpy")
def arc_share(
    x: float, y: float, radius: float, other_x: float, other_y: float, other_radius: float
) -> tuple[float, float]:
    """Which part of a circle lies in another disc: (middle angle, half opening); half opening pi
    for all of it, -1 for none.
    """
    dx = other_x - x
    dy = other_y - y
    distance = math.hypot(dx, dy)
    if distance + radius <= other_radius:
        return 0.0, math.pi
    if distance >= radius + other_radius or distance + other_radius <= radius:
        return 0.0, -1.0
    between = gap(radius, other_radius, distance)
    toward = gap(distance, other_radius, radius)
    z = toward * between
    complement = gap(distance, radius, other_radius) * (distance + radius + other_radius)
    return math.atan2(dy, dx), 2 * math.atan2(
        math.sqrt(max(z, 0.0)), math.sqrt(max(complement, 0.0))
    )


@numba.njit(cache=True, error_model="numpy")
def arc_area(x: float, y: float, radius: float, start: float, end: float) -> float:
    """Half the integral of x dy - y dx along an arc: its segment and the triangle from the
    origin.
    """
    if end - start >= 2 * math.pi - 1e-15:
        return math.pi * radius * radius
    x1 = x + radius * math.cos(start)
    y1 = y + radius * math.sin(start)
    x2 = x + radius * math.cos(end)
    y2 = y + radius * math.sin(end)
    quarter = 0.25 * (end - start)
    return radius * radius * segment(math.sin(quarter) ** 2, math.cos(quarter) ** 2) + 0.5 * (
        x1 * y2 - x2 * y1
    )


@numba.njit(cache=True, error_model="numpy")
def three_disc_area(
    x1: float,
    y1: float,
    radius1: float,
    x2: float,
    y2: float,
    radius2: float,
    x3: float,
    y3: float,
    radius3: float,
) -> float:
    """Area common to three closed discs given by centres and radii: the arcs of its boundary, each
    by Green's formula.
    """
    x = (x1, x2, x3)
    y = (y1, y2, y3)
    radius = (radius1, radius2, radius3)
    for index in range(3):
        a = (index + 1) % 3
        b = (index + 2) % 3
        distance = math.hypot(x[a] - x[b], y[a] - y[b])
        if distance >= radius[a] + radius[b]:
            return 0.0
        if distance + min(radius[a], radius[b]) <= max(
            radius[a], radius[b]
        ):  # the larger one cuts nothing off
            smaller = a if radius[a] <= radius[b] else b
            between = math.hypot(x[index] - x[smaller], y[index] - y[smaller])
            return two_disc_area(radius[index], radius[smaller], between)
    area = 0.0
    # Triangles count from a corner of the region: from far away a small region would be a
    # difference of large ones.
    corner_x, corner_y, cornered = 0.0, 0.0, False
    for index in range(3):
        a = (index + 1) % 3
        b = (index + 2) % 3
        middle_a, half_a = arc_share(x[index], y[index], radius[index], x[a], y[a], radius[a])
        middle_b, half_b = arc_share(x[index], y[index], radius[index], x[b], y[b], radius[b])
        if half_a < 0.0 or half_b < 0.0:
            continue
        if half_b == math.pi or half_a == math.pi:
            middle = middle_a if half_b == math.pi else middle_b
            half = min(half_a, half_b)
            if not cornered:
                corner_x, corner_y = (
                    x[index] + radius[index] * math.cos(middle - half),
                    y[index] + radius[index] * math.sin(middle - half),
                )
                cornered = True
            area += arc_area(
                x[index] - corner_x,
                y[index] - corner_y,
                radius[index],
                middle - half,
                middle + half,
            )
            continue
        turn = middle_b - middle_a
        turn -= 2 * math.pi * math.floor(turn / (2 * math.pi) + 0.5)
        for full in (-2 * math.pi, 0.0, 2 * math.pi):
            start = max(-half_a, turn + full - half_b)
            end = min(half_a, turn + full + half_b)
            if end > start:
                if not cornered:
                    corner_x = x[index] + radius[index] * math.cos(middle_a + start)
                    corner_y = y[index] + radius[index] * math.sin(middle_a + start)
                    cornered = True
                area += arc_area(
                    x[index] - corner_x,
                    y[index] - corner_y,
                    radius[index],
                    middle_a + start,
                    middle_a + end,
                )
    return max(area, 0.0)


@numba.njit(cache=True, error_model="numpy")
def side_area(height: float, along: float, radius: float) -> float:
    """Disc round the origin within the triangle from the origin to a line at ``height``, from its
    foot to ``along``; signed.
    """
    h = abs(height)
    s = abs(along)
    if h >= radius:
        area = 0.5 * radius * radius * math.atan2(s, h)
    else:
        half = math.sqrt((radius - h) * (radius + h))
        area = (
            0.5 * h * s
            if s <= half
            else 0.5 * h * half + 0.5 * radius * radius * (math.atan2(s, h) - math.atan2(half, h))
        )
    return area if (height < 0.0) == (along < 0.0) else -area


@numba.njit(cache=True, error_model="numpy")
def disc_rectangle_area(
    radius: float, left: float, right: float, bottom: float, top: float
) -> float:
    """Area common to the disc of this radius round the origin and a rectangle with sides along the
    axes.
    """
    far_x = max(abs(left), abs(right))
    far_y = max(abs(bottom), abs(top))
    if far_x * far_x + far_y * far_y <= radius * radius:
        return (right - left) * (top - bottom)
    near_x = max(0.0, left, -right)
    near_y = max(0.0, bottom, -top)
    if near_x * near_x + near_y * near_y >= radius * radius:
        return 0.0
    area = side_area(right, top, radius) - side_area(right, bottom, radius)
    area += side_area(top, right, radius) - side_area(top, left, radius)
    area -= side_area(left, top, radius) - side_area(left, bottom, radius)
    area -= side_area(bottom, right, radius) - side_area(bottom, left, radius)
    return area


@numba.njit(cache=True, error_model="numpy")
def common_span(radius: float, other: float, distance: float) -> tuple[float, float, float]:
    """Ends of the region common to a disc round the origin and one at ``distance``, along the line
    to that one, and where its corners lie.

    Returns:
        Low end, corners and high end; empty if low >= high. A region without corners has them at
        its low end.
    """
    low, high = max(-radius, distance - other), min(radius, distance + other)
    corners = low
    if abs(other - radius) < distance:
        corners = min(
            max((distance * distance + radius * radius - other * other) / (2 * distance), low), high
        )
    return low, corners, high


@numba.njit(cache=True, error_model="numpy")
def common_row(
    radius: float, other: float, distance: float, start: float, end: float, node: float
) -> tuple[float, float, float]:
    """A row across that region, from ``start`` to ``end`` by an angle in which half its length is
    smooth, for Gauss's node from -1 to 1.

    Returns:
        Its place along the line, half its length, and the area that one of the rule's weight stands
        for, for a weight of 1 across it.
    """
    angle = 0.5 * math.pi * (1 + node)
    at = start + (end - start) * 0.5 * (1 - math.cos(angle))
    half = math.sqrt(max(min(radius * radius - at * at, other * other - (at - distance) ** 2), 0.0))
    return at, half, math.sin(angle) * (end - start) * half


@numba.njit(cache=True, error_model="numpy")
def lens_rows(x: float, y: float, radius: float) -> tuple[float, float]:
    """Lowest and highest y of the region common to the unit disc round the origin and the disc at
    (x, y); empty if low >= high.
    """
    distance = math.hypot(x, y)
    if distance >= 1.0 + radius:
        return 0.0, 0.0
    low, high = -1.0, 1.0
    if distance + 1.0 <= radius:
        return low, high
    if distance + radius <= 1.0:
        return y - radius, y + radius
    along = (1.0 + (distance - radius) * (distance + radius)) / (2.0 * distance)
    across = math.sqrt(max(0.0, 1.0 - along * along))
    corner1 = (along * y + across * x) / distance
    corner2 = (along * y - across * x) / distance
    if x * x + (1.0 - y) ** 2 > radius * radius:
        high = y + radius if x * x + (y + radius) ** 2 < 1.0 else max(corner1, corner2)
    if x * x + (1.0 + y) ** 2 > radius * radius:
        low = y - radius if x * x + (y - radius) ** 2 < 1.0 else min(corner1, corner2)
    return low, high


@numba.njit(cache=True, error_model="numpy")
def lens_chord(x: float, y: float, radius: float, at: float) -> tuple[float, float]:
    """Left and right end of that region at height ``at``; empty if left >= right."""
    half = math.sqrt(max(0.0, 1.0 - at * at))
    other = math.sqrt(max(0.0, (radius - (at - y)) * (radius + (at - y))))
    return max(-half, x - other), min(half, x + other)

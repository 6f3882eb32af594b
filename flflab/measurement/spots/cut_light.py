"""Light that a pixel gets of a dot seen through main lens and microlens, and how it changes with
place and blur; compiled.

At e from the micro-image's centre the pupil points v with |v| <= microlens disc and |v - e| <= main
lens disc see the dot where
|(e - spot) + beta v| <= radius, beta = b / (L x kappa) - 1: an area common to three discs. From s = kappa q - (b/L) m + (b/f) y_i and
o V = m W - q/L (physics.md, "One SMMS") with v = kappa (q - y_i).
"""  # noqa: E501

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.optics.discs import (
    arc_share,
    common_row,
    common_span,
    disc_rectangle_area,
    two_disc_area,
)

Array = npt.NDArray[np.float64]
Nodes = tuple[Array, Array]

LEAST_RADIUS = 2.0  # px: smaller discs may run through a pixel twice
SAME_PLACE = 1e-9  # rad: ends of an arc that only rounding keeps apart


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _chord(
    radius: float, at: float, low: float, high: float
) -> float:  # pragma: no cover - compiled
    """Length of the line at ``at`` from ``low`` to ``high`` within the disc round the origin."""
    if abs(at) >= radius:
        return 0.0
    half = math.sqrt((radius - at) * (radius + at))
    return max(0.0, min(high, half) - max(low, -half))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _under_arc(
    radius: float, start: float, end: float, bottom: float, full: float
) -> float:  # pragma: no cover - compiled
    """Area of the disc round the origin between ``bottom`` and 1 above, from ``start`` to ``end``,
    both positive.

    ``full`` is up to where the disc is higher than that. Beyond, a trapezium and the segment beyond
    its chord, with t = sin(angle / 2): asin t - t sqrt(1 - t^2), its series.
    """
    bend = min(max(full, start), end)
    last = min(max(math.sqrt((radius - bottom) * (radius + bottom)), bend), end)
    if last <= bend:
        return bend - start
    first_y = math.sqrt((radius - bend) * (radius + bend)) - bottom
    last_y = math.sqrt(max((radius - last) * (radius + last), 0.0)) - bottom
    square = ((last - bend) ** 2 + (first_y - last_y) ** 2) / (4 * radius * radius)
    series = 1 / 3 + square * (
        1 / 10
        + square * (3 / 56 + square * (5 / 144 + square * (35 / 1408 + square * (63 / 3328))))
    )
    return (
        bend
        - start
        + 0.5 * (first_y + last_y) * (last - bend)
        + 2 * radius * radius * square * math.sqrt(square) * series
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pixel_in_disc(
    radius: float, left: float, bottom: float
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Share of the unit square from (left, bottom) in the disc round the origin, and its slopes as
    the disc moves.
    """
    right, top = left + 1, bottom + 1
    far_x, far_y = max(-left, right), max(-bottom, top)
    if far_x * far_x + far_y * far_y <= radius * radius:
        return 1.0, 0.0, 0.0
    near_x, near_y = max(0.0, left, -right), max(0.0, bottom, -top)
    if near_x * near_x + near_y * near_y >= radius * radius:
        return 0.0, 0.0, 0.0
    if radius < LEAST_RADIUS:
        share = disc_rectangle_area(radius, left, right, bottom, top)
        by_x = _chord(radius, left, bottom, top) - _chord(radius, right, bottom, top)
        return share, by_x, _chord(radius, bottom, left, right) - _chord(radius, top, left, right)
    # the eighth of a turn in which the disc's rim runs along the pixel's top side
    turn_x, turn_y = 1.0 if left > -0.5 else -1.0, 1.0 if bottom > -0.5 else -1.0
    start, low = far_x - 1, far_y - 1
    swap = start > low
    if swap:
        start, low = low, start
    end, high = start + 1, low + 1
    at_low = math.sqrt((radius - low) * (radius + low))
    at_high = math.sqrt(max((radius - high) * (radius + high), 0.0))
    at_start = math.sqrt((radius - start) * (radius + start))
    at_end = math.sqrt(max((radius - end) * (radius + end), 0.0))
    if start < 0.0:
        share = _under_arc(radius, 0.0, -start, low, at_high) + _under_arc(
            radius, 0.0, end, low, at_high
        )
    else:
        share = _under_arc(radius, start, end, low, at_high)
    along = min(max(at_start - low, 0.0), 1.0) - min(max(at_end - low, 0.0), 1.0)
    across = max(min(end, at_low) - max(start, -at_low), 0.0) - max(
        min(end, at_high) - max(start, -at_high), 0.0
    )
    if swap:
        along, across = across, along
    return share, turn_x * along, turn_y * across


@numba.njit(cache=True, nogil=True, error_model="numpy")
def narrow(
    x: float,
    y: float,
    spot: Array,
    radius: float,
    main: float,
    small: float,
    beta: float,
    along: Nodes,
    across: Nodes,
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Light in the pixel at (x, y) and its slopes by the spot's place and by beta, where the blur
    is narrow.

    The share of the pixel, closed form, that sees the dot through v, integrated over the pupil of
    its middle. A pixel on the spot's edge is lit on its inner side only, and there the main lens's
    disc lies a little elsewhere: share by share, an integral along that disc's rim. Nodes and
    weights of Gauss ``along`` the line from the micro-image's centre, on either side of the pupil's
    corners, and ``across`` it.
    """
    r = math.hypot(x, y)
    area = two_disc_area(small, main, r)
    low, corners, high = common_span(small, main, r)
    to_x, to_y = (x / r, y / r) if r > 0 else (1.0, 0.0)
    total, seen, by_x, by_y, by_beta = 0.0, 0.0, 0.0, 0.0, 0.0
    for part in range(2):
        start, end = (low, corners) if part == 0 else (corners, high)
        if end <= start:
            continue
        for n in range(len(along[0])):
            u, half, area_of_one = common_row(small, main, r, start, end, along[0][n])
            for m in range(len(across[0])):
                w = half * across[0][m]
                weight = along[1][n] * across[1][m] * area_of_one
                vx, vy = u * to_x - w * to_y, u * to_y + w * to_x
                share, more_x, more_y = pixel_in_disc(
                    radius, x - 0.5 - spot[0] + beta * vx, y - 0.5 - spot[1] + beta * vy
                )
                total += weight
                seen += weight * share
                by_x, by_y, by_beta = (
                    by_x + weight * more_x,
                    by_y + weight * more_y,
                    by_beta - weight * (vx * more_x + vy * more_y),
                )
    scale = area / max(total, 1e-300)
    light = scale * seen
    turn, opening = arc_share(x, y, main, 0.0, 0.0, small)
    if opening > 0.0:
        for n in range(len(along[0])):
            angle = turn + opening * along[0][n]
            out_x, out_y = math.cos(angle), math.sin(angle)
            cx, cy = (
                x - spot[0] + beta * (x + main * out_x),
                y - spot[1] + beta * (y + main * out_y),
            )
            share, _, _ = pixel_in_disc(radius, cx - 0.5, cy - 0.5)
            inwards = -(cx * out_x + cy * out_y) / max(math.hypot(cx, cy), 1e-9)
            light += along[1][n] * opening * main * share * (1 - share) / 2 * inwards
    return light, scale * by_x, scale * by_y, scale * by_beta


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _crossing(
    x: float, y: float, radius: float, other_x: float, other_y: float, other: float
) -> tuple[int, float, float, float, float]:  # pragma: no cover - compiled
    """Where the rim of the disc at (x, y), counterclockwise, runs into another and out of it, after
    how they lie.

    0: the rims cross; 1: the disc lies in the other; -1: the other in it; 2: apart.
    """
    dx, dy = other_x - x, other_y - y
    square = dx * dx + dy * dy
    if square >= (radius + other) ** 2:
        return 2, 0.0, 0.0, 0.0, 0.0
    if square <= (radius - other) ** 2:
        return 1 if radius <= other else -1, 0.0, 0.0, 0.0, 0.0
    along = 0.5 + (radius - other) * (radius + other) / (2 * square)
    across = math.sqrt(max(radius * radius / square - along * along, 0.0))
    middle_x, middle_y = x + along * dx, y + along * dy
    return (
        0,
        middle_x + across * dy,
        middle_y - across * dx,
        middle_x - across * dy,
        middle_y + across * dx,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _within(
    x: float, y: float, other_x: float, other_y: float, other: float
) -> bool:  # pragma: no cover - compiled
    return (x - other_x) ** 2 + (y - other_y) ** 2 <= other * other


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _angle(
    x: float, y: float, start_x: float, start_y: float, end_x: float, end_y: float
) -> float:  # pragma: no cover - compiled
    """By which one turns, counterclockwise, round (x, y) from one point to the other."""
    ax, ay, bx, by = start_x - x, start_y - y, end_x - x, end_y - y
    angle = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
    return angle + 2 * math.pi if angle < -SAME_PLACE else angle


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _arcs(
    x: float,
    y: float,
    one: int,
    in1: bool,
    in1_x: float,
    in1_y: float,
    out1: bool,
    out1_x: float,
    out1_y: float,
    two: int,
    in2: bool,
    in2_x: float,
    in2_y: float,
    out2: bool,
    out2_x: float,
    out2_y: float,
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Parts of the rim round (x, y) in two other discs: the angle they open, and the way from their
    starts to their ends.

    For each other disc how it lies, as ``_crossing`` says, and where the rim runs into it and out,
    after whether that is within the other.
    """
    if one == -1 or two == -1:
        return 0.0, 0.0, 0.0
    if one == 1 and two == 1:
        return 2 * math.pi, 0.0, 0.0
    if in1 and in2 and out1 and out2:
        angle = _angle(x, y, in1_x, in1_y, out2_x, out2_y) + _angle(
            x, y, in2_x, in2_y, out1_x, out1_y
        )
        return angle, out1_x - in1_x + out2_x - in2_x, out1_y - in1_y + out2_y - in2_y
    if in1 == in2 or out1 == out2:
        return 0.0, 0.0, 0.0
    start_x, start_y = (in1_x, in1_y) if in1 else (in2_x, in2_y)
    end_x, end_y = (out1_x, out1_y) if out1 else (out2_x, out2_y)
    return _angle(x, y, start_x, start_y, end_x, end_y), end_x - start_x, end_y - start_y


@numba.njit(cache=True, nogil=True, error_model="numpy")
def common_area(
    small: float, main_x: float, main_y: float, main: float, dot_x: float, dot_y: float, dot: float
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Area common to three discs, ``small`` round the origin, and of the dot's rim in the others
    the length and the sum of normals.

    By Green's formula, arc by arc: half of radius^2 times its angle and of the cross product of its
    middle and of the way from its start to its end.
    """
    sm, m1x, m1y, m2x, m2y = _crossing(0.0, 0.0, small, main_x, main_y, main)
    sd, d1x, d1y, d2x, d2y = _crossing(0.0, 0.0, small, dot_x, dot_y, dot)
    md, e1x, e1y, e2x, e2y = _crossing(main_x, main_y, main, dot_x, dot_y, dot)
    if sm == 2 or sd == 2 or md == 2:
        return 0.0, 0.0, 0.0, 0.0
    # each corner of two discs, whether it lies in the third
    m1, m2 = (
        sm == 0 and _within(m1x, m1y, dot_x, dot_y, dot),
        sm == 0 and _within(m2x, m2y, dot_x, dot_y, dot),
    )
    d1 = sd == 0 and (sm == 1 or (sm == 0 and _within(d1x, d1y, main_x, main_y, main)))
    d2 = sd == 0 and (sm == 1 or (sm == 0 and _within(d2x, d2y, main_x, main_y, main)))
    e1 = md == 0 and (sm == -1 or (sm == 0 and _within(e1x, e1y, 0.0, 0.0, small)))
    e2 = md == 0 and (sm == -1 or (sm == 0 and _within(e2x, e2y, 0.0, 0.0, small)))
    turn, _, _ = _arcs(0.0, 0.0, sm, m1, m1x, m1y, m2, m2x, m2y, sd, d1, d1x, d1y, d2, d2x, d2y)
    area = small * small * turn
    turn, way_x, way_y = _arcs(
        main_x, main_y, -sm, m2, m2x, m2y, m1, m1x, m1y, md, e1, e1x, e1y, e2, e2x, e2y
    )
    area += main * main * turn + main_x * way_y - main_y * way_x
    turn, way_x, way_y = _arcs(
        dot_x, dot_y, -sd, d2, d2x, d2y, d1, d1x, d1y, -md, e2, e2x, e2y, e1, e1x, e1y
    )
    area += dot * dot * turn + dot_x * way_y - dot_y * way_x
    return max(0.5 * area, 0.0), dot * turn, way_y, -way_x


@numba.njit(cache=True, nogil=True, error_model="numpy")
def wide(
    x: float,
    y: float,
    spot: Array,
    radius: float,
    main: float,
    small: float,
    beta: float,
    within: Nodes,
) -> tuple[float, float, float, float, float]:  # pragma: no cover - compiled
    """Light in the pixel at (x, y) and its slopes by the spot's place, beta and the dot's radius:
    the mean of a few points, in closed form.

    As the dot's disc moves or grows, the common area grows by as much along that part of its rim
    which lies in the other two discs.
    """
    light, by_x, by_y, by_beta, by_radius = 0.0, 0.0, 0.0, 0.0, 0.0
    size = radius / abs(beta)
    for n in range(len(within[0])):
        for m in range(len(within[0])):
            ex, ey = x + within[0][n] / 2, y + within[0][m] / 2
            weight = within[1][n] * within[1][m] / 4
            ax, ay = (spot[0] - ex) / beta, (spot[1] - ey) / beta
            area, length, out_x, out_y = common_area(small, ex, ey, main, ax, ay, size)
            light += weight * area
            by_x += weight * out_x / beta
            by_y += weight * out_y / beta
            by_beta -= weight * (ax * out_x + ay * out_y + size * length) / beta
            by_radius += weight * length / abs(beta)
    return light, by_x, by_y, by_beta, by_radius

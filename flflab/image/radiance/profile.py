"""Antiderivatives of a radiance that varies along x only, so that its mean over a pixel and over a
chord of the pupil is exact.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.targets import Bars

Array = npt.NDArray[np.float64]

CELLS_PER_CYCLE = {"bars": 2, "chirp": 32}  # bars are constant in a cell, a sine is a cubic to 5e-7
ROUNDING = 1e-12  # of the number of cells from the left edge
LARGE = 1e3  # mm; a target's width as far as rounding goes
BOUNDLESS = 1e9  # mm; here a white half plane ends
# cells of a profile: over a shorter way a difference of second antiderivatives loses digits
SHORT = 0.5
MOST_STEPS = 4e6  # of a table of antiderivatives
NODES = np.polynomial.legendre.leggauss(4)[0]


@dataclass(frozen=True)
class Cropped:
    """Bars of which a card shows no more than so much round the middle, mm."""

    bars: Bars
    width: float
    height: float


Ruled = Bars | Cropped  # what varies along x only, between its ends


def cropped(target: Ruled) -> Cropped:
    """What is seen of bars: all that there are of them, or what a card shows."""
    return target if isinstance(target, Cropped) else Cropped(target, target.width, target.height)


def profile_table(target: Bars, width: float) -> tuple[Array, Array]:
    """The radiance along x, in the middle so many mm, as cubics between positions of equal steps of
    phase.

    Returns:
        The table, one row a cell: knot (mm from the centre), then the coefficients c0..c5 of its
            second antiderivative in
        powers of the distance from the knot. And the law: left edge, right edge, frequency at the
            left in cells/mm, half its
        slope in cells/mm^2, the first antiderivative at the right edge, and how many cells of the
        target lie left of the first knot's (from these follows the cell of a position).
    """
    per_cycle = CELLS_PER_CYCLE[target.kind]
    ends = np.array([-width / 2, width / 2])
    before, last = target.phase(ends) * per_cycle
    first_cell = math.floor(
        before * (1 + ROUNDING)
    )  # a card may end where a bar does, and rounding leave a cell without width
    cells = max(math.ceil(last * (1 - ROUNDING)) - first_cell, 1)
    knots = target.position(np.clip(first_cell + np.arange(cells + 1), before, last) / per_cycle)
    knots[0], knots[-1] = ends
    widths = np.diff(knots)
    inside = (NODES + 1) / 2
    at_nodes = target.profile(target.phase(knots[:-1, None] + widths[:, None] * inside))
    cubic = at_nodes @ np.linalg.inv(np.vander(inside, increasing=True)).T
    powers = np.arange(4)
    area = widths * (cubic / (powers + 1)).sum(axis=1)
    moment = widths**2 * (cubic / ((powers + 1) * (powers + 2))).sum(axis=1)
    first = np.concatenate([[0.0], np.cumsum(area)])
    second = np.concatenate([[0.0], np.cumsum(first[:-1] * widths + moment)])
    table = np.zeros((cells, 8))
    table[:, 0], table[:, 1], table[:, 2] = knots[:-1], second[:-1], first[:-1]
    table[:, 3:7] = cubic / widths[:, None] ** powers / ((powers + 1) * (powers + 2))
    left, right = target.cycles_per_mm
    at_left, half_slope = (
        float(target.frequency(ends[0])) * per_cycle,
        (right - left) * per_cycle / (2 * target.width),
    )
    return table, np.array([*ends, at_left, half_slope, first[-1], max(before - first_cell, 0.0)])


def half_plane() -> tuple[Array, Array]:
    """Table and law of white from x = 0 on."""
    table = np.zeros((1, 8))
    table[0, 3] = 0.5
    return table, np.array([0.0, BOUNDLESS, 0.0, 0.0, BOUNDLESS, 0.0])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def second_antiderivative(x: float, table: Array, law: Array) -> float:
    """Second antiderivative of the radiance at x mm; written without branches, it is the innermost
    of all.
    """
    inside = min(max(x, law[0]), law[1])
    along = inside - law[0]
    cell = min(int(law[5] + along * (law[2] + law[3] * along)), table.shape[0] - 1)
    d = inside - table[cell, 0]
    c0, c1, c2, c3, c4, c5 = (
        table[cell, 1],
        table[cell, 2],
        table[cell, 3],
        table[cell, 4],
        table[cell, 5],
        table[cell, 6],
    )
    return c0 + d * (c1 + d * (c2 + d * (c3 + d * (c4 + d * c5)))) + law[4] * max(x - law[1], 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def first_antiderivative(x: float, table: Array, law: Array) -> float:
    """First antiderivative of the radiance at x mm."""
    inside = min(max(x, law[0]), law[1])
    along = inside - law[0]
    cell = min(int(law[5] + along * (law[2] + law[3] * along)), table.shape[0] - 1)
    d = inside - table[cell, 0]
    c1, c2, c3, c4, c5 = (
        table[cell, 2],
        table[cell, 3],
        table[cell, 4],
        table[cell, 5],
        table[cell, 6],
    )
    return c1 + d * (2.0 * c2 + d * (3.0 * c3 + d * (4.0 * c4 + d * 5.0 * c5)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def first_mean(left: float, right: float, table: Array, law: Array) -> float:
    """Mean of the first antiderivative from ``left`` to ``right`` mm, however near to each other:
    cell by cell, no digits are lost.
    """
    low, high = min(left, right), max(left, right)
    begin, end = min(max(low, law[0]), law[1]), min(max(high, law[0]), law[1])
    total = law[4] * max(
        high - max(low, law[1]), 0.0
    )  # beyond the right edge it stays what it is there
    last = table.shape[0] - 1
    cell = min(int(law[5] + (begin - law[0]) * (law[2] + law[3] * (begin - law[0]))), last)
    while begin < end:
        stop = min(table[cell + 1, 0], end) if cell < last else end
        if stop > begin:
            u, v = begin - table[cell, 0], stop - table[cell, 0]
            c1, c2, c3, c4, c5 = (
                table[cell, 2],
                table[cell, 3],
                table[cell, 4],
                table[cell, 5],
                table[cell, 6],
            )
            second, third = u * u + v * (u + v), u * u * u + v * (u * u + v * (u + v))
            fourth = u * u * u * u + v * third
            total += (stop - begin) * (c1 + c2 * (u + v) + c3 * second + c4 * third + c5 * fourth)
            begin = stop
        cell += 1
    return total / (high - low) if high > low else first_antiderivative(low, table, law)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def radiance_at(x: float, table: Array, law: Array) -> float:
    """Radiance at x mm."""
    if x < law[0] or x > law[1]:
        return 0.0
    along = x - law[0]
    cell = min(int(law[5] + along * (law[2] + law[3] * along)), table.shape[0] - 1)
    d = x - table[cell, 0]
    return 2.0 * table[cell, 3] + d * (
        6.0 * table[cell, 4] + d * (12.0 * table[cell, 5] + d * 20.0 * table[cell, 6])
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def profile_mean(x: float, box: float, other: float, table: Array, law: Array) -> float:
    """Mean radiance at x smoothed by two boxes of these widths (mm); below 3e-8 of the target's
    width a box counts as 0.
    """
    wide = max(box, other)
    narrow = min(box, other)
    least = 3e-8 * min(law[1] - law[0], LARGE)
    if wide < least:
        return radiance_at(x, table, law)
    if narrow < least:
        return (
            first_antiderivative(x + 0.5 * wide, table, law)
            - first_antiderivative(x - 0.5 * wide, table, law)
        ) / wide
    outer = 0.5 * (wide + narrow)
    inner = 0.5 * (wide - narrow)
    if narrow * (law[2] + 2.0 * law[3] * (min(max(x, law[0]), law[1]) - law[0])) < SHORT:
        slope = (
            first_mean(x + inner, x + outer, table, law)
            - first_mean(x - outer, x - inner, table, law)
        ) / wide
        return min(max(slope, 0.0), 1.0)
    ends = second_antiderivative(x + outer, table, law) - second_antiderivative(
        x + inner, table, law
    )
    ends -= second_antiderivative(x - inner, table, law) - second_antiderivative(
        x - outer, table, law
    )
    return min(max(ends / (wide * narrow), 0.0), 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def moved_mean(x: float, box: float, other: float, table: Array, law: Array, ways: Array) -> float:
    """The mean over some moments of ``profile_mean`` at x + way."""
    total = 0.0
    for way in ways:
        total += profile_mean(x + way, box, other, table, law)
    return total / ways.size


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_antiderivative(
    out: Array,
    first: int,
    count: int,
    low: float,
    step: float,
    box: float,
    other: float,
    datum: float,
    table: Array,
    law: Array,
    ways: Array,
) -> None:
    """Antiderivative of the radiance smoothed by two boxes, less ``datum``, at ``count`` places
    from ``low`` on, into out[first:].

    The places lie ``step`` apart. It is the mean over some moments at which the radiance is moved
    by so many mm, ``ways``.
    """
    wide = max(box, other)
    narrow = min(box, other)
    margin = math.ceil(0.5 * narrow / step) + 1 if narrow > 0.5 * step else 0
    places = count + 2 * margin
    before = math.ceil(max(0.0, -ways.min()) / step)
    still = np.empty(places + before + math.ceil(max(0.0, ways.max()) / step) + 1)
    start = low - (margin + before) * step
    ahead = int(wide / step + 0.5)
    if ahead > 0 and abs(ahead * step - wide) < 1e-9 * wide:
        second = np.empty(still.size + ahead)
        for index in range(second.size):
            second[index] = second_antiderivative(start + index * step - 0.5 * wide, table, law)
        for index in range(still.size):
            still[index] = (second[index + ahead] - second[index]) / wide
    else:
        for index in range(still.size):
            x = start + index * step
            if wide > 0.01 * step:
                still[index] = (
                    second_antiderivative(x + 0.5 * wide, table, law)
                    - second_antiderivative(x - 0.5 * wide, table, law)
                ) / wide
            else:
                still[index] = first_antiderivative(x, table, law)
    # The mean over the moments of the straight lines between the places.
    plain = np.zeros(places)
    for way in ways:
        moved = way / step + before
        base = min(int(moved), still.size - places - 1)
        beyond = (moved - base) / ways.size
        for index in range(places):
            plain[index] += still[base + index] / ways.size + beyond * (
                still[base + index + 1] - still[base + index]
            )
    if margin == 0:
        out[first : first + count] = plain - datum
        return
    # The mean over the narrower box of the straight lines between the places.
    sums = np.empty(places)
    sums[0] = 0.0
    for index in range(1, places):
        sums[index] = sums[index - 1] + 0.5 * (plain[index] + plain[index - 1])
    reach = 0.5 * narrow / step
    whole = int(reach)
    rest = reach - whole
    for index in range(count):
        right = index + margin + whole
        left = index + margin - whole
        total = sums[right] - sums[left] + rest * (plain[right] + plain[left])
        total += (
            0.5 * rest * rest * (plain[right + 1] - plain[right] + plain[left - 1] - plain[left])
        )
        out[first + index] = total / (2.0 * reach) - datum


@numba.njit(cache=True, nogil=True, error_model="numpy")
def prepare(
    low: float,
    high: float,
    spread: float,
    boxes: Array,
    fine: float,
    table: Array,
    law: Array,
    ways: Array,
    places: Array,
) -> Array:
    """Antiderivatives of the profile from ``low`` to ``high`` (x' at the pupil's centre), one
    behind the other for each pair of boxes.

    The straight lines between their steps change a mean over the pupil by up to ``fine``.

    Args:
        low: lowest x' of a ray through the pupil's centre, mm.
        high: highest.
        spread: change of x' over the pupil's radius, mm; above 0.
        boxes: widths of the two boxes, shape (3, 2).
        fine: largest error.
        table: see ``profile_table``.
        law: its law.
        ways: how far the radiance is moved at some moments, mm, against x'.
        places: filled with first position, 1 / step, first and last index of each, shape (3, 4).
    """
    counts = np.zeros(3, dtype=np.int64)
    steps = np.empty(3)
    total = 0
    for kind in range(3):
        same = -1
        for earlier in range(kind):
            if boxes[earlier, 0] == boxes[kind, 0] and boxes[earlier, 1] == boxes[kind, 1]:
                same = earlier
        if same >= 0:
            places[kind] = places[same]
            continue
        wide = max(boxes[kind, 0], boxes[kind, 1])
        steps[kind] = max(
            math.sqrt(fine * wide * spread / 0.16),
            fine * spread / 0.3,
            2.0 * fine * wide,
            (high - low) / MOST_STEPS,
        )
        if steps[kind] < wide:
            steps[kind] = wide / math.ceil(wide / steps[kind])  # then the box's ends fall on steps
        first = max(low - spread, law[0] - 2.0 * wide - ways.max())
        last = max(min(high + spread, law[1] + 2.0 * wide - ways.min()), first)
        counts[kind] = int((last - first) / steps[kind]) + 3
        places[kind, 0] = first - 0.5 * steps[kind]
        places[kind, 1] = 1.0 / steps[kind]
        places[kind, 2] = total
        places[kind, 3] = total + counts[kind] - 2
        total += counts[kind]
    sums, datum = (
        np.empty(total),
        first_antiderivative(0.5 * (low + high), table, law),
    )  # near 0, that differences lose few digits
    for kind in range(3):
        if counts[kind] > 0:
            start, step = int(places[kind, 2]), steps[kind]
            fill_antiderivative(
                sums,
                start,
                counts[kind],
                places[kind, 0],
                step,
                boxes[kind, 0],
                boxes[kind, 1],
                datum,
                table,
                law,
                ways,
            )
    return sums


@numba.njit(cache=True, nogil=True, error_model="numpy")
def step_mean(x: float, box1: float, box2: float) -> float:
    """A step from 0 to 1 at x = 0, smoothed by two boxes of these widths."""
    outer = 0.5 * (box1 + box2)
    if x >= outer:
        return 1.0
    if x <= -outer:
        return 0.0
    inner = 0.5 * abs(box1 - box2)
    wide = max(box1, box2)
    if abs(x) <= inner:
        return 0.5 + x / wide
    narrow = min(box1, box2)
    corner = 0.5 * (outer - abs(x)) ** 2 / (wide * narrow)
    return 1.0 - corner if x > 0.0 else corner

"""Strips across a clipped pupil: along each the mean of a profile is a difference of its antiderivative, read from a table."""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.profile import fill_antiderivative, step_mean

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

MOST_STEPS = 4e6  # of a table

# Sums may be taken in any order; nothing here is infinite or not a number.
LOOSE = {"contract", "nsz", "nnan", "ninf", "reassoc", "arcp"}


def strip_nodes(counts: Whole) -> Array:
    """Heights, weights and half lengths of the strips of the unit disc for each count, shape (K, 3, most strips).

    They are Gauss's rule for the weight sqrt(1 - y^2).
    """
    nodes = np.zeros((len(counts), 3, max(int(counts.max()), 1)))
    for kind, count in enumerate(counts):
        angle = np.pi * np.arange(1, count + 1) / (count + 1)
        nodes[kind, :, :count] = np.cos(angle), np.pi / (count + 1) * np.sin(angle), np.sin(angle)
    return nodes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lens_span(x: float, y: float, radius: float) -> tuple[float, float]:
    """Lowest and highest y common to the unit disc and a disc at (x, y) of a radius of at least 1 that cuts it."""
    squared = x * x + y * y
    low, high = -1.0, 1.0
    cut_top = squared - 2.0 * y + 1.0 > radius * radius
    cut_bottom = squared + 2.0 * y + 1.0 > radius * radius
    if cut_top or cut_bottom:
        inverse = 1.0 / squared
        along = 0.5 * (1.0 + squared - radius * radius) * inverse
        across = abs(x) * math.sqrt(max(0.0, inverse - along * along))
        if cut_top:
            high = y + radius if x * x + (y + radius) ** 2 < 1.0 else along * y + across
        if cut_bottom:
            low = y - radius if x * x + (y - radius) ** 2 < 1.0 else along * y - across
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def full_mean(base: float, spread: float, strips: Array, count: int, sums: Array, place: Array) -> float:
    """Mean of a profile over the whole pupil.

    Args:
        base: x' at the pupil's centre, mm.
        spread: change of x' over the pupil's radius, mm.
        strips: see ``strip_nodes``.
        count: how many there are.
        sums: antiderivatives at even steps of x'.
        place: where in ``sums`` to look: first position, 1 / step, first index, last index.
    """
    start = (base - place[0]) * place[1] + place[2]
    slope = spread * place[1]
    low, high = place[2], place[3]
    total = 0.0
    for strip in range(count):
        right = min(max(start + slope * strips[2, strip], low), high)
        left = min(max(start - slope * strips[2, strip], low), high)
        i, j = np.int64(right), np.int64(left)
        at, to = np.uint64(i), np.uint64(j)
        above = sums[at] + (right - i) * (sums[at + np.uint64(1)] - sums[at])
        total += strips[1, strip] * (above - sums[to] - (left - j) * (sums[to + np.uint64(1)] - sums[to]))
    return total / (math.pi * spread)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def clipped_mean(
    base: float,
    spread: float,
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    sums: Array,
    place: Array,
    clipped: Array,
) -> float:
    """The same over the part of the pupil from ``low`` to ``high`` inside the disc at (x, y); ``clipped`` is the place for its ends."""
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low)
    squared = radius * radius
    light = 0.0
    area = 0.0
    start1, slope1, low1, high1 = (base - place[0]) * place[1] + place[2], spread * place[1], place[2], place[3]
    start2, slope2, low2, high2 = (base - clipped[0]) * clipped[1] + clipped[2], spread * clipped[1], clipped[2], clipped[3]
    for strip in range(count):
        at = middle + reach * strips[0, strip]
        off = at - y
        own = math.sqrt(max(0.0, 1.0 - at * at))
        other = math.sqrt(max(0.0, squared - off * off))
        cut_right = x + other < own
        cut_left = x - other > -own
        right = x + other if cut_right else own
        left = x - other if cut_left else -own
        right = max(left, right)
        up = min(max(start2 + slope2 * right, low2), high2) if cut_right else min(max(start1 + slope1 * right, low1), high1)
        down = min(max(start2 + slope2 * left, low2), high2) if cut_left else min(max(start1 + slope1 * left, low1), high1)
        i, j = np.int64(up), np.int64(down)
        upper, lower = np.uint64(i), np.uint64(j)
        above = sums[upper] + (up - i) * (sums[upper + np.uint64(1)] - sums[upper])
        light += strips[1, strip] * (above - sums[lower] - (down - j) * (sums[lower + np.uint64(1)] - sums[lower]))
        area += strips[1, strip] * (right - left)
    return light / (spread * area) if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def slanted_mean(
    base: float,
    spread: float,
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    sums: Array,
    place: Array,
    clipped: Array,
    chunks: int,
    slant: tuple[float, float, float],
) -> float:
    """The mean of ``clipped_mean`` where rays count by cos^4 of their slope.

    Args:
        base: x' at the pupil's centre, mm.
        spread: change of x' over the pupil's radius, mm.
        x: centre of the clipping disc, in units of the pupil.
        y: the same across the strips.
        radius: of the clipping disc.
        low: where the strips begin.
        high: where they end.
        strips: see ``strip_nodes``.
        count: how many there are.
        sums: antiderivatives at even steps of x'.
        place: where in ``sums`` to look.
        clipped: the same for ends at the clipping disc.
        chunks: into how many pieces a strip is cut, each of one weight.
        slant: slope at the sensor of the ray through the pupil's centre along the strips and across them, its change over the radius.
    """
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low)
    squared = radius * radius
    light = 0.0
    area = 0.0
    start1, slope1, low1, high1 = (base - place[0]) * place[1] + place[2], spread * place[1], place[2], place[3]
    start2, slope2, low2, high2 = (base - clipped[0]) * clipped[1] + clipped[2], spread * clipped[1], clipped[2], clipped[3]
    slant_x, slant_y, slant_spread = slant
    for chunk in range(chunks):
        begin, end = chunk / chunks, (chunk + 1) / chunks
        first, last = chunk == 0, chunk == chunks - 1
        for strip in range(count):
            at = middle + reach * strips[0, strip]
            off = at - y
            own = math.sqrt(max(0.0, 1.0 - at * at))
            other = math.sqrt(max(0.0, squared - off * off))
            cut_right = x + other < own
            cut_left = x - other > -own
            left = x - other if cut_left else -own
            right = max(left, x + other if cut_right else own)
            to = left + end * (right - left)
            left += begin * (right - left)
            up = min(max(start2 + slope2 * to, low2), high2) if cut_right & last else min(max(start1 + slope1 * to, low1), high1)
            down = min(max(start2 + slope2 * left, low2), high2) if cut_left & first else min(max(start1 + slope1 * left, low1), high1)
            i, j = np.int64(up), np.int64(down)
            upper, lower = np.uint64(i), np.uint64(j)
            above = sums[upper] + (up - i) * (sums[upper + np.uint64(1)] - sums[upper])
            along = slant_x + slant_spread * 0.5 * (left + to)
            across = slant_y + slant_spread * at
            falling = 1.0 + along * along + across * across
            piece = above - sums[lower] - (down - j) * (sums[lower + np.uint64(1)] - sums[lower])
            light += strips[1, strip] * piece / (falling * falling)
            area += strips[1, strip] * (to - left)
    return light / (spread * area) if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def antiderivative(at: float, sums: Array, place: Array) -> float:
    """The antiderivative at x' = ``at``, by straight lines between the steps."""
    where = min(max((at - place[0]) * place[1] + place[2], place[2]), place[3])
    index = int(where)
    return sums[index] + (where - index) * (sums[index + 1] - sums[index])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weighted_mean(
    base: float,
    spread: float,
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    sums: Array,
    place: Array,
    clipped: Array,
    chunks: int,
    slant: tuple[float, float, float],
    across: tuple[float, float, float],
    window: Array,
) -> float:
    """The mean of ``slanted_mean`` where rays count by a window in y', too.

    Args:
        base: x' at the pupil's centre, mm.
        spread: change of x' over the pupil's radius, mm.
        x: centre of the clipping disc, in units of the pupil.
        y: the same across the strips.
        radius: of the clipping disc.
        low: where the strips begin.
        high: where they end.
        strips: see ``strip_nodes``.
        count: how many there are.
        sums: antiderivatives at even steps of x'.
        place: where in ``sums`` to look.
        clipped: the same for ends at the clipping disc.
        chunks: into how many pieces a strip is cut, each of one weight.
        slant: see ``slanted_mean``.
        across: y' at the pupil's centre, its change over the radius along the strips and across them, mm.
        window: lower and upper end, and the widths of the two boxes that smooth it.
    """
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low)
    light = 0.0
    area = 0.0
    for strip in range(count):
        at = middle + reach * strips[0, strip]
        off = at - y
        own = math.sqrt(max(0.0, 1.0 - at * at))
        other = math.sqrt(max(0.0, radius * radius - off * off))
        right = min(own, x + other)
        left = max(-own, x - other)
        if right <= left:
            continue
        area += strips[1, strip] * (right - left)
        thick = abs(across[2]) * reach * strips[1, strip]
        second = (
            math.sqrt(window[3] * window[3] + thick * thick)
            if window[2] > thick
            else math.sqrt(window[3] * window[3] + window[2] * window[2])
        )
        height = across[0] + across[1] * 0.5 * (left + right) + across[2] * at
        seen = window_mean(height, window[0], window[1], max(window[2], thick), second)
        if seen == 0.0:
            continue
        steep = slant[1] + slant[2] * at
        before = antiderivative(base + spread * left, sums, clipped if x - other > -own else place)
        part = (right - left) / chunks
        total = 0.0
        for chunk in range(chunks):
            end = left + part * (chunk + 1)
            last = chunk == chunks - 1 and x + other < own
            after = antiderivative(base + spread * end, sums, clipped if last else place)
            along = slant[0] + slant[2] * (end - 0.5 * part)
            total += (after - before) / (1.0 + along * along + steep * steep) ** 2
            before = after
        light += strips[1, strip] * seen * total / spread
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def window_mean(y: float, lower: float, upper: float, box: float, other: float) -> float:
    """A window from ``lower`` to ``upper`` at y, smoothed by boxes of two widths."""
    return step_mean(y - lower, box, other) - step_mean(y - upper, box, other)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def prepare(
    low: float,
    high: float,
    spread: float,
    boxes: Array,
    fine: float,
    table: Array,
    law: Array,
    places: Array,
) -> Array:
    """Antiderivatives of the profile from ``low`` to ``high`` (x' at the pupil's centre), one behind the other for each pair of boxes.

    The straight lines between their steps change a mean over the pupil by up to ``fine``.

    Args:
        low: lowest x' of a ray through the pupil's centre, mm.
        high: highest.
        spread: change of x' over the pupil's radius, mm; above 0.
        boxes: widths of the two boxes, shape (3, 2).
        fine: largest error.
        table: see ``profile_table``.
        law: its law.
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
        steps[kind] = max(math.sqrt(fine * wide * spread / 0.16), fine * spread / 0.3, 2.0 * fine * wide, (high - low) / MOST_STEPS)
        if steps[kind] < wide:
            steps[kind] = wide / math.ceil(wide / steps[kind])  # then the box's ends fall on steps
        first = max(low - spread, law[0] - 2.0 * wide)
        last = max(min(high + spread, law[1] + 2.0 * wide), first)
        counts[kind] = int((last - first) / steps[kind]) + 3
        places[kind, 0] = first - 0.5 * steps[kind]
        places[kind, 1] = 1.0 / steps[kind]
        places[kind, 2] = total
        places[kind, 3] = total + counts[kind] - 2
        total += counts[kind]
    sums = np.empty(total)
    for kind in range(3):
        if counts[kind] > 0:
            start, step = int(places[kind, 2]), steps[kind]
            fill_antiderivative(sums, start, counts[kind], places[kind, 0], step, boxes[kind, 0], boxes[kind, 1], table, law)
    return sums

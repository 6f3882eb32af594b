"""Strips across a clipped pupil: along each the mean of a profile is a difference of its
antiderivative, read from a table.

Many sensor points are worked out side by side, so that the processor's vectors are full whatever
the number of strips.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.clipping import clip, lens_span
from flflab.image.radiance.profile import step_mean
from flflab.optics.discs import LOOSE

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

BLOCK = 256  # sensor points side by side
# Where their numbers begin in one array of ROWS times BLOCK: its parts lie fixed steps apart, or
# the compiler makes no use of vectors.
EX, EY, MEAN, BASE, CLIP_X, CLIP_Y, MIDDLE, REACH, AREA, RIGHT, LEFT, WEIGHT, FROM, LENGTH = range(
    0, 14 * BLOCK, BLOCK
)
ROWS = 14
GAUSS = 0.5 / math.sqrt(3.0)  # of a piece's length: how far its two nodes lie from its middle


def strip_nodes(counts: Whole) -> Array:
    """Heights, weights and half lengths of the strips of the unit disc for each count, shape (K, 3,
    most strips).

    They are Gauss's rule for the weight sqrt(1 - y^2).
    """
    nodes = np.zeros((len(counts), 3, max(int(counts.max()), 1)))
    for kind, count in enumerate(counts):
        angle = np.pi * np.arange(1, count + 1) / (count + 1)
        nodes[kind, :, :count] = np.cos(angle), np.pi / (count + 1) * np.sin(angle), np.sin(angle)
    return nodes


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=LOOSE)
def strip_means(
    points: Array,
    number: int,
    landing: tuple[float, float, float, float, float, float],
    cone: tuple[float, float],
    strips: Array,
    count: int,
    sums: Array,
    whole: Array,
    cut: Array,
    chunks: int,
    slant: tuple[float, float, float, float],
) -> None:
    """Mean of a profile over the part of the pupil that lights each of some sensor points.

    Args:
        points: numbers of BLOCK sensor points each, shape (ROWS * BLOCK,): from EX and EY on their
            places from the micro-image's centre, mm; from MEAN on they are filled; the rest is
            scratch.
        number: how many points there are, up to BLOCK.
        landing: x' of the ray through the pupil's centre from the micro-image's centre (mm on the
            target), its change per mm on the sensor along x and y, its change over the pupil's
            radius, and the direction in the pupil in which it changes.
        cone: slope and reach of the micro-image, mm.
        strips: see ``strip_nodes``.
        count: how many there are.
        sums: antiderivatives at even steps of x'.
        whole: where in ``sums`` to look: first position, 1 / step, first index, last index.
        cut: the same for ends of strips at the clipping disc.
        chunks: into how many pieces a strip is cut, of two of Gauss's nodes each, to count rays by
            cos^4 of their slopes; 0 where all count alike.
        slant: slope (x, y) of the middle ray at the sensor, its change per mm on the sensor and per
            unit of pupil.
    """
    origin, by_x, by_y, spread, along_x, along_y = landing
    slope, reach = cone
    radius = reach / abs(slope) if slope != 0.0 else 2.0
    squared = radius * radius
    for p in range(number):
        ex, ey = points[EX + p], points[EY + p]
        x, y = clip(ex, ey, along_x, along_y, slope, reach)
        low, high = lens_span(x, y, radius)
        points[BASE + p] = origin + by_x * ex + by_y * ey
        points[CLIP_X + p] = x
        points[CLIP_Y + p] = y
        points[MIDDLE + p] = 0.5 * (low + high)
        points[REACH + p] = 0.5 * (high - low)
        points[MEAN + p] = 0.0
        points[AREA + p] = 0.0
    start1, step1, low1, high1 = whole[0], whole[1], whole[2], whole[3]
    start2, step2, low2, high2 = cut[0], cut[1], cut[2], cut[3]
    for strip in range(count):
        node, weight = strips[0, strip], strips[1, strip]
        for p in range(number):
            shift = points[CLIP_X + p]
            at = points[MIDDLE + p] + points[REACH + p] * node
            off = at - points[CLIP_Y + p]
            own = math.sqrt(max(0.0, 1.0 - at * at))
            other = math.sqrt(max(0.0, squared - off * off))
            left = max(shift - other, -own)
            length = max(0.0, min(shift + other, own) - left)
            right = left + length
            to, came = points[BASE + p] + spread * right, points[BASE + p] + spread * left
            to1 = min(max((to - start1) * step1 + low1, low1), high1)
            to2 = min(max((to - start2) * step2 + low2, low2), high2)
            came1 = min(max((came - start1) * step1 + low1, low1), high1)
            came2 = min(max((came - start2) * step2 + low2, low2), high2)
            up, down = to2 if shift + other < own else to1, came2 if shift - other > -own else came1
            points[RIGHT + p], points[LEFT + p] = up, down
            points[FROM + p], points[LENGTH + p] = left, length
            points[AREA + p] += weight * length
            slant_x = (
                slant[0] + slant[2] * points[EX + p] + slant[3] * (along_x * right - along_y * at)
            )
            slant_y = (
                slant[1] + slant[2] * points[EY + p] + slant[3] * (along_y * right + along_x * at)
            )
            falling = 1.0 + slant_x * slant_x + slant_y * slant_y
            points[WEIGHT + p] = weight / (falling * falling) if chunks > 0 else weight
        for p in range(
            number
        ):  # apart from the above: reading here and there is faster without vectors
            up, down = points[RIGHT + p], points[LEFT + p]
            i, j = np.int64(up), np.int64(down)
            upper, lower = np.uint64(i), np.uint64(j)
            before = sums[lower] + (down - j) * (sums[lower + np.uint64(1)] - sums[lower])
            light = sums[upper] + (up - i) * (sums[upper + np.uint64(1)] - sums[upper]) - before
            points[MEAN + p] += points[WEIGHT + p] * light
            points[LEFT + p] = before
        for half in range(
            2 * chunks
        ):  # by parts: the weight at the right end, less what it gained on the way to there
            place = (half // 2 + 0.5 + (GAUSS if half % 2 else -GAUSS)) / chunks
            for p in range(number):
                x, at = (
                    points[FROM + p] + place * points[LENGTH + p],
                    points[MIDDLE + p] + points[REACH + p] * node,
                )
                points[RIGHT + p] = min(
                    max((points[BASE + p] + spread * x - start1) * step1 + low1, low1), high1
                )
                slant_x = (
                    slant[0] + slant[2] * points[EX + p] + slant[3] * (along_x * x - along_y * at)
                )
                slant_y = (
                    slant[1] + slant[2] * points[EY + p] + slant[3] * (along_y * x + along_x * at)
                )
                falling = 1.0 + slant_x * slant_x + slant_y * slant_y
                gained = (
                    -4.0
                    * slant[3]
                    * (slant_x * along_x + slant_y * along_y)
                    / (falling * falling * falling)
                )
                points[WEIGHT + p] = weight * points[LENGTH + p] * gained / (2 * chunks)
            for p in range(number):
                up = points[RIGHT + p]
                i = np.int64(up)
                upper = np.uint64(i)
                light = (
                    sums[upper]
                    + (up - i) * (sums[upper + np.uint64(1)] - sums[upper])
                    - points[LEFT + p]
                )
                points[MEAN + p] -= points[WEIGHT + p] * light
    for p in range(number):
        points[MEAN + p] = points[MEAN + p] / max(spread * points[AREA + p], 1e-300)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def antiderivative(at: float, sums: Array, place: Array) -> float:
    """The antiderivative at x' = ``at``, by straight lines between the steps."""
    where = min(max((at - place[0]) * place[1] + place[2], place[2]), place[3])
    index = int(where)
    return sums[index] + (where - index) * (sums[index + 1] - sums[index])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weighted_mean(
    ex: float,
    ey: float,
    landing: tuple[float, float, float, float, float, float],
    cone: tuple[float, float],
    strips: Array,
    count: int,
    sums: Array,
    whole: Array,
    cut: Array,
    chunks: int,
    slant: tuple[float, float, float, float],
    across: tuple[float, float, float],
    window: Array,
) -> float:
    """The mean of ``strip_means`` for one sensor point where rays count by a window in y', too.

    Args:
        ex: place of the sensor point, mm from the micro-image's centre.
        ey: the same along y.
        landing: see ``strip_means``.
        cone: the same.
        strips: the same.
        count: the same.
        sums: the same.
        whole: the same.
        cut: the same.
        chunks: the same.
        slant: the same.
        across: y' at the pupil's centre, its change over the radius along the strips and across
            them, mm.
        window: lower and upper end, and the widths of the two boxes that smooth it.
    """
    origin, by_x, by_y, spread, along_x, along_y = landing
    slope, reach = cone
    radius = reach / abs(slope) if slope != 0.0 else 2.0
    x, y = clip(ex, ey, along_x, along_y, slope, reach)
    low, high = lens_span(x, y, radius)
    base = origin + by_x * ex + by_y * ey
    light, area = 0.0, 0.0
    for strip in range(count):
        at = 0.5 * (low + high) + 0.5 * (high - low) * strips[0, strip]
        own = math.sqrt(max(0.0, 1.0 - at * at))
        other = math.sqrt(max(0.0, radius * radius - (at - y) * (at - y)))
        right, left = min(own, x + other), max(-own, x - other)
        if right <= left:
            continue
        area += strips[1, strip] * (right - left)
        thick = abs(across[2]) * 0.5 * (high - low) * strips[1, strip]
        second = math.sqrt(window[3] * window[3] + min(window[2], thick) ** 2)
        height = across[0] + across[1] * 0.5 * (left + right) + across[2] * at
        seen = window_mean(height, window[0], window[1], max(window[2], thick), second)
        if seen == 0.0:
            continue
        before = antiderivative(base + spread * left, sums, cut if x - other > -own else whole)
        after = antiderivative(base + spread * right, sums, cut if x + other < own else whole)
        slant_x, slant_y = (
            slant[0] + slant[2] * ex - slant[3] * along_y * at,
            slant[1] + slant[2] * ey + slant[3] * along_x * at,
        )
        to_x, to_y = slant[3] * along_x, slant[3] * along_y
        falling = (
            1.0 + (slant_x + to_x * right) ** 2 + (slant_y + to_y * right) ** 2
            if chunks > 0
            else 1.0
        )
        total = (after - before) / (falling * falling)
        for half in range(2 * chunks):
            to = (
                left + (right - left) * (half // 2 + 0.5 + (GAUSS if half % 2 else -GAUSS)) / chunks
            )
            one, other_one = slant_x + to_x * to, slant_y + to_y * to
            falling = 1.0 + one * one + other_one * other_one
            gained = -4.0 * (one * to_x + other_one * to_y) / (falling * falling * falling)
            total -= (
                (right - left)
                / (2 * chunks)
                * gained
                * (antiderivative(base + spread * to, sums, whole) - before)
            )
        light += strips[1, strip] * seen * total / spread
    return light / area if area > 0.0 else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def window_mean(y: float, lower: float, upper: float, box: float, other: float) -> float:
    """A window from ``lower`` to ``upper`` at y, smoothed by boxes of two widths."""
    return step_mean(y - lower, box, other) - step_mean(y - upper, box, other)

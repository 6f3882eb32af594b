"""Images of dots: the light of the area common to three discs, or a grid of pupil points at each of
which a pixel's mean is exact.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.falloff_means import seen_weight
from flflab.image.geometry.rim import part_share
from flflab.image.light.dot_area import MOST_SQUARES, spot_light, weighted_share
from flflab.image.light.lenses import Lenses
from flflab.image.radiance.askew import mean_over
from flflab.image.radiance.neighbourhood import DISC
from flflab.optics.discs import lens_chord, lens_rows, two_disc_area

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

MOST_DIVIDED = 32  # parts a side of a pixel that a steep rim cuts
# of a dot's radius, of half the height of bars or of a texel; a smaller pixel, or part of one, sees
# as much as this
LEAST_BOX = 3e-5


class DotSeen(NamedTuple):
    """A dot round x' = y' = 0 as all entries see it.

    Attributes:
        lenses: the entries.
        counts: points a side across the pupil for each kind of rim; 0 for the three-disc formula at
            the sub-pixels' centres.
        divided: parts a side of a pixel outside the rim that such points see, for the fall-off, for
            each kind of rim.
        strips: see ``strip_nodes``.
        chords: see ``chord_nodes``.
        weighing: heights and weights of the chords that tell the fall-off of the three-disc
            formula, shape (2, n); none without it.
        allowed: error of a pixel's mean by the three-disc formula, of white.
        numbers: the dot's radius, mm, and what ``mean_over`` asks for besides.
        table: of no bars.
        law: the same.
        sums: of no picture.
    """

    lenses: Lenses
    counts: Whole
    divided: Whole
    strips: Array
    chords: Array
    weighing: Array
    allowed: float
    numbers: Array
    table: Array
    law: Array
    sums: Array


def chord_nodes(counts: Whole) -> Array:
    """Gauss-Legendre places and weights along a chord for each count, shape (K, 2, most)."""
    nodes = np.zeros((len(counts), 2, max(int(counts.max()), 1)))
    for count in np.unique(counts[counts > 0]):
        nodes[counts == count, :, :count] = np.polynomial.legendre.leggauss(int(count))
    return nodes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sampled_mean(
    ex: float,
    ey: float,
    cone: Array,
    to: Array,
    rows: Array,
    chord: Array,
    count: int,
    part: float,
    kind: int,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
    slants: Array,
) -> float:
    """Mean radiance over a grid of count x count points of the part of the pupil that lights the
    sensor point (ex, ey) mm.

    The points tell how what is seen changes over the pupil; the fall-off of all of it is told
    apart, for few points miss it where the rim cuts the pupil.

    Args:
        ex: place of the sensor point from the micro-image's centre.
        ey: the same along y.
        cone: slope and reach, mm.
        to: the maps to the target, see ``add_ruled``.
        rows: see ``strip_nodes``.
        chord: see ``chord_nodes``.
        count: points a side.
        part: side of the part of a pixel that the sensor point stands for, mm.
        kind: of the target, see ``mean_over``.
        numbers: of the target.
        table: the same.
        law: the same.
        sums: the same.
        slants: see ``add_ruled``; 0 leaves the fall-off out.
    """
    slope, reach = cone[0], cone[1]
    ux, uy, vx, vy = to[6] * part, to[8] * part, to[7] * part, to[9] * part
    size = math.sqrt(abs(ux * vy - vx * uy))
    if size < LEAST_BOX * numbers[0]:
        size = LEAST_BOX * numbers[0]
        ux, uy, vx, vy = size, 0.0, 0.0, size
    origin_x = to[0] + to[6] * ex + to[7] * ey
    origin_y = to[1] + to[8] * ex + to[9] * ey
    slant_x, slant_y = slants[0] + slants[2] * ex, slants[1] + slants[2] * ey
    x, y, other = 0.0, 0.0, 2.0
    if slope != 0.0 and ex * ex + ey * ey > max(0.0, reach - abs(slope)) ** 2:
        x, y, other = ex / slope, ey / slope, reach / abs(slope)
        distance = math.hypot(x, y)
        most = (1.0 + other) * (1.0 - 1e-9)
        if distance > most:
            x *= most / distance
            y *= most / distance
    low, high = lens_rows(x, y, other)
    light = 0.0
    total = 0.0
    for index in range(count):
        at = 0.5 * (low + high) + 0.5 * (high - low) * rows[0, index]
        left, right = lens_chord(x, y, other, at)
        weight = rows[1, index] * max(right - left, 1e-300)
        steep = slant_y + slants[3] * at
        for step in range(count):
            along = 0.5 * (left + right) + 0.5 * (right - left) * chord[0, step]
            tilted = slant_x + slants[3] * along
            x_there, y_there = (
                origin_x + to[2] * along + to[3] * at,
                origin_y + to[4] * along + to[5] * at,
            )
            seen = mean_over(x_there, y_there, ux, uy, vx, vy, kind, numbers, table, law, sums)
            counted = 0.5 * weight * chord[1, step] / (1.0 + tilted * tilted + steep * steep) ** 2
            light += counted * seen
            total += counted
    return light / total * seen_weight(ex, ey, slope, reach, slants)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def full_share(ex: float, ey: float, cone: Array) -> float:
    """Share of the full cone that passes both apertures at the point (ex, ey) mm."""
    slope = abs(cone[0])
    distance = math.hypot(ex, ey)
    if slope == 0.0 or distance <= cone[1] - slope:
        return 1.0
    return two_disc_area(1.0, cone[1] / slope, distance / slope) / math.pi


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _aside(to: Array, ex: float, ey: float) -> float:
    """How far from the target's origin the middle ray of a sensor point ends, mm."""
    return math.hypot(to[0] + to[6] * ex + to[7] * ey, to[1] + to[8] * ex + to[9] * ey)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def dot_light(dx: float, dy: float, entry: int, seen: DotSeen, squares: Array) -> float:
    """Share of the full cone that a pixel gets from a dot through one entry.

    Args:
        dx: the pixel's middle from the micro-image's centre, mm.
        dy: the same along y.
        entry: the entry.
        seen: the dot.
        squares: scratch, shape (MOST_SQUARES, 3).
    """
    lenses = seen.lenses
    kind, cone, to, width = (
        lenses.kinds[entry],
        lenses.cones[entry],
        lenses.maps[entry],
        lenses.width,
    )
    parts, count, rim = int(lenses.parts[kind]), int(seen.counts[kind]), lenses.rims[kind]
    radius, steep, distance = seen.numbers[0], rim[0] < 0.0, math.hypot(dx, dy)
    across = math.hypot(
        abs(to[6]) + abs(to[7]), abs(to[8]) + abs(to[9])
    )  # a square's diagonal on the target, over its side
    blurred = (
        math.sqrt(to[2] * to[2] + to[3] * to[3] + to[4] * to[4] + to[5] * to[5])
        + LEAST_BOX * radius
    )
    aside = _aside(to, dx, dy)
    if (
        distance > cone[1] + abs(cone[0]) + 0.75 * width
        or aside > radius + blurred + across * width
    ):
        return 0.0
    full = distance < cone[1] - abs(cone[0]) - 0.75 * width
    if count == 0 and width > 0.0 and (full or not steep):
        return spot_light(
            dx,
            dy,
            width,
            cone,
            to,
            radius,
            full,
            parts,
            seen.allowed,
            lenses.slants[entry],
            seen.weighing,
            squares,
        )
    divide = min(parts, MOST_DIVIDED)
    if full and count > 0:
        divide = 1 if aside < radius - blurred - 0.5 * across * width else int(seen.divided[kind])
    side = width / divide
    light = 0.0
    for j in range(divide):
        y = dy + ((j + 0.5) / divide - 0.5) * width
        for i in range(divide):
            x = dx + ((i + 0.5) / divide - 0.5) * width
            clips = not full and (steep or count > 0)
            share, look = (
                part_share(x, y, side, cone[0], cone[1], rim, lenses.nodes) if clips else (1.0, 1.0)
            )
            if share <= 0.0:
                continue
            at_x, at_y = look * x, look * y
            if count == 0:
                spot = weighted_share(
                    at_x, at_y, cone, to, radius, lenses.slants[entry], seen.weighing
                )
                light += share * spot / (max(full_share(at_x, at_y, cone), 1e-12) if steep else 1.0)
            else:
                within = _aside(to, at_x, at_y) < radius - blurred - 0.5 * across * side
                light += share * (
                    seen_weight(at_x, at_y, cone[0], cone[1], lenses.slants[entry])
                    if within
                    else sampled_mean(
                        at_x,
                        at_y,
                        cone,
                        to,
                        seen.strips[kind],
                        seen.chords[kind],
                        count,
                        side,
                        DISC,
                        seen.numbers,
                        seen.table,
                        seen.law,
                        seen.sums,
                        lenses.slants[entry],
                    )
                )
    return light / (divide * divide)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_dots(image: Array, rows: tuple[int, int], windows: Whole, seen: DotSeen) -> None:
    """Add the light of every entry (a microlens, or a dot seen through one) to a band of rows;
    windows as in ``add_ruled``.
    """
    lenses, squares = seen.lenses, np.empty((MOST_SQUARES, 3))
    for entry in range(windows.shape[0]):
        for row in range(max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])):
            dy = lenses.ys[row] - lenses.centres[entry, 1]
            for column in range(windows[entry, 0], windows[entry, 1]):
                if lenses.wanted.size > 0 and not lenses.wanted[row, column]:
                    continue
                dx = lenses.xs[column] - lenses.centres[entry, 0]
                image[row, column] += lenses.levels[entry] * dot_light(dx, dy, entry, seen, squares)

"""Fall-off over the pupil where it changes the diffraction pattern's shape: the pupil weighted by
polynomials of its places.

At a sensor point the weight of the pupil's rays, cos^4 of their slopes, is nearly a polynomial of
second degree in the pupil's places t along the point's direction from the micro-image's centre and
u across it. So the image is the sum of those through pupils weighted by Zernike's polynomials 1, t,
2 (t^2 + u^2) - 1, t^2 - u^2, u and t u, times the weight's coefficients. A wave counts by the root
of its weight: two that meet count by the mean of the polynomial at either, but for half the square
of what it changes between them.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.falloff import slant_rows
from flflab.image.diffraction.kinds import AIRY, Kind
from flflab.image.geometry.setup import Setup

Array = npt.NDArray[np.float64]

WEIGHTS, ODD = 6, 4  # polynomials, and from which on they change sign where u does
SHARE = 0.25  # of the tolerance: a fall-off that leaves less is told by its mean
LINEAR, SQUARE, WITHIN = (
    0.055,
    0.035,
    0.125,
)  # of white, that a change of the weight leaves: see below
DIRECTIONS = 8


def _fit() -> tuple[Array, Array]:
    """Places in the pupil by Gauss's rule, which count alike, (n, 2), and what a weight's value
    there adds to its coefficients, (n, 6).
    """
    radius = np.sqrt(0.5 + np.array([-0.5, 0.5]) / math.sqrt(3))
    angle = np.arange(6) * np.pi / 3 + np.arange(2)[:, None] * np.pi / 6
    t, u = (radius[:, None] * np.cos(angle)).ravel(), (radius[:, None] * np.sin(angle)).ravel()
    polynomials = np.stack(
        [np.ones_like(t), t, 2 * (t**2 + u**2) - 1, t**2 - u**2, u, t * u]
    )  # orthogonal over these places too
    return np.stack([t, u], axis=1), np.ascontiguousarray(
        (polynomials / np.sum(polynomials**2, axis=1, keepdims=True)).T
    )


PLACES, FIT = _fit()


@dataclass(frozen=True)
class Shading:
    """How the weight of a kind's pupil is told.

    Attributes:
        fit: what its value at each of ``PLACES`` adds to its coefficients, shape (n, 6); (0, 6)
            where the mean of the weight is enough.
        most: the largest coefficients in size, (6,); they say how exact the images are that they
            multiply.
    """

    fit: Array
    most: tuple[float, ...]


MEAN = Shading(np.zeros((0, WEIGHTS)), (1.0,))


def find_shading(setup: Setup, kind: Kind, steep: bool) -> Shading:
    """The mean of the weight where that leaves little of white; always on a rim too steep for terms
    of its own.
    """
    if steep or not setup.falloff:
        return MEAN
    most, bends = weight_changes(setup, kind)
    left = float(setup.pupils.level[kind.entries].max()) * setup.overlap * bends
    return (
        MEAN
        if left <= SHARE * setup.tolerance
        else Shading(FIT, tuple(float(size) for size in most))
    )


def weight_changes(setup: Setup, kind: Kind) -> tuple[Array, float]:
    """The largest coefficients of a kind's weight (6,), and what its mean and the middle it gives
    the pupil leave of an edge.

    Of an edge in a blur of a pixel or more, a weight that changes by c from the middle of the pupil
    to its rim leaves 0.053 c; less in slighter blurs. One that bends by c leaves 0.033 c, of
    patterns narrower than a pixel less.
    """
    rows, outside = slant_rows(setup, kind), setup.pupils.outside[kind.entries] / setup.sensor.pixel
    steepest = int(np.argmax(_steepest(rows, outside) * np.abs(rows[:, 3])))
    found = np.zeros((2 * DIRECTIONS, WEIGHTS))
    for index in range(2 * DIRECTIONS):
        radius, angle = outside[steepest] * (index // DIRECTIONS), 2 * math.pi * index / DIRECTIONS
        found[index] *= weigh_pupil(
            radius * math.cos(angle), radius * math.sin(angle), rows[steepest], FIT, found[index]
        )
    linear = LINEAR * float(np.hypot(found[:, 1], found[:, 4]).max()) * min(1.0, abs(kind.blur))
    bends = np.maximum(2 * np.abs(found[:, 2]) + np.abs(found[:, 3]), np.abs(found[:, 5]))
    squares = SQUARE * float(bends.max()) * min(1.0, math.hypot(kind.blur, AIRY / kind.cutoff))
    return np.abs(found).max(axis=0), linear + squares


def within_pixel(setup: Setup, kind: Kind) -> float:
    """What the fall-off in the middle of a pixel leaves of white: light that an edge cuts lies up
    to an eighth of its side from there.
    """
    if not setup.falloff:
        return 0.0
    rows, outside = slant_rows(setup, kind), setup.pupils.outside[kind.entries] / setup.sensor.pixel
    steepest = _steepest(rows, outside)
    change = (
        4
        * steepest
        / (1 + steepest**2) ** 3
        * np.abs(rows[:, 2])
        * setup.pixel_width
        / setup.sensor.pixel
    )
    return WITHIN * setup.overlap * float(np.max(setup.pupils.level[kind.entries] * change))


def _steepest(rows: Array, outside: Array) -> Array:
    """The steepest slope of each entry's rays at the sensor; see ``slant_rows``."""
    return np.hypot(rows[:, 0], rows[:, 1]) + np.abs(rows[:, 2]) * outside + np.abs(rows[:, 3])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weigh_pupil(x: float, y: float, slant: Array, fit: Array, told: Array) -> float:
    """The mean weight at a sensor point (x, y), pixels from the micro-image's centre, and its
    coefficients over that into ``told``.

    ``slant`` is one of ``slant_rows``, ``fit`` that of ``Shading``.
    """
    distance = math.sqrt(x * x + y * y)
    cos, sin = (x / distance, y / distance) if distance > 1e-9 else (1.0, 0.0)
    slope_x, slope_y = slant[0] + slant[2] * x, slant[1] + slant[2] * y
    along, aside = slope_x * cos + slope_y * sin, slope_y * cos - slope_x * sin
    for index in range(WEIGHTS):
        told[index] = 0.0
    for place in range(fit.shape[0]):
        ahead, beside = along + slant[3] * PLACES[place, 0], aside + slant[3] * PLACES[place, 1]
        root = 1.0 / (1.0 + ahead * ahead + beside * beside)
        for index in range(WEIGHTS):
            told[index] += fit[place, index] * (root * root)
    mean = told[0]
    for index in range(WEIGHTS):
        told[index] /= mean
    return mean

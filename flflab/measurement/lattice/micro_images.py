"""Each micro-image of a white picture by itself: place, light, radius, softness, slope of its
light, beside the one profile that all share.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import bsr_array
from scipy.sparse.linalg import gmres

from flflab.measurement.lattice.kernel import (
    GROUND,
    LIGHT,
    SLOPE_X,
    SLOPE_Y,
    SOFTER,
    VALUES,
    WIDER,
    X,
    Y,
    sum_up,
)
from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.pixels import Pixels, in_bands

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

BLOB, DISC = WIDER + 1, VALUES  # how many values are fitted: a blob's slope is no more than a shift
CLOSE, MOST_STEPS = 1e-2, 20  # what iterations leave of a step's equations; their number
WIDEST, SOFTEST = 0.6, 1.2  # of the radius; logarithm of the softness
LONGEST_SLOPE = 0.05  # by which a slope may change at once


@dataclass(frozen=True)
class Sums:
    """What a pass over the pixels of micro-images adds up to, by ``sum_up``; what is expected of
    them is counted in ``normal``, and beside ``right`` it is ``before``.
    """

    normal: Array
    cross: Array
    right: Array
    before: Array
    fit: Array


def expected(
    values: Array, profile: Profile, pitch: float, ground: float | None
) -> tuple[Array, Array]:
    """What is expected of micro-images before they are looked at, means and standard deviations:
    loosely, that they are as the values say and as wide and soft as the profile, and on this ground
    where it is nowhere seen by itself.
    """
    mean = values.copy()
    mean[:, WIDER:] = 0.0
    light = np.abs(values[:, LIGHT])
    light = np.maximum(light, max(0.05 * float(np.median(light)), 1e-9))
    spread = np.ones_like(values)
    spread[:, [X, Y]] = 0.1 * pitch
    spread[:, LIGHT] = 0.5 * light
    spread[:, GROUND] = 0.2 * light
    spread[:, WIDER] = 0.15 * profile.radius
    spread[:, [SOFTER, SLOPE_X, SLOPE_Y]] = 0.3
    if ground is not None:
        mean[:, GROUND] = ground
        spread[:, GROUND] /= 100
    return mean, spread


@dataclass(frozen=True)
class Model:
    """What micro-images are fitted with.

    Attributes:
        profile: that all share.
        neighbours: of all, -1 where there is none, shape (n, most).
        mean: what is expected of all, shape (n, VALUES).
        spread: standard deviations of that, shape (n, VALUES).
        size: how many of the values are fitted, ``BLOB`` or ``DISC``.
    """

    profile: Profile
    neighbours: Whole
    mean: Array
    spread: Array
    size: int


def extents_of(values: Array, profile: Profile) -> Array:
    """exp(-softer), and the square of the distance at which the light ends, shape (n, 2)."""
    shrink = np.exp(-values[:, SOFTER])
    reach = profile.radius + values[:, WIDER] + (profile.end - profile.radius) / shrink
    return np.stack([shrink, np.maximum(reach, 1.0) ** 2], axis=1)


def sums(pixels: Pixels, values: Array, members: Whole, model: Model, sectors: int = 1) -> Sums:
    """One pass over the pixels of the members, what is expected of them counted in."""
    profile, size = model.profile, model.size
    shape = profile.table, profile.radius, profile.step
    extents, numbers = extents_of(values, profile), pixels.numbers
    parts = in_bands(
        lambda band: sum_up(
            pixels.picture,
            band,
            values,
            extents,
            model.neighbours,
            shape,
            pixels.every,
            numbers,
            sectors,
        ),
        members,
    )
    normal, cross, right, fit = (np.concatenate(part) for part in zip(*parts, strict=True))
    precision = 1 / model.spread[members, :size] ** 2
    normal = normal[:, :size, :size] + precision[:, :, None] * np.eye(size)
    before = precision * (model.mean - values)[members, :size]
    return Sums(normal, cross[:, :, :size, :size], right[:, :, :size], before, fit)


def fit(pixels: Pixels, start: Array, members: Whole, model: Model, rounds: int) -> Array:
    """Values of micro-images after so many steps of all together.

    Args:
        pixels: to be fitted.
        start: values of all, shape (n, VALUES).
        members: which are fitted.
        model: to be fitted with.
        rounds: number of steps.
    """
    values, size, spread = start.copy(), model.size, model.spread[members]
    longest = 0.5 * spread[:, :size]
    longest[:, SLOPE_X:] = np.maximum(longest[:, SLOPE_X:], LONGEST_SLOPE)
    widest = WIDEST * model.profile.radius
    for _ in range(rounds):
        step = _step(sums(pixels, values, members, model), members, model.neighbours)
        limit = np.min(longest / np.maximum(np.abs(step), 1e-300), axis=1, initial=1.0)
        values[members, :size] += np.where(np.isfinite(step), step * limit[:, None], 0.0)
        values[:, WIDER] = np.clip(values[:, WIDER], -widest, widest)
        values[:, SOFTER] = np.clip(values[:, SOFTER], -SOFTEST, SOFTEST)
    return values


def _step(found: Sums, members: Whole, neighbours: Whole) -> Array:
    """What all members move by together, shape (n, size); each by itself is the preconditioner."""
    inverse, right = inverses(found.normal), found.right.sum(axis=1) + found.before
    if not found.cross.any():
        return np.einsum("nab,nb->na", inverse, right)
    beside = _beside(members, neighbours)
    blocks = np.concatenate([found.normal[:, None], found.cross], axis=1)
    columns = np.column_stack([np.arange(len(members)), beside])
    kept = columns >= 0
    starts = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    count = right.size
    system = bsr_array((blocks[kept], columns[kept], starts), shape=(count, count))
    rows = np.arange(len(members) + 1)
    alone = bsr_array((inverse, rows[:-1], rows), shape=(count, count))
    step, _ = gmres(system, right.ravel(), rtol=CLOSE, restart=MOST_STEPS, maxiter=1, M=alone)
    return np.asarray(step, dtype=np.float64).reshape(right.shape)


def _beside(members: Whole, neighbours: Whole) -> Whole:
    """Which of the members lie beside each of them, -1 where none does, shape (n, most)."""
    place = np.full(max(int(neighbours.max()), int(members.max())) + 1, -1)
    place[members] = np.arange(len(members))
    return np.where(neighbours[members] >= 0, place[neighbours[members]], -1)


def covariances(found: Sums, members: Whole, neighbours: Whole) -> Array:
    """Covariances of the values at unit noise: those of each by itself, and to second order what
    its neighbours' values add where their light overlaps; shape (n, size, size).
    """
    alone = inverses(found.normal)
    if not found.cross.any():
        return alone
    beside = _beside(members, neighbours)
    shared = np.where((beside >= 0)[:, :, None, None], found.cross, 0.0)
    moved = np.einsum("nmab,nmbc,nmdc->nad", shared, alone[beside], shared)
    return np.asarray(alone + alone @ moved @ alone, dtype=np.float64)


def inverses(normal: Array) -> Array:
    """Inverses, each matrix scaled to a diagonal of one."""
    scale = np.sqrt(np.einsum("nkk->nk", normal))
    inverse = np.linalg.inv(normal / (scale[:, :, None] * scale[:, None, :]))
    return inverse / (scale[:, :, None] * scale[:, None, :])

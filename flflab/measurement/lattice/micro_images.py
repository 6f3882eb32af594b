"""Each micro-image of a white picture by itself: place, light, radius, softness, slope of its
light, beside the one profile that all share.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from flflab.measurement.lattice.kernel import (
    GROUND,
    LIGHT,
    OUTLIER,
    SLOPE_X,
    SLOPE_Y,
    SOFTER,
    VALUES,
    WIDER,
    X,
    Y,
    sum_up,
    with_neighbours,
)
from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.pixels import Pixels, in_bands

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

BLOB, DISC = WIDER + 1, VALUES  # how many values are fitted: a blob's slope is no more than a shift
AT_ONCE = 1024  # systems of neighbours in memory
DAMPED = 1e-3  # first damping of a step, relative
WIDEST, SOFTEST = 0.6, 1.2  # of the radius; logarithm of the softness
LONGEST_SLOPE = 0.05  # by which a slope may change at once


@dataclass(frozen=True)
class Sums:
    """What a pass over the pixels of micro-images adds up to, by ``sum_up``."""

    normal: Array
    cross: Array
    right: Array
    fit: Array


@dataclass(frozen=True)
class Expected:
    """What is expected of micro-images before they are looked at: means and standard deviations.

    Attributes:
        mean: shape (n, VALUES).
        spread: shape (n, VALUES).
    """

    mean: Array
    spread: Array


def expected(values: Array, profile: Profile, pitch: float) -> Expected:
    """Loosely, that they are as the values say and as wide and soft as the profile."""
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
    return Expected(mean, spread)


def with_ground(prior: Expected, ground: float) -> Expected:
    """The same where the ground is nowhere seen by itself."""
    mean, spread = prior.mean.copy(), prior.spread.copy()
    mean[:, GROUND] = ground
    spread[:, GROUND] /= 100
    return Expected(mean, spread)


@dataclass(frozen=True)
class Model:
    """What micro-images are fitted with.

    Attributes:
        profile: that all share.
        neighbours: of all, -1 where there is none, shape (n, most).
        prior: what is expected of all.
        size: how many of the values are fitted, ``BLOB`` or ``DISC``.
        joint: whether neighbours move along, as where they overlap.
    """

    profile: Profile
    neighbours: Whole
    prior: Expected
    size: int
    joint: bool


def extents_of(values: Array, profile: Profile) -> Array:
    """exp(-softer), and the square of the distance at which the light ends, shape (n, 2)."""
    shrink = np.exp(-values[:, SOFTER])
    reach = profile.radius + values[:, WIDER] + (profile.end - profile.radius) / shrink
    return np.stack([shrink, np.maximum(reach, 1.0) ** 2], axis=1)


def sums(
    pixels: Pixels,
    values: Array,
    members: Whole,
    model: Model,
    sectors: int = 1,
) -> Sums:
    """One pass over the pixels of the members."""
    every = np.full(len(values), pixels.every, dtype=np.int64)
    profile = model.profile
    shape = profile.table, profile.radius, profile.step
    extents = extents_of(values, profile)
    numbers = pixels.numbers
    parts = in_bands(
        lambda band: sum_up(
            pixels.picture,
            band,
            values,
            extents,
            model.neighbours,
            shape,
            every,
            numbers,
            model.size,
            model.joint,
            sectors,
        ),
        members,
    )
    return Sums(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def fit(
    pixels: Pixels,
    start: Array,
    members: Whole,
    model: Model,
    rounds: int,
) -> Array:
    """Values of micro-images after so many damped steps each; a step that does not help is taken
    back.

    Args:
        pixels: to be fitted.
        start: values of all, shape (n, VALUES).
        members: which are fitted.
        model: to be fitted with.
        rounds: number of steps.
    """
    values, prior, size, neighbours = start.copy(), model.prior, model.size, model.neighbours
    touching = bool((neighbours[members] >= 0).any())
    groups = _apart(members, neighbours) if touching and not model.joint else [members]
    states = [_State.begun(values[group], size) for group in groups]
    for _ in range(rounds):
        for group, state in zip(groups, states, strict=True):
            found = sums(pixels, values, group, model)
            off = ((prior.mean - values) / prior.spread)[group][:, :size]
            cost = found.fit[:, 0] + OUTLIER * found.fit[:, 2] + np.sum(off**2, axis=1)
            normal, right = with_prior(found, prior, values, group, size)
            state.take(cost, values[group], normal, right, touching)
            if model.joint:
                step = solved_together(group, neighbours, found, normal, right)[0]
            else:
                step = _steps(state.normal, state.right, state.damping)
            longest = 0.5 * prior.spread[group][:, :size]
            longest[:, SLOPE_X:] = np.maximum(longest[:, SLOPE_X:], LONGEST_SLOPE)
            limit = np.min(longest / np.maximum(np.abs(step), 1e-300), axis=1, initial=1.0)
            trial = state.values.copy()
            trial[:, :size] += step * limit[:, None]
            _bound(trial, model.profile)
            fine = np.all(np.isfinite(trial), axis=1, keepdims=True)
            values[group] = np.where(fine, trial, state.values)
    return values


def _bound(values: Array, profile: Profile) -> None:
    """Keep widths and softness where they are a micro-image's, in place."""
    widest = WIDEST * profile.radius
    values[:, WIDER] = np.clip(values[:, WIDER], -widest, widest)
    values[:, SOFTER] = np.clip(values[:, SOFTER], -SOFTEST, SOFTEST)


@dataclass
class _State:
    """The best values so far of some micro-images, and what leads on from there."""

    values: Array
    cost: Array
    normal: Array
    right: Array
    damping: Array

    @classmethod
    def begun(cls, values: Array, size: int) -> "_State":
        count = len(values)
        system = np.tile(np.eye(size), (count, 1, 1))
        begun = np.full(count, np.inf), system, np.zeros((count, size)), np.full(count, DAMPED)
        return cls(values.copy(), *begun)

    def take(self, cost: Array, values: Array, normal: Array, right: Array, touching: bool) -> None:
        """Keep what is better; beside neighbours that moved too costs do not compare."""
        better = (cost <= self.cost * (1 + 1e-9)) | touching
        self.cost[better], self.values[better] = cost[better], values[better]
        self.normal[better], self.right[better] = normal[better], right[better]
        if not touching:
            changed = np.where(better, self.damping / 10, self.damping * 20)
            self.damping = np.clip(changed, 1e-9, 1e6)


def _apart(members: Whole, neighbours: Whole) -> list[Whole]:
    """The members in groups in which no two are neighbours, by the smallest free number."""
    colour = np.full(len(neighbours), -1, dtype=np.int64)
    for member in members:
        near = neighbours[member]
        taken = set(colour[near[near >= 0]].tolist())
        colour[member] = next(k for k in range(len(taken) + 1) if k not in taken)
    return [members[colour[members] == k] for k in range(int(colour[members].max()) + 1)]


def with_prior(
    found: Sums, prior: Expected, values: Array, members: Whole, size: int
) -> tuple[Array, Array]:
    """Normal matrices and right sides, what is expected counted in."""
    precision = 1 / prior.spread[members][:, :size] ** 2
    normal = found.normal + precision[:, :, None] * np.eye(size)
    right = found.right.sum(axis=1) + precision * (prior.mean - values)[members][:, :size]
    return normal, right


def _steps(system: Array, side: Array, damping: Array) -> Array:
    """Damped steps, each system scaled to a diagonal of one."""
    scale = np.sqrt(np.einsum("nkk->nk", system))
    scaled = system / (scale[:, :, None] * scale[:, None, :])
    scaled += damping[:, None, None] * np.eye(system.shape[1])
    return np.linalg.solve(scaled, (side / scale)[:, :, None])[:, :, 0] / scale


def solved_together(
    members: Whole, neighbours: Whole, found: Sums, normal: Array, right: Array
) -> tuple[Array, Array]:
    """Steps and inverses of each, its neighbours free beside it and theirs held; neighbours that
    are no members are held too.
    """
    place = np.full(int(max(neighbours.max(initial=0), members.max(initial=0))) + 1, -1)
    place[members] = np.arange(len(members))
    around = np.where(neighbours[members] >= 0, place[neighbours[members]], -1)
    steps, inverted = np.zeros(right.shape), np.zeros(normal.shape)
    size = right.shape[1]
    for part in np.array_split(np.arange(len(members)), -(-len(members) // AT_ONCE)):
        systems, sides = with_neighbours(part, around, normal, found.cross, right)
        scale = np.sqrt(np.einsum("nkk->nk", systems))
        scaled = systems / (scale[:, :, None] * scale[:, None, :])
        own = np.broadcast_to(np.eye(scaled.shape[1])[:, :size], (*scaled.shape[:2], size))
        with threadpool_limits(1, "blas"):  # threads wait for each other longer than they work
            inverse = np.linalg.solve(scaled, own).transpose(0, 2, 1)
        steps[part] = np.einsum("nak,nk->na", inverse, sides / scale) / scale[:, :size]
        inverted[part] = inverse[:, :, :size] / (scale[:, :size, None] * scale[:, None, :size])
    # systems cut off at the border of the picture may be none: then each is taken by itself
    alone = inverses(normal)
    sure = np.einsum("nkk->nk", inverted) >= 0.99 * np.einsum("nkk->nk", alone)
    single = ~(np.isfinite(steps).all(axis=1) & sure.all(axis=1))
    inverted[single] = alone[single]
    steps[single] = np.einsum("nab,nb->na", alone[single], right[single])
    return steps, inverted


def inverses(normal: Array) -> Array:
    """Inverses, each matrix scaled to a diagonal of one."""
    scale = np.sqrt(np.einsum("nkk->nk", normal))
    inverse = np.linalg.inv(normal / (scale[:, :, None] * scale[:, None, :]))
    return inverse / (scale[:, :, None] * scale[:, None, :])

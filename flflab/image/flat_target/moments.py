"""Moments of an exposure in which the targets move: the mean of the pictures at them is that of the
moving ones.

All moments, sorted by how far the target is then, are dealt out in equal shares, and the middle of
each share stands for it. So drift and vibration along one line take as many moments as one of the
two does, not the product. Middles are less spread than what they stand for; drawn apart until they
are spread alike, they leave a fourth of what they would where edges are blurred.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.motion import Motion
from flflab.image.geometry.setup import Setup

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# phases of drift and of vibration for each share they are dealt out in, and most of both together
PHASES, MOST_MOMENTS = (
    8,
    1 << 20,
)
# entries of all the moments that are formed at once: what is the same for all of them is then made
# once
TOGETHER = 1 << 15
ALONG = 0.1  # of the tolerance, for the places along each axis
# most by which middles are drawn apart; two of a vibration's need 1.11, two of a drift's 1.16
APART = 1.2
AXES = np.eye(2)  # of the target


def at_moments(setup: Setup) -> Iterator[Setup]:
    """Setups of a standing target at some moments each, with their share of the light: the sum of
    their pictures is the moving one's.
    """
    places, shares = places_of(setup)
    number = len(setup.origin)
    together = max(TOGETHER // max(number, 1), 1)
    for first in range(0, len(places), together):
        some = slice(first, first + together)
        count = len(places[some])
        parts = setup.of(np.tile(np.arange(number), count), np.tile(setup.window, (count, 1)))
        origin = parts.origin + np.einsum(
            "nij,nj->ni", parts.by_motion, np.repeat(places[some], number, axis=0)
        )
        level = parts.pupils.level * np.repeat(shares[some], number)
        yield replace(parts, origin=origin, pupils=replace(parts.pupils, level=level), motion=None)


def places_of(setup: Setup) -> tuple[Array, Array]:
    """Where the target is at some moments, mm from its middle place, shape (M, 2), and their shares
    of the exposure, shape (M,).

    Along the line on which it is spread most first, and across it within each share then.
    """
    motion = setup.motion or Motion()
    axes, wanted = _spread(motion)
    whole, across = (int(counts_along(setup, _toward(setup, axis)).max(initial=1)) for axis in axes)
    ways = axes @ np.array([motion.drift, motion.vibration]).T @ _moments(setup, whole, across)
    parts = [
        part
        for share in _dealt(ways, ways[0], whole)
        for part in _dealt(share, share[1], across)
        if part.size
    ]
    middles = np.array([part.mean(axis=1) for part in parts]).T
    return _drawn_apart(middles, wanted).T @ axes, np.array(
        [part.shape[1] for part in parts]
    ) / ways.shape[1]


def at_heights(setup: Setup) -> Iterator[Setup]:
    """Setups of a target that moves along its x' only, each with its share of the light: the sum of
    their pictures is the moving one's.
    """
    drift, swing, smear, _ = _smear_along(setup, AXES[1])
    count = moment_count(setup, 1)
    moments = _moments(setup, count, moment_count(setup, 0))
    shares = _dealt(moments, _way_of_most(moments, drift, swing, smear), count)
    middles = np.stack([share.mean(axis=1) for share in shares], axis=1)
    heights = _ways(middles, moments, drift, swing)
    for share, height in zip(shares, heights.T, strict=True):
        level = setup.pupils.level * (share.shape[1] / moments.shape[1])
        yield replace(
            setup,
            origin=setup.origin + height[:, None] * AXES[1],
            pupils=replace(setup.pupils, level=level),
            moments=share,
        )


def ways_along(setup: Setup) -> Array:
    """How far rays end along the target's x' from where they would, mm, at some moments of equal
    shares; shape (N, moments).

    The means of the drift's and of the sine's parts of a share are kept: where an entry mixes both
    otherwise than the one that moves most, its places are right to first order.
    """
    if setup.motion is None or not len(setup.origin):
        return np.zeros((len(setup.origin), 1))
    whole = moment_count(setup, 0)
    drift, swing, smear, _ = _smear_along(setup, AXES[0])
    moments, most = _moments(setup, whole, 1), int(np.argmax(smear))
    way = _way_of_most(moments, drift, swing, smear)
    count = (
        max(
            math.ceil(
                whole * math.sqrt(float(np.ptp(way)) / (abs(drift[most]) + 2 * abs(swing[most])))
            ),
            1,
        )
        if whole > 1
        else 1
    )
    # Shares as large as each other to a part of a moment: they count alike.
    ends = np.linspace(0.0, moments.shape[1], count + 1)
    sums = np.pad(np.cumsum(moments[:, np.argsort(way, kind="stable")], axis=1), ((0, 0), (1, 0)))
    middles = np.stack(
        [np.diff(np.interp(ends, np.arange(sums.shape[1]), each)) for each in sums]
    ) * (count / moments.shape[1])
    return _ways(middles, moments, drift, swing)


def moment_count(setup: Setup, axis: int) -> int:
    """How many moments a movement along one axis of the target needs for all entries of a setup;
    see ``counts_along``.
    """
    return int(counts_along(setup, AXES[axis]).max(initial=1))


def counts_along(setup: Setup, toward: Array) -> Whole:
    """How many moments a movement along a line on the target needs for each entry, shape (N,); see
    ``_smear_along``.

    Places dealt out among n leave up to 0.125 S / n^2 of white: S is the way from end to end over
    the width to which pixel and blur smooth an edge, and that is left where its slope breaks. The
    lesser of the two rounds the break off: over q of the width, the slope changes by up to 4 / (pi
    q) for each side of a bar, and 0.04 S^2 / (q n^2) are left; rims that cut pixel and pupil
    included.
    """
    smear, other = _smear_along(setup, toward)[2:]
    left = np.minimum(
        0.125 * smear,
        0.04 * np.divide(smear**2, other, out=np.full_like(smear, np.inf), where=other > 0),
    )
    return np.maximum(np.ceil(np.sqrt(left / (ALONG * setup.tolerance))), 1).astype(np.int64)


def alike(setup: Setup, axis: int) -> Iterator[Setup]:
    """The parts of a setup whose entries need as many moments of a movement along an axis as each
    other.
    """
    counts = counts_along(setup, AXES[axis])
    for count in np.unique(counts):
        entries = np.flatnonzero(counts == count)
        yield setup.of(entries, setup.window[entries])


def _spread(motion: Motion) -> tuple[Array, Array]:
    """Unit vectors along which a motion is spread most and least, the rows of (2, 2), and its
    variances along them, mm^2.
    """
    drift, vibration = np.array(motion.drift), np.array(motion.vibration)
    variances, vectors = np.linalg.eigh(
        np.outer(drift, drift) / 12 + np.outer(vibration, vibration) / 2
    )
    return vectors.T[::-1], np.maximum(variances[::-1], 0.0)


def _toward(setup: Setup, axis: Array) -> Array:
    """Unit vectors on the target along which it moves when it moves along an axis of the bench,
    shape (N, 2).
    """
    way = setup.by_motion @ axis
    return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)


def _smear_along(setup: Setup, toward: Array) -> tuple[Array, Array, Array, Array]:
    """Drift and amplitude along unit vectors on the target, mm; over how many widths of a smoothed
    edge they carry it; all of shape (N,).

    The width is that to which the greater of pixel and blur smooths it; the last is how wide the
    lesser is, in such widths. The vectors are of shape (2,) or (N, 2).
    """
    motion = setup.motion or Motion()
    along = np.broadcast_to(toward, setup.origin.shape)[:, None]
    drift, swing = (
        (along @ setup.by_motion @ np.array(way))[:, 0] for way in (motion.drift, motion.vibration)
    )
    pixel, pupil = (
        np.linalg.norm((along @ part)[:, 0], axis=1)
        for part in (setup.by_sensor * setup.sensor.pixel, setup.by_pupil)
    )
    width, way = np.maximum(pixel, np.pi / 2 * pupil), np.abs(drift) + 2 * np.abs(swing)
    smear, other = (
        np.divide(part, width, out=np.zeros_like(width), where=width > 0)
        for part in (way, np.minimum(pixel, np.pi / 2 * pupil))
    )
    return drift, swing, smear, other


def _moments(setup: Setup, count: int, other: int) -> Array:
    """The setup's moments, or enough of the whole exposure to be dealt out in so many shares, and
    each of these in so many others.
    """
    if setup.moments is not None:
        return setup.moments
    motion = setup.motion or Motion()
    moves = [any(way) for way in (motion.drift, motion.vibration)]
    number = (
        min(PHASES * max(count, other), math.isqrt(MOST_MOMENTS))
        if all(moves)
        else min(PHASES * count * other, MOST_MOMENTS)
    )
    even, turn = ((np.arange(n) + 0.5) / n for n in (number if moved else 1 for moved in moves))
    return np.stack(np.broadcast_arrays((even - 0.5)[:, None], np.cos(np.pi * turn))).reshape(2, -1)


def _dealt(moments: Array, ways: Array, count: int) -> list[Array]:
    """Moments (2, M), sorted by how far something is then, (M,), in so many shares."""
    return np.array_split(moments[:, np.argsort(ways, kind="stable")], count, axis=1)


def _way_of_most(moments: Array, drift: Array, swing: Array, smear: Array) -> Array:
    """How far the entry that moves most is at moments (2, M), mm."""
    most = int(np.argmax(smear))
    return drift[most] * moments[0] + swing[most] * moments[1]


def _ways(middles: Array, moments: Array, drift: Array, swing: Array) -> Array:
    """How far each entry is at the middles (2, n) of shares of moments (2, M), mm, shape (N, n);
    see ``_drawn_apart``.
    """
    mixed = np.stack([drift, swing], axis=1)
    return _drawn_apart(
        mixed @ middles, np.einsum("ni,ij,nj->n", mixed, np.cov(moments, ddof=0), mixed)
    )


def _drawn_apart(middles: Array, wanted: Array) -> Array:
    """Middles of shares (N, n) moved from their means, until their variances are those of what they
    stand for, (N,).
    """
    mean = middles.mean(axis=1, keepdims=True)
    found = np.mean((middles - mean) ** 2, axis=1)
    apart = np.sqrt(np.divide(wanted, found, out=np.ones_like(found), where=found > 0))
    return mean + np.minimum(apart, APART)[:, None] * (middles - mean)

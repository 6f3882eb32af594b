"""Moments of an exposure in which the targets move: the mean of the pictures at them is that of the moving ones."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.motion import Motion
from flflab.image.geometry.setup import Setup

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

PHASES, MOST_MOMENTS = 8, 1 << 20  # phases of drift and of vibration for each share they are dealt out in, and most of both together
TOGETHER = 1 << 15  # entries of all the moments that are formed at once: what is the same for all of them is then made once
ALONG = 0.1  # of the tolerance, for the places of bars and edges


def at_moments(setup: Setup) -> Iterator[Setup]:
    """Setups of a standing target at some moments each, with their share of the light, whose pictures have the moving one's as their sum.

    The places are midpoints of equal times of the even drift, and of equal phases of the sine (Gauss's rule for its density).
    """
    drift, vibration = moments_of(setup)
    even = (np.arange(drift) + 0.5) / drift - 0.5
    swing = np.cos(np.pi * (np.arange(vibration) + 0.5) / vibration) if vibration > 1 else np.zeros(1)
    motion, number = setup.motion or Motion(), len(setup.origin)
    ways = (even[:, None, None] * np.array(motion.drift) + swing[:, None] * np.array(motion.vibration)).reshape(-1, 2)
    together = max(TOGETHER // max(number, 1), 1)
    for first in range(0, len(ways), together):
        some = ways[first : first + together]
        parts = setup.of(np.tile(np.arange(number), len(some)), np.tile(setup.window, (len(some), 1)))
        origin = parts.origin + np.einsum("nij,nj->ni", parts.by_motion, np.repeat(some, number, axis=0))
        yield replace(parts, origin=origin, pupils=replace(parts.pupils, level=parts.pupils.level / len(ways)), motion=None)


def moments_of(setup: Setup) -> tuple[int, int]:
    """How many moments drift and vibration need for all entries of a setup, see ``at_moments``."""
    counts = moment_counts(setup.motion, smear_of(setup.by_motion, setup.by_sensor * setup.sensor.pixel, setup.by_pupil), setup.tolerance)
    drift, vibration = (int(count) for count in counts.max(axis=0, initial=1))
    return drift, vibration


def smear_of(by_motion: Array, by_pixel: Array, by_pupil: Array) -> Array:
    """Over how many widths of a smoothed edge a target moves on the sensor when it moves by 1 mm, for maps to it (N, 2, 2)."""
    way, pixel, pupil = (np.linalg.norm(part, axis=(1, 2)) for part in (by_motion, by_pixel, by_pupil))
    width = np.maximum(pixel, np.pi / 2 * pupil)
    return np.divide(way, width, out=np.zeros_like(way), where=width > 0)


def widths_moved(motion: Motion | None, smear: Array) -> Array:
    """Over how many widths of a smoothed edge drift and vibration carry a target from end to end, shape (N, 2); see ``smear_of``."""
    motion = motion or Motion()
    return smear[:, None] * np.array([math.hypot(*motion.drift), 2 * math.hypot(*motion.vibration)])


def moment_counts(motion: Motion | None, smear: Array, tolerance: Array | float) -> Whole:
    """How many moments drift and vibration need, shape (N, 2): n of them leave about S / (4 n^2) of white.

    Measured on edges and bars boxed by a pixel, which wander over S times the width to which pixel and blur smooth them (Gauss's rule
    for the drift is worse there); a half more for the sine.

    Args:
        motion: of the targets; None for none.
        smear: see ``smear_of``, shape (N,).
        tolerance: largest error asked for, of white, of each or of all.
    """
    if motion is None:
        return np.ones((len(smear), 2), dtype=np.int64)
    demand = widths_moved(motion, smear) * np.array([1.0, 1.6]) / np.reshape(tolerance, (-1, 1))
    return np.maximum(np.ceil(np.sqrt(demand)), 1).astype(np.int64)


def at_heights(setup: Setup) -> Iterator[Setup]:
    """Setups of a target that moves along its x' only, each with its share of the light, whose pictures have the moving one's as their sum.

    All moments, sorted by the target's y' then, are dealt out in equal shares; the middle of each stands for it.
    """
    drift, swing, smear, _ = _smear_along(setup, 1)
    count = moment_count(setup, 1)
    moments = _moments(setup, count, moment_count(setup, 0))
    for share in np.array_split(_sorted(moments, drift, swing, smear), count, axis=1):
        height = drift * share[0].mean() + swing * share[1].mean()
        level = setup.pupils.level * (share.shape[1] / moments.shape[1])
        yield replace(
            setup,
            origin=setup.origin + height[:, None] * np.array([0.0, 1.0]),
            pupils=replace(setup.pupils, level=level),
            moments=share,
        )


def ways_along(setup: Setup) -> Array:
    """How far rays end along the target's x' from where they would, mm, at some moments of equal shares; shape (N, moments).

    Drift and vibration along x' are one movement: all moments, sorted by the target's x' then, are dealt out in equal shares, and the
    middle of each stands for it. So it takes as many as one of the two does, not the product. The means of the drift's and of the sine's
    parts of a share are kept: where an entry mixes both otherwise, its places are right to first order.
    """
    if setup.motion is None or not len(setup.origin):
        return np.zeros((len(setup.origin), 1))
    whole = moment_count(setup, 0)
    drift, swing, smear, _ = _smear_along(setup, 0)
    moments, most = _moments(setup, whole, 1), int(np.argmax(smear))
    spread, way = float(np.ptp(drift[most] * moments[0] + swing[most] * moments[1])), abs(drift[most]) + 2 * abs(swing[most])
    count = max(math.ceil(whole * math.sqrt(spread / way)), 1) if whole > 1 else 1
    # Shares as large as each other to a part of a moment: they count alike.
    ends = np.linspace(0.0, moments.shape[1], count + 1)
    sums = np.pad(np.cumsum(_sorted(moments, drift, swing, smear), axis=1), ((0, 0), (1, 0)))
    even, sway = (np.diff(np.interp(ends, np.arange(sums.shape[1]), each)) * (count / moments.shape[1]) for each in sums)
    return drift[:, None] * even + swing[:, None] * sway


def moment_count(setup: Setup, axis: int) -> int:
    """How many moments a movement along one axis of the target needs for all entries of a setup; see ``counts_along``."""
    return int(counts_along(setup, axis).max(initial=1))


def counts_along(setup: Setup, axis: int) -> Whole:
    """How many moments a movement along one axis of the target needs for each entry, shape (N,).

    Places of bars or an edge dealt out among n leave up to 0.125 S / n^2 of white: S is the way from end to end over the width to which
    pixel and blur smooth an edge, and that is left where its slope breaks. The lesser of the two rounds the break off: over q of the
    width, the slope changes by up to 4 / (pi q) for each side of a bar, and 0.11 S^2 / (q n^2) are left.
    """
    smear, other = _smear_along(setup, axis)[2:]
    left = np.minimum(0.125 * smear, 0.11 * np.divide(smear**2, other, out=np.full_like(smear, np.inf), where=other > 0))
    return np.maximum(np.ceil(np.sqrt(left / (ALONG * setup.tolerance))), 1).astype(np.int64)


def alike(setup: Setup, axis: int) -> Iterator[Setup]:
    """The parts of a setup whose entries need as many moments of a movement along an axis as each other."""
    counts = counts_along(setup, axis)
    for count in np.unique(counts):
        entries = np.flatnonzero(counts == count)
        yield setup.of(entries, setup.window[entries])


def _smear_along(setup: Setup, axis: int) -> tuple[Array, Array, Array, Array]:
    """Drift and amplitude along an axis of the target, mm; over how many widths of a smoothed edge they carry it; all of shape (N,).

    The width is that to which the greater of pixel and blur smooths it; the last is how wide the lesser is, in such widths.
    """
    motion = setup.motion or Motion()
    drift, swing = setup.by_motion[:, axis] @ np.array(motion.drift), setup.by_motion[:, axis] @ np.array(motion.vibration)
    pixel, pupil = (np.linalg.norm(part[:, axis], axis=1) for part in (setup.by_sensor * setup.sensor.pixel, setup.by_pupil))
    width, way = np.maximum(pixel, np.pi / 2 * pupil), np.abs(drift) + 2 * np.abs(swing)
    smear, other = (
        np.divide(part, width, out=np.zeros_like(width), where=width > 0) for part in (way, np.minimum(pixel, np.pi / 2 * pupil))
    )
    return drift, swing, smear, other


def _moments(setup: Setup, count: int, other: int) -> Array:
    """The setup's moments, or enough of the whole exposure to be dealt out in so many shares, and each of these in so many others."""
    if setup.moments is not None:
        return setup.moments
    motion = setup.motion or Motion()
    moves = [any(way) for way in (motion.drift, motion.vibration)]
    number = min(PHASES * max(count, other), math.isqrt(MOST_MOMENTS)) if all(moves) else min(PHASES * count * other, MOST_MOMENTS)
    even, turn = ((np.arange(n) + 0.5) / n for n in (number if moved else 1 for moved in moves))
    return np.stack(np.broadcast_arrays((even - 0.5)[:, None], np.cos(np.pi * turn))).reshape(2, -1)


def _sorted(moments: Array, drift: Array, swing: Array, smear: Array) -> Array:
    """Moments (2, M) sorted by the way of the entry that moves most."""
    most = int(np.argmax(smear))
    return moments[:, np.argsort(drift[most] * moments[0] + swing[most] * moments[1], kind="stable")]

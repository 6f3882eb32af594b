"""Moments of an exposure in which the targets move: the mean of the pictures at them is that of the moving ones."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.image.effects.motion import Motion
from flflab.image.setup import Setup

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


def at_moments(setup: Setup) -> Iterator[Setup]:
    """Setups of a standing target, each with its share of the light, whose pictures have the moving one's as their sum.

    The places are midpoints of equal times of the even drift, and of equal phases of the sine (Gauss's rule for its density).
    """
    counts = moment_counts(setup.motion, smear_of(setup.by_motion, setup.by_sensor * setup.sensor.pixel, setup.by_pupil), setup.tolerance)
    drift, vibration = (int(count) for count in counts.max(axis=0, initial=1))
    even = (np.arange(drift) + 0.5) / drift - 0.5
    swing = np.cos(np.pi * (np.arange(vibration) + 0.5) / vibration) if vibration > 1 else np.zeros(1)
    level = setup.pupils.level / (drift * vibration)
    motion = setup.motion or Motion()
    for at in even:
        for sway in swing:
            place = at * np.array(motion.drift) + sway * np.array(motion.vibration)
            yield replace(setup, origin=setup.origin + setup.by_motion @ place, pupils=replace(setup.pupils, level=level), motion=None)


def smear_of(by_motion: Array, by_pixel: Array, by_pupil: Array) -> Array:
    """Over how many widths of a smoothed edge a target moves on the sensor when it moves by 1 mm, for maps to it (N, 2, 2)."""
    way, pixel, pupil = (np.linalg.norm(part, axis=(1, 2)) for part in (by_motion, by_pixel, by_pupil))
    width = np.maximum(pixel, np.pi / 2 * pupil)
    return np.divide(way, width, out=np.zeros_like(way), where=width > 0)


def moment_counts(motion: Motion | None, smear: Array, tolerance: float) -> Whole:
    """How many moments drift and vibration need, shape (N, 2): n of them leave about S / (4 n^2) of white.

    Measured on edges and bars boxed by a pixel, which wander over S times the width to which pixel and blur smooth them (Gauss's rule
    for the drift is worse there); a half more for the sine.

    Args:
        motion: of the targets; None for none.
        smear: see ``smear_of``, shape (N,).
        tolerance: largest error asked for, of white.
    """
    if motion is None:
        return np.ones((len(smear), 2), dtype=np.int64)
    demand = smear[:, None] * np.array([math.hypot(*motion.drift), 3.2 * math.hypot(*motion.vibration)]) / tolerance
    return np.maximum(np.ceil(np.sqrt(demand)), 1).astype(np.int64)

"""How finely the fall-off is told: over the pupil, and along strips and chords of it."""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.geometry.setup import Setup
from flflab.image.light.orders import MOST_POINTS, MOST_STRIPS

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

FALLOFF_SHARE = 0.2  # of the tolerance, for the fall-off of dots


def falloff_chunks(setup: Setup) -> int:
    """Into how many pieces of one weight a strip is cut for the fall-off; 0 for none.

    Where the weight changes by c from a strip's middle to its end, n pieces leave at most 0.088 c / n^2 of white.
    """
    return max(1, math.ceil(math.sqrt(0.22 * _weight_change(setup) / setup.tolerance))) if setup.falloff else 0


def weighing_chords(setup: Setup) -> int:
    """How many chords tell the mean of the fall-off over what three discs have in common; 0 for none.

    Where the weight changes by c from the pupil's middle to its rim, n chords leave at most 0.1 c / n^1.5 of white, measured on random
    discs.
    """
    if not setup.falloff:
        return 0
    allowed = FALLOFF_SHARE * setup.tolerance / setup.overlap
    return int(np.clip(math.ceil((0.1 * _weight_change(setup) / allowed) ** (2 / 3)), 1, MOST_STRIPS))


def _weight_change(setup: Setup) -> float:
    """The most that the weight of a ray changes from the pupil's middle to its rim."""
    pupils = setup.pupils
    steepest = np.hypot(pupils.slant_x, pupils.slant_y) + np.abs(pupils.slant_scale) * pupils.outside + np.abs(pupils.slant_spread)
    return 4 * float(np.max(steepest * np.abs(pupils.slant_spread)))


def falloff_counts(setup: Setup) -> Whole:
    """How many points a side across the pupil the fall-off of sharp dots needs, for each kind of rim.

    Where slopes at the sensor change by s over the pupil's radius, n of them leave at most s^(2 n) / 5^(n - 1) of white, measured on
    whole pupils with s up to 0.8.
    """
    squared = np.zeros(len(setup.rims.slope))
    if setup.falloff:
        np.maximum.at(squared, setup.rims.kind, np.minimum(setup.pupils.slant_spread**2, 4.0))
    allowed = FALLOFF_SHARE * setup.tolerance / setup.overlap
    counts = np.ceil(math.log(allowed / 5) / np.log(np.maximum(squared, 1e-12) / 5))
    return np.clip(counts, 1, MOST_POINTS).astype(np.int64)

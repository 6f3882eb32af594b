"""What becomes of a picture's tolerance: the one place that hands out shares of it.

A tolerance is the root mean square of the error over lit pixels, of the white level.
"""

import math

from flflab.errors import InputError

TOLERANCE = 0.002
LEAST_TOLERANCE = 1e-5
LEFT_OUT = 0.5  # for the bounds of all effects left out together
FORMED = 0.7  # of the rest, for closed forms, rays and tables
FAST = 5.0  # what ``fast`` makes of the tolerance
# Largest distance by which one map for a micro-image may miss rays, over an edge's width, in units
# of the tolerance: over all rays and all pixels the mean is a sixth of it.
MISFIT = 3.0
# Two boxes w and s count as one of sqrt(w^2 + s^2): the contrast of a period P is then off by
# sinc(w/P) sinc(s/P) (pi/P)^4 w^2 s^2/90, at most 0.03 (s/w)^2: motion s over a blur w.
OFF_BY_MOTION = 0.03


def check_tolerance(tolerance: float) -> None:
    """Refuse what no picture can keep.

    Raises:
        InputError: the tolerance is not a share of white that can be kept.
    """
    if not (math.isfinite(tolerance) and LEAST_TOLERANCE <= tolerance < 1):
        raise InputError(
            f"tolerance: {tolerance:g} of white; it must be at least {LEAST_TOLERANCE:g} and below"
            f" 1, for instance {TOLERANCE:g}"
        )


def for_forming(tolerance: float, left_out: float) -> float:
    """What is left of a tolerance for forming a picture, when effects of these bounds are left
    out.
    """
    return max(FORMED * (tolerance - left_out), LEAST_TOLERANCE)

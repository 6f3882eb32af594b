"""How light slopes within micro-images, smoothly over the picture."""

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kernel import SLOPE_X
from flflab.measurement.lattice.spread import Spread

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

UNKNOWN_SLOPE = 0.05  # of the light over a radius: what less sure slopes tell no course
SHIFTED = 0.4  # of the radius, by which a slope of 1 moves the centre: a blob's slope is a shift


def course_of_slopes(
    indices: Whole, values: Array, doubt: Spread, inner: Flags, radius: float
) -> Array | None:
    """How slopes go over the picture, linear in the place, as a share of the light over a radius,
    shape (n, 2): of many micro-images it is known from places where a single one's is not. None
    where it cannot be told.

    Args:
        indices: of the micro-images, shape (n, 2).
        values: of each.
        doubt: how sure they are.
        inner: which count.
        radius: of them, px.
    """
    if float(np.median(np.abs(doubt.by_slope[inner]))) > SHIFTED * radius:
        return None
    index = indices / (np.abs(indices).max() + 1.0)
    design, mean = np.column_stack([np.ones(len(index)), index]), np.zeros((len(index), 2))
    for axis in range(2):
        seen = values[:, SLOPE_X + axis]
        sure = np.sqrt(doubt.covariance[:, SLOPE_X + axis, SLOPE_X + axis])
        if float(np.median(sure[inner])) > UNKNOWN_SLOPE:
            return None
        good, found = inner.copy(), np.zeros(3)
        for _ in range(3):
            root = 1 / sure[good]
            found, *_ = np.linalg.lstsq(design[good] * root[:, None], seen[good] * root, rcond=None)
            off = np.abs(seen - design @ found) / np.maximum(sure, 1e-9)
            good = inner & (off < 4 * max(float(np.median(off[good])) * 1.5, 1.0))
        mean[:, axis] = design @ found
    return mean

"""How light slopes within micro-images, and what that leaves unsure of their centres."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kernel import SLOPE_X
from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.spread import Spread

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

LOOSE_SLOPE = 0.3  # of the light over a radius: what slopes may be before any was seen
LEAST_SLOPE = 0.003  # the same, by which they may depart from their smooth course
MOVED_PX = 0.01  # what a slope of its own may move a micro-image by
UNKNOWN_SLOPE = 0.05  # the same, where no course can be told
SHIFTED = 0.4  # of the radius, by which a slope of 1 moves the centre: a blob's slope is a shift
SLOPE_OF_BLOB = 0.02  # what remains unsure of it then, as a share of the light over a radius
SHARE = 0.1  # of the slope of the light that may belong to the profile
OF_MISFIT = 0.3  # of what the profile does not explain, which may move a rim
BESIDE = 0.05  # of the softness: where a neighbour is missing the light's ground slopes
BEHIND = 0.008  # of the softness: what is left of that for those behind them
OF_SHARED = 0.1  # of the light between micro-images, which may move a rim
ALIKE = 0.5  # of that which may move all micro-images alike
GROWING = 1.0  # of that which may move them apart from the middle, as a second stop does
FINEST_PX = 0.003  # pixels do not answer alike over their area


@dataclass(frozen=True)
class Slopes:
    """How light slopes within micro-images, as a share of it over a radius.

    Attributes:
        mean: along x and y, of each, shape (n, 2).
        apart: how far single ones depart from that.
        doubt: standard uncertainty of the mean.
    """

    mean: Array
    apart: float
    doubt: float


def unknown_slopes(count: int) -> Slopes:
    """Those of so many micro-images of which nothing was seen."""
    return Slopes(np.zeros((count, 2)), LOOSE_SLOPE, LOOSE_SLOPE)


def course_of_slopes(
    indices: Whole, values: Array, doubt: Spread, inner: Flags, before: Slopes, radius: float
) -> Slopes:
    """How slopes go over the picture, linear in the place: of many micro-images it is known from
    places where a single one's is not.
    """
    mean = np.zeros((len(values), 2))
    if float(np.median(np.abs(doubt.by_slope[inner]))) > SHIFTED * radius:
        return Slopes(mean, LEAST_SLOPE, SLOPE_OF_BLOB)
    variances, apart, singles = list[float](), list[float](), list[float]()
    index = indices / (np.abs(indices).max() + 1.0)
    design = np.column_stack([np.ones(len(index)), index])
    for axis in range(2):
        seen, beforehand = values[:, SLOPE_X + axis], before.mean[:, axis]
        variance, precision = doubt.posterior[:, SLOPE_X + axis], 1 / before.apart**2
        # what was expected beforehand is taken off again
        shown = np.maximum(1 / variance - precision, 1e-3 * precision)
        seen = (seen / variance - beforehand * precision) / shown
        weight = shown / np.maximum(doubt.factor[:, SLOPE_X + axis], 1e-9)
        good, found = inner & np.isfinite(seen), np.zeros(design.shape[1])
        for _ in range(3):
            root = np.sqrt(weight[good])
            found, *_ = np.linalg.lstsq(design[good] * root[:, None], seen[good] * root, rcond=None)
            off = np.abs(seen - design @ found) * np.sqrt(weight)
            good = inner & (off < 4 * max(float(np.median(off[good])) * 1.5, 1.0))
        mean[:, axis] = design @ found
        variances.append(1 / float(weight[good].sum()))
        off = (seen - design @ found)[good] ** 2
        apart.append(math.sqrt(max(float(np.mean(off - 1 / weight[good])), 0.0)))
        singles.append(1 / math.sqrt(float(np.median(weight[good]))))
    if max(singles) > UNKNOWN_SLOPE:
        return Slopes(np.zeros_like(mean), LEAST_SLOPE, UNKNOWN_SLOPE)
    # slopes of their own may move no micro-image further than it is worth
    most = MOVED_PX / max(float(np.median(np.abs(doubt.by_slope[inner]))), 1e-9)
    return Slopes(mean, min(max(*apart, LEAST_SLOPE), most), math.sqrt(max(variances)))


def definition_of_centres(doubt: Spread, slopes: Slopes, profile: Profile, between: float) -> Array:
    """How far each centre may lie aside of what others would call so, px: by slopes of the light
    that may be the profile's own, by light that the profile does not explain, and by light that
    neighbours share.

    Args:
        doubt: of the micro-images.
        slopes: of their light.
        profile: that they share.
        between: share of the light where they are farthest from each other, if it belongs to them
            alone.
    """
    slope = np.hypot(SHARE * np.hypot(*slopes.mean.T), slopes.doubt)
    by_slope = np.abs(doubt.by_slope).max(axis=1) * slope
    # one micro-image's own misfit is known to a half: its fellows' count too
    misfit = np.sqrt((doubt.misfit**2 + 3 * np.median(doubt.misfit) ** 2) / 4)
    rims = np.hypot(OF_MISFIT * misfit, OF_SHARED * between) * profile.softness
    return np.sqrt(by_slope**2 + rims**2 + FINEST_PX**2)


def asides(indices: Whole, size: float) -> list[Array]:
    """Ways in which all centres may lie aside together, px: along x or y, everywhere alike or
    growing from the middle outwards along rows or columns.
    """
    place = indices / (np.abs(indices).max() + 1.0)
    fields = (ALIKE * np.ones(len(place)), *(GROWING * place.T))
    return [size * np.outer(field, way) for field in fields for way in ((1.0, 0.0), (0.0, 1.0))]

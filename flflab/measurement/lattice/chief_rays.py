"""Where chief rays land against where light is found: natural fall-off across the cone of a
micro-image moves its light, in proportion to how steeply its middle ray lands.

How much of that fall-off there is, the slope of the light within micro-images shows; where it
cannot, all of it is expected. Fall-off by the fourth power of the cosine is itself of first order
(coma of the microlenses and distortion of the pupil are as large), so half of what it moves is a
standard uncertainty.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.slopes import Slopes
from flflab.measurement.lattice.tilting import Tilting
from flflab.measurement.lattice.two_discs import TwoDiscs

Array = npt.NDArray[np.float64]

UNSURE = 0.5  # of the fall-off: standard uncertainty
LOOSE_RATE = 0.2  # of the whole fall-off: how far slopes may differ from its share
LOOSE_SLANT = 0.005  # standard deviation of the middle ray's slope on the axis
LEAST_SHARE = 0.05  # of the fall-off: what noise may show of it


@dataclass(frozen=True)
class FallOff:
    """How light falls off within micro-images.

    Attributes:
        middle_px: the point that ``slant`` belongs to, shape (2,).
        slant: slope of the middle ray there, as far as light falls off with it, shape (2,).
        rate: how it grows a px.
        full_rate: how it would grow with all of the fall-off.
        shift_px: by how much a unit of slant moves what is found.
    """

    middle_px: Array
    slant: Array
    rate: float
    full_rate: float
    shift_px: float

    @property
    def share(self) -> float:
        """Of natural fall-off that there is, 0 to 1."""
        return min(max(self.rate / self.full_rate, 0.0), 1.0)

    def moved(self, centres_px: Array) -> Array:
        """How far light lies from the chief rays' places, px, shape (n, 2)."""
        return self.shift_px * (self.slant + self.rate * (centres_px - self.middle_px))

    @property
    def uncertainty(self) -> float:
        """By how much all places may grow from the axis outwards together, relative."""
        return UNSURE * abs(self.shift_px) * max(LEAST_SHARE * self.full_rate, abs(self.rate))


def fall_off(
    centres_px: Array, slopes: Slopes, discs: TwoDiscs, tilting: Tilting, share: float
) -> FallOff:
    """The fall-off that slopes of the light show.

    Args:
        centres_px: of whole micro-images, shape (n, 2).
        slopes: of their light.
        discs: with which they were fitted.
        tilting: of the camera: where its axis is, and how slants grow.
        share: of fall-off, as the light across micro-images shows it.
    """
    middle = np.asarray(tilting.axis_px, dtype=np.float64)
    away = centres_px - middle
    size = max(math.sqrt(float(np.mean(away**2))), 1.0)
    # slopes = discs.slope (slant + rate away), what is expected beforehand as further rows
    count, known = len(away), max(slopes.doubt, 1e-9) * math.sqrt(len(away))
    design, seen = np.zeros((2 * count + 3, 3)), np.zeros(2 * count + 3)
    for axis in range(2):
        rows = slice(axis * count, (axis + 1) * count)
        design[rows, axis], design[rows, 2] = 1.0, away[:, axis]
        seen[rows] = slopes.mean[:, axis]
    design[: 2 * count] *= discs.slope / known
    seen[: 2 * count] /= known
    loose = LOOSE_RATE * max(share, LEAST_SHARE) * tilting.per_px
    aside = LOOSE_SLANT * max(share, LEAST_SHARE)
    design[-3:] = np.diag([1 / aside, 1 / aside, 1 / loose])
    seen[-1] = share * tilting.per_px / loose
    scale = np.array([1.0, 1.0, 1 / size])
    found = np.linalg.lstsq(design * scale, seen, rcond=None)[0] * scale
    found = np.asarray(found, dtype=np.float64)
    return FallOff(middle, found[:2], float(found[2]), tilting.per_px, discs.shift_px)


def expected_slopes(centres_px: Array, discs: TwoDiscs, tilting: Tilting) -> Array:
    """Slopes of the light that all of the fall-off makes, shape (n, 2)."""
    return discs.slope * tilting.per_px * (centres_px - np.asarray(tilting.axis_px))

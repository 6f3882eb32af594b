"""The light across a micro-image of a white target: two overlapping discs, averaged over the pixel.

The main lens's shadow (radius w_m/2) and the microlens's (radius w_q/2) overlap at distance r by
rho(r) = |disc(0, r_a) with disc(r, r_b)| / (pi r_b^2). Source: physics.md, "Exact image of a flat target".
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.optics.discs import two_disc_areas

Array = npt.NDArray[np.float64]

_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def overlap_share(distance: Array, large: float, small: float) -> Array:
    """Area common to two discs over that of the second; lengths in one unit, ``small`` above 0."""
    return two_disc_areas(np.asarray(large), np.asarray(small), np.asarray(distance, dtype=np.float64)) / (np.pi * small**2)


@dataclass(frozen=True)
class ProfileTable:
    """The pixel-averaged profile against the distance of the pixel's centre from the micro-image's.

    A square pixel sees an edge along its side sharper than one along its diagonal, so the average is
    mean(r) + square(r) cos(4 theta), theta the direction from the micro-image's centre.

    Attributes:
        step: distance between entries, px.
        values: columns: mean, its derivative by the distance, by the first and by the second radius, square; shape (n, 5).
    """

    step: float
    values: Array

    @property
    def reach(self) -> float:
        """Distance from which on the profile is 0, px."""
        return self.step * (len(self.values) - 2)


def _pixel_average(radius: Array, large: float, small: float, step: float) -> tuple[Array, Array]:
    """Average over the pixel's square: mean and fourfold part, from the directions along a side and along the diagonal."""
    finer = step / 4
    fine = overlap_share(np.arange(0.0, radius[-1] + 2.0, finer), large, small)
    place = np.arange(len(fine), dtype=np.float64)
    sums: list[Array] = []
    for turn in (0.0, np.pi / 4):
        total = np.zeros_like(radius)
        for gx, wx in zip(_GAUSS, _WEIGHTS, strict=True):
            for gy, wy in zip(_GAUSS, _WEIGHTS, strict=True):
                along = 0.5 * (gx * np.cos(turn) - gy * np.sin(turn))
                across = 0.5 * (gx * np.sin(turn) + gy * np.cos(turn))
                total += wx * wy / 4 * np.interp(np.hypot(radius + along, across) / finer, place, fine)
        sums.append(total)
    return (sums[0] + sums[1]) / 2, (sums[0] - sums[1]) / 2


def profile_table(large: float, small: float) -> ProfileTable:
    """Tabulate the profile of two radii in px with its derivatives."""
    step = min(0.0625, max(0.01, (large + small) / 400))
    radius = np.arange(0.0, large + small + 1.0, step)
    nudge = 0.01
    value, square = _pixel_average(radius, large, small, step)
    by_large = (_pixel_average(radius, large + nudge, small, step)[0] - value) / nudge
    by_small = (_pixel_average(radius, large, small + nudge, step)[0] - value) / nudge
    by_radius = np.gradient(value, step)
    by_radius[0] = 0.0
    table = np.stack([value, by_radius, by_large, by_small, square], axis=1)
    table[-2:] = 0.0
    return ProfileTable(step, table)

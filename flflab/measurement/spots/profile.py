"""The light across the image of a round dot, averaged over a square pixel: tabulated by distance
and direction.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.special import chndtr

from flflab.measurement.lattice.profile import overlap_share
from flflab.optics.discs import disc_rectangle_area

Array = npt.NDArray[np.float64]

_STEP, _FINER = 1 / 32, 1 / 256  # px
_TURNS = 8  # directions in an eighth of a turn
_PARTS = 12  # of a pixel's side
_SHARP = 0.3  # px of blur below which an edge is too steep for these parts
_SHARP_STEP, _SHARP_TURNS = 1 / 96, 32  # its pixel averages bend sharply where it leaves a pixel
# eight points of equal weight with the disc's moments up to the third order
_DISC = math.sqrt(0.5) * np.stack(
    [np.cos(np.arange(8) * math.pi / 4), np.sin(np.arange(8) * math.pi / 4)], axis=1
)


@dataclass(frozen=True)
class SpotProfile:
    """A spot's light, 1 where the whole pixel is lit.

    Attributes:
        step: distance between columns, px.
        values: by direction, from along a pixel's side to along its diagonal, and by distance;
            shape (directions, n).
    """

    step: float
    values: Array

    @property
    def flat(self) -> float:
        """Distance up to which all pixels are wholly lit, px."""
        return self.step * max(0, int(np.argmax(self.values.min(axis=0) < 1.0)) - 1)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _pixel_averages(
    fine: Array, finer: float, step: float, count: int, turns: int, parts: int
) -> Array:  # pragma: no cover - compiled
    values = np.zeros((turns + 1, count))
    for k in range(count):
        r = k * step
        first, last = max(0, int((r - 0.71) / finer)), int((r + 0.71) / finer) + 1
        if np.abs(fine[first : last + 1] - fine[first]).max() == 0.0:
            values[:, k] = fine[first]
            continue
        for m in range(turns + 1):
            angle = m * math.pi / 4 / turns
            x, y = r * math.cos(angle), r * math.sin(angle)
            total = 0.0
            for i in range(parts):
                for j in range(parts):
                    place = (
                        math.hypot(x + (i + 0.5) / parts - 0.5, y + (j + 0.5) / parts - 0.5) / finer
                    )
                    n = int(place)
                    total += fine[n] + (place - n) * (fine[n + 1] - fine[n])
            values[m, k] = total / (parts * parts)
    return values


def _averaged(radial: Array, reach: float) -> SpotProfile:
    count = math.ceil((reach + 1) / _STEP) + 1
    return SpotProfile(_STEP, _pixel_averages(radial, _FINER, _STEP, count, _TURNS, _PARTS))


def _distances(reach: float) -> Array:
    return np.arange(0.0, reach + 3, _FINER)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _disc_shares(
    radius: float, shifts: Array, step: float, count: int, turns: int
) -> Array:  # pragma: no cover - compiled
    """Shares of pixels within a disc, closed form, averaged over places of the disc along and
    across the pixel's direction.
    """
    values = np.zeros((turns + 1, count))
    reach = 0.71 + np.abs(shifts).max()
    for k in range(count):
        r = k * step
        if abs(r - radius) > reach:
            values[:, k] = 1.0 if r < radius else 0.0
            continue
        for m in range(turns + 1):
            angle = m * math.pi / 4 / turns
            along, across = math.cos(angle), math.sin(angle)
            for n in range(len(shifts)):
                x = (r + shifts[n, 0]) * along - shifts[n, 1] * across
                y = (r + shifts[n, 0]) * across + shifts[n, 1] * along
                values[m, k] += disc_rectangle_area(
                    radius, x - 0.5, x + 0.5, y - 0.5, y + 0.5
                ) / len(shifts)
    return values


def defocused_dot(radius: float, blur: float) -> SpotProfile:
    """A disc of ``radius`` px blurred by a disc of diameter ``blur`` px."""
    if blur < _SHARP:
        count = math.ceil((radius + blur / 2 + 1) / _SHARP_STEP) + 1
        return SpotProfile(
            _SHARP_STEP, _disc_shares(radius, blur / 2 * _DISC, _SHARP_STEP, count, _SHARP_TURNS)
        )
    return _averaged(
        overlap_share(_distances(radius + blur / 2), radius, blur / 2), radius + blur / 2
    )


def softened_dot(radius: float, sigma: float) -> SpotProfile:
    """A disc of ``radius`` px blurred by a normal distribution of ``sigma`` px in each coordinate.

    The share of a two-dimensional normal distribution at r from the disc's centre that falls on the
    disc: the noncentral chi-square distribution of two degrees of freedom.
    """
    reach = radius + 7 * sigma
    return _averaged(
        np.asarray(
            chndtr((radius / sigma) ** 2, 2, (_distances(reach) / sigma) ** 2), dtype=np.float64
        ),
        reach,
    )

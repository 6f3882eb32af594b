"""How the microlenses of an array differ from one another: drawn arrays built as stated.

Every draw is one array; its lenses have the same errors in every configuration, so what two
configurations share of them cancels between them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.polynomial.hermite_e import hermegauss

from flflab.bench_uncertainty import WorkmanshipDescription

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
POINTS = 11
FOCAL = 4  # among what is drawn of a lens
FARTHEST = 1 << 12  # lenses from the middle of an array
WHOLE_ARRAY = -1  # what errors of all lenses together are drawn by, in place of a lens's number


@dataclass(frozen=True)
class LensErrors:
    """Standard deviations from lens to lens, and what the draws are made from.

    Attributes:
        position: of each coordinate of a lens with its aperture, mm.
        aperture_decentre: of each coordinate of an aperture against its lens, mm.
        focal_length: as a share.
        seed: of the draws.
    """

    position: float = 0.0
    aperture_decentre: float = 0.0
    focal_length: float = 0.0
    seed: int = 0

    def drawn(self, lenses: Whole, draws: int) -> Array:
        """Errors of each lens: place of lens with aperture (x, y), of the aperture against it (x,
        y), both mm, and focal length as a share; shape (draws, lenses, 5).
        """
        found = np.empty((draws, len(lenses), 5))
        for place, lens in enumerate(lenses.tolist()):
            found[:, place] = self._normal(lens, (draws, 5))
        position, decentre = self.position, self.aperture_decentre
        return found * [position, position, decentre, decentre, self.focal_length]

    def _normal(self, lens: int, shape: tuple[int, ...]) -> Array:
        key = (self.seed << 32) + lens + 2
        return np.random.Generator(np.random.Philox(key=key)).standard_normal(shape)

    @property
    def differ(self) -> bool:
        """Whether lenses differ at all."""
        return max(self.position, self.aperture_decentre, self.focal_length) > 0

    def mean_of(self, read: Callable[[float], Array], lenses: int, draws: int) -> Array:
        """What an array shows of a quantity that each of its lenses shows: the mean over many
        lenses, and how it scatters from array to array.

        Points of Gauss and Hermite stand for the lenses; what they show, each with a normal number
        and the root of its weight, scatters as the mean over that many lenses does.

        Args:
            read: the quantity of lenses all of a focal length longer by this factor, shape
                (draws, ...).
            lenses: how many lenses the mean is over.
            draws: number of arrays.
        """
        if self.focal_length == 0:
            return read(1.0)
        points, weights = hermegauss(POINTS)
        weights = weights / weights.sum()
        shown = np.stack([read(1 + float(t) * self.focal_length) for t in points], axis=1)
        mean = np.einsum("nk...,k->n...", shown, weights)
        normal = self._normal(WHOLE_ARRAY, (draws, POINTS)) * np.sqrt(weights / max(lenses, 1))
        return mean + np.einsum("nk...,nk->n...", shown - mean[:, None], normal)

    def of_the_lattice(self, centres: Array, draws: int, shown: float) -> Array:
        """What the lenses' places do to the lattice fitted to all of them: its scale along x and y
        and its roll, shape (draws, 3).

        Args:
            centres: of all lenses, mm, shape (N, 2).
            draws: number of arrays.
            shown: share of an aperture's decentre that its micro-image shows.
        """
        place = math.hypot(self.position, shown * self.aperture_decentre)
        spread = np.sqrt(np.sum((centres - centres.mean(axis=0)) ** 2, axis=0))
        x, y = (place / one if one > 0 else 0.0 for one in spread.tolist())
        return self._normal(WHOLE_ARRAY - 1, (draws, 3)) * [x, y, math.hypot(x, y) / 2]

    def of_the_parallax(self, centres: Array, lenses: Whole, draws: int) -> Array:
        """Share by which apertures that stand aside stretch the parallax over these lenses, shape
        (draws,): the slope of the decentre over the places.

        Args:
            centres: of the lenses, mm, shape (n, 2).
            lenses: their numbers, shape (n,).
            draws: number of arrays.
        """
        across = centres - centres.mean(axis=0) if len(lenses) else centres
        spread = float(np.sum(across**2))
        if self.aperture_decentre == 0 or spread == 0:
            return np.zeros(draws)
        return np.einsum("nij,ij->n", self.drawn(lenses, draws)[..., 2:4], across) / spread


EQUAL_LENSES = LensErrors()


def numbers_of(indices: Whole) -> Whole:
    """Numbers of lenses by their places in a lattice, the same for the same lens in every picture.

    Args:
        indices: (i, j) from the middle, shape (n, 2).
    """
    return (indices[:, 0] + FARTHEST) * (2 * FARTHEST) + indices[:, 1] + FARTHEST


def stated_lens_errors(stated: WorkmanshipDescription, seed: int) -> LensErrors:
    """The lenses of a bench file's ``workmanship``. Their brightness is not among them: what a lens
    shows is measured against its own light in the white picture.
    """
    return LensErrors(
        stated.microlens_position,
        stated.aperture_decentre,
        stated.microlens_focal_length,
        seed,
    )

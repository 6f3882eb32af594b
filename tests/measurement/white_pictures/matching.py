"""What a measurement found, compared with what was drawn."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from white_pictures.lattice import wrapped
from white_pictures.spec import Array, Flags, TrueLattice, Truth


@dataclass(frozen=True)
class Matched:
    """Micro-images found, beside the lenses drawn.

    Attributes:
        found: Row of each match in what was found, (M,).
        drawn: Row of each match in the truth, (M,).
        error: Found less drawn centre, (M, 2) px.
        whole: Matches with a whole lens, (M,).
        overlooked: Rows of the truth of whole lenses that were not found.
        index_is_right: Indices found are those drawn but for one shift and one symmetry.
    """

    found: npt.NDArray[np.int64]
    drawn: npt.NDArray[np.int64]
    error: Array
    whole: Flags
    overlooked: npt.NDArray[np.int64]
    index_is_right: bool

    @property
    def rms(self) -> float:
        """Of the whole lenses' errors, px in one direction."""
        return float(np.sqrt(np.mean(self.error[self.whole] ** 2)))

    def z(self, sigma: Array) -> Array:
        """Errors of the whole lenses over their stated uncertainties, (W, 2).

        Args:
            sigma: Stated for every row found, (N, 2) px.
        """
        return np.asarray((self.error / sigma[self.found])[self.whole])


def match(truth: Truth, centres: Array, indices: npt.NDArray[np.integer]) -> Matched:
    """Give each centre found the nearest lens drawn, within three tenths of the pitch.

    Args:
        truth: What was drawn.
        centres: Found, (N, 2) px as (x, y).
        indices: Found, (N, 2).
    """
    there = np.flatnonzero(~truth.missing)
    distance, nearest = map(np.asarray, KDTree(truth.centre[there]).query(centres))
    near = distance < 0.3 * truth.lattice.pitch
    # of two found near one lens the nearer is the match
    order = np.argsort(distance, kind="stable")
    order = order[near[order]]
    _, first = np.unique(nearest[order], return_index=True)
    found = np.sort(order[first])
    drawn = there[nearest[found]]
    whole = truth.whole
    return Matched(
        found,
        drawn,
        centres[found] - truth.centre[drawn],
        whole[drawn],
        np.setdiff1d(np.flatnonzero(whole), drawn),
        _same_lattice(indices[found], truth.index[drawn]),
    )


def _same_lattice(found: npt.NDArray[np.integer], drawn: npt.NDArray[np.int64]) -> bool:
    """Whether one integer map of determinant 1 or -1 and one shift take all indices to others."""
    rows = np.column_stack([np.ones(len(found)), found])
    fitted, _, rank, _ = np.linalg.lstsq(rows, drawn.astype(np.float64), rcond=None)
    whole_numbers = np.rint(fitted)
    exact = np.array_equal(rows @ whole_numbers, drawn)
    return bool(rank == 3 and exact and abs(round(np.linalg.det(whole_numbers[1:]))) == 1)


@dataclass(frozen=True)
class LatticeError:
    """A lattice found, less the one drawn.

    Attributes:
        pitch: px.
        angle: degrees, within half a symmetry of 0.
        origin: From the nearest point of the lattice drawn, (2,) px.
    """

    pitch: float
    angle: float
    origin: Array


def compare_lattice(drawn: TrueLattice, origin: Array, pitch: float, angle: float) -> LatticeError:
    """Errors of a lattice found.

    Args:
        drawn: The lattice drawn.
        origin: Found, a lattice point, (x, y) px.
        pitch: Found, px, as ``WhiteSpec.pitch`` defines it.
        angle: Found, degrees, up to a symmetry; of hexagonal lattices that of a dense row.
    """
    node = np.rint(np.linalg.solve(drawn.vectors, origin - drawn.origin))
    away = origin - drawn.origin - drawn.vectors @ node
    return LatticeError(pitch - drawn.pitch, wrapped(angle - drawn.angle, drawn.symmetry), away)

"""Which micro-images lie near which."""

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

MOST = 18  # neighbours: two rings of a hexagonal lattice


def neighbours_within(centres: npt.NDArray[np.float64], reach: float) -> npt.NDArray[np.int64]:
    """Positions of the other micro-images whose centres lie nearer, of the nearest ``MOST``; -1
    where there is none.
    """
    most = min(MOST, len(centres) - 1)
    if most < 1:
        return np.full((len(centres), 1), -1, dtype=np.int64)
    found = KDTree(centres).query(centres, most + 1, distance_upper_bound=reach)[1]
    found = np.where(found == np.arange(len(centres))[:, None], len(centres), found)
    found = np.sort(found, axis=1)[:, :most].astype(np.int64)
    found[found == len(centres)] = -1
    return found[:, : max(1, int((found >= 0).sum(axis=1).max()))]

"""The lattice of a white picture that shows too few micro-images to repeat: from the middles of its
bright spots.
"""

import itertools

import numpy as np
import numpy.typing as npt
from skimage.measure import label, regionprops
from skimage.segmentation import clear_border

from flflab.measurement.lattice.find import RoughLattice, lattice_near, layout_of, reduced

Array = npt.NDArray[np.float64]

FEWEST, MOST = 4, 200  # spots
LEAST_AREA = 20.0  # px: less is a speck of noise
SMALLEST = 0.5  # area of a spot over the median of all
ASIDE = 0.4  # least sine between the two vectors
OFF = 0.1  # pitches that a spot may lie off the lattice


def spots_in(picture: npt.NDArray[np.floating]) -> Array:
    """Middles of separate bright spots that the border does not cut, px, shape (n, 2).

    Args:
        picture: DN, [row, col], finite.
    """
    dark, bright = np.quantile(picture[::2, ::2], [0.02, 0.98])
    seen = regionprops(clear_border(label(picture > (dark + bright) / 2)))
    spots = [spot for spot in seen if spot.area >= LEAST_AREA]
    usual = float(np.median([spot.area for spot in spots])) if spots else 0.0
    middles = [spot.centroid[::-1] for spot in spots if spot.area > SMALLEST * usual]
    return np.array(middles, dtype=np.float64).reshape(-1, 2)


def lattice_of_spots(picture: npt.NDArray[np.floating], middles: Array) -> RoughLattice | None:
    """The lattice on which separate bright spots lie; ``None`` where they lie on none.

    Args:
        picture: DN, [row, col], finite.
        middles: see ``spots_in``.
    """
    if not FEWEST <= len(middles) <= MOST:
        return None
    apart = np.array([q - p for p, q in itertools.combinations(middles, 2)])
    apart = apart[np.argsort(np.hypot(*apart.T))]
    first = apart[0]
    sines = np.abs(first[0] * apart[:, 1] - first[1] * apart[:, 0])
    aside = sines > ASIDE * np.hypot(*first) * np.hypot(*apart.T)
    if not aside.any():
        return None
    vectors = reduced(np.stack([first, apart[aside][0]], axis=1))
    steps = np.rint(np.linalg.solve(vectors, (middles - middles[0]).T)).T
    design = np.column_stack([steps, np.ones(len(steps))])
    fitted, _, rank, _ = np.linalg.lstsq(design, middles, rcond=None)
    vectors = fitted[:2].T
    off = np.hypot(*(middles - design @ fitted).T).max()
    if rank < design.shape[1] or off > OFF * np.hypot(*vectors).min():
        return None
    return lattice_near(picture, *layout_of(np.asarray(vectors, dtype=np.float64)))

"""The lattice of a tilted array: origin, vectors, the two discs and the tilt that explain centres
and radii of whole micro-images together.

What a tilt does to either stands in ``tilting``.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.measurement.lattice.kinds import Kinds
from flflab.measurement.lattice.tilting import Tilting

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

LOOSE_TILT = 0.05  # standard deviation of a slope, before any micro-image was looked at
CUT = 5.0  # robust deviations beyond which a micro-image does not count
ROUNDS = 3
# values that centres tell together, and that each disc's radius does
FREE = (slice(0, 2), 8), (slice(2, 3), 2), (slice(3, 4), 2)
ORIGIN, VECTORS, RADII, TILT = slice(0, 2), slice(2, 6), slice(6, 8), slice(8, 10)


@dataclass(frozen=True)
class Images:
    """Whole micro-images, one entry each.

    Attributes:
        indices: position (i, j) in the lattice, shape (n, 2).
        centres_px: (x, y), shape (n, 2).
        radii_px: larger and smaller of the two discs, shape (n, 2).
        covariance_px: of (x, y, larger, smaller), shape (n, 4, 4).
    """

    indices: Whole
    centres_px: Array
    radii_px: Array
    covariance_px: Array


@dataclass(frozen=True)
class Tilted:
    """What explains the micro-images.

    Attributes:
        values: origin x y, a x y, b x y, larger and smaller radius, px, and slopes of the array
            along (x, y); shape (10,).
        covariance: of them.
        radii_apart: standard deviation of the radius that scatters more, beyond noise, px.
    """

    values: Array
    covariance: Array
    radii_apart: float

    @property
    def vectors(self) -> Array:
        """a and b as columns, px."""
        return self.values[VECTORS].reshape(2, 2).T


def tilted_lattice(
    images: Images, start: Array, tilting: Tilting, kinds: Kinds | None, by_radii: bool
) -> Tilted:
    """Least squares with what micro-images scatter by counted in, radii and centres each by
    theirs.

    Args:
        images: whole ones.
        start: values to begin with, shape (10,).
        tilting: what a tilt does to the central microlens's micro-images.
        kinds: of microlenses; None where there is one.
        by_radii: whether radii tell the tilt, not where several kinds are taken for one.
    """
    seen = np.concatenate([images.centres_px, images.radii_px], axis=1)
    places, values = images.indices.astype(np.float64), start.copy()
    values[RADII] = np.median(images.radii_px, axis=0) if kinds is None else values[RADII]
    good = np.ones(len(seen), dtype=np.bool_)
    scale = np.array([1.0, 1, 0.1, 0.1, 0.1, 0.1, 1, 1, 1e-3, 1e-3])
    scatter, inverse = np.zeros(4), np.eye(10)

    def expected(of: Array) -> Array:
        straight = of[ORIGIN] + places @ of[VECTORS].reshape(2, 2)
        centres, rises = tilting.centres(straight, of[TILT]), tilting.rises(straight, of[TILT])
        if not by_radii:
            return np.concatenate([centres, np.tile(of[RADII], (len(centres), 1))], axis=1)
        if kinds is None:
            discs = tilting.discs(of[RADII], rises)
        else:
            discs = kinds.discs(of[RADII], kinds.of(centres), tilting, rises)
        return np.concatenate([centres, discs], axis=1)

    for _ in range(ROUNDS):
        covariance = images.covariance_px + np.diag(scatter**2)
        whiten = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)

        def residuals(free: Array, whiten: Array = whiten, good: Flags = good) -> Array:
            rest = np.einsum("nij,nj->ni", whiten, seen - expected(free))[good]
            return np.concatenate([rest.ravel(), free[TILT] / LOOSE_TILT])

        found = least_squares(residuals, values, x_scale=scale, max_nfev=20)
        values = np.asarray(found.x, dtype=np.float64)
        jacobian = found.jac * scale
        inverse = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-14, hermitian=True)
        inverse = inverse * np.outer(scale, scale)
        rest, own = seen - expected(values), np.einsum("nkk->nk", images.covariance_px)
        # a focal length of its own makes one of the discs larger, not the other
        for part, freed in FREE:
            freedom = max(rest[good, part].size - freed, 1)
            total = float(np.sum(rest[good, part] ** 2)) / freedom
            scatter[part] = np.sqrt(max(total - float(own[good, part].mean()), 0.0))
        reach = np.einsum("nij,nj->ni", whiten, rest)
        size = np.sum(reach**2, axis=1)
        good = size < CUT**2 * max(float(np.median(size)), 1.0)
    return Tilted(values, inverse, float(scatter[2:].max()))

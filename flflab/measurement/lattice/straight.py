"""The lattice of a tilted array: origin, vectors, the two discs of every kind of microlens and the
tilt that explain centres and radii of whole micro-images together.

What a tilt does to either stands in ``tilting``.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.tilting import Axis, discs_at
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

LOOSE_TILT = 0.05  # standard deviation of a slope, before any micro-image was looked at
CUT = 5.0  # robust deviations beyond which a micro-image does not count
ROUNDS = 5
NUDGE = 1e-6  # of a rise
VECTORS, TILT, RADII = slice(0, 6), slice(6, 8), slice(8, None)


@dataclass(frozen=True)
class Images:
    """Whole micro-images, one entry each.

    Attributes:
        indices: position (i, j) in the lattice, shape (n, 2).
        centres_px: (x, y), shape (n, 2).
        radii_px: larger and smaller of the two discs, shape (n, 2).
        covariance_px: of (x, y, larger, smaller), shape (n, 4, 4).
        kind: of each microlens, from 0 up, shape (n,).
    """

    indices: Whole
    centres_px: Array
    radii_px: Array
    covariance_px: Array
    kind: Whole


@dataclass(frozen=True)
class Straight:
    """What explains the micro-images.

    Attributes:
        values: origin x y, a x y, b x y, px, slopes of the array along (x, y), larger and smaller
            radius of each kind where there is no rise, px; shape (8 + 2 kinds,).
        covariance: of them.
        radii_apart: standard deviation of the radius that scatters more, beyond noise, px.
    """

    values: Array
    covariance: Array
    radii_apart: float

    @property
    def vectors(self) -> Array:
        """a and b as columns, px."""
        return self.values[2:6].reshape(2, 2).T


def straight_lattice(images: Images, kinds: list[Smms], axis: Axis, pixel: float) -> Straight:
    """Least squares with what micro-images scatter by counted in, radii and centres each by
    theirs.

    Args:
        images: whole ones.
        kinds: the microlenses of each kind.
        axis: of the camera.
        pixel: of its sensor, mm.
    """
    own = np.einsum("nkk->nk", images.covariance_px)
    good = np.ones(len(images.kind), dtype=np.bool_)
    scale = float(np.abs(images.indices).max()) + 1.0
    units = np.array([1, 1, *4 * [1 / scale], *2 * [1e-3], *2 * len(kinds) * [1.0]])
    values, covariance, scatter = np.zeros(len(units)), np.eye(len(units)), np.zeros(4)
    for k in range(len(kinds)):
        values[8 + 2 * k : 10 + 2 * k] = np.median(images.radii_px[images.kind == k], axis=0)
    for _ in range(ROUNDS):
        design, seen = _equations(images, kinds, axis, pixel, values)
        design = design * units
        root = np.linalg.inv(np.linalg.cholesky(images.covariance_px + np.diag(scatter**2)))
        rows = (root @ design)[good].reshape(-1, len(units))
        rest = np.einsum("nij,nj->ni", root, seen)[good].ravel()
        expected = np.zeros(len(units))
        expected[TILT] = (units[TILT] / LOOSE_TILT) ** 2
        normal = rows.T @ rows + np.diag(expected)
        covariance = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
        step = covariance @ (rows.T @ rest)
        values = values + step * units
        left = seen - design @ step
        for part, freed in ((slice(0, 2), 8), (slice(2, 3), 2), (slice(3, 4), 2)):
            freedom = max(left[good, part].size - freed, 1)
            total = float(np.sum(left[good, part] ** 2)) / freedom
            scatter[part] = np.sqrt(max(total - float(own[good, part].mean()), 0.0))
        size = np.sum(np.einsum("nij,nj->ni", root, left) ** 2, axis=1)
        good = size < CUT**2 * max(float(np.median(size)), 1.0)
    covariance = covariance * np.outer(units, units)
    return Straight(values, np.asarray(covariance, np.float64), float(scatter[2:].max()))


def _equations(
    images: Images, kinds: list[Smms], axis: Axis, pixel: float, values: Array
) -> tuple[Array, Array]:
    """Derivatives of (x, y, larger, smaller) of each micro-image by the values, its tilt taken out,
    and what is seen of each beside what is due, shapes (n, 4, values) and (n, 4).
    """
    tilt, radii = values[TILT], values[RADII].reshape(-1, 2)
    straight = axis.straightened(images.centres_px, tilt)
    slopes, each = axis.away(straight), np.arange(len(straight))
    design, due = np.zeros((len(straight), 4, len(values))), np.zeros((len(straight), 4))
    for n in range(2):
        design[:, n, n], design[:, n, 2 + n : 6 : 2] = 1.0, images.indices
        design[:, n, TILT] = -(straight - axis.place_px)[:, n, None] * slopes
        design[each, 2 + n, RADII.start + 2 * images.kind + n] = 1.0
    due[:, :2] = design[:, :2, VECTORS] @ values[VECTORS]
    for k, smms in enumerate(kinds):
        mine = images.kind == k
        rises = slopes[mine] @ tilt
        due[mine, 2:] = discs_at(smms, pixel, radii[k], rises)
        by_rise = (discs_at(smms, pixel, radii[k], rises + NUDGE) - due[mine, 2:]) / NUDGE
        design[mine, 2:, TILT] = by_rise[:, :, None] * slopes[mine, None, :]
    return design, np.concatenate([straight, images.radii_px], axis=1) - due

"""The lattice through measured centres: straight vectors, how it bends, how far micro-images
scatter about it, and how sure all of that is.

The vectors are those of the straight lattice nearest to the centres of all whole micro-images; a
bend is what a polynomial leaves of it. Uncertainties follow how the centres really depart.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.lattice.index import terms
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

HIGHEST = 5  # degree of a bend
CUT = 4.0  # robust deviations beyond which a centre stands off
PER_TERM = 4  # centres that a term of a bend needs
ALIKE = 0.5  # of what may move centres apart, that may move all alike


@dataclass(frozen=True)
class Grid:
    """A lattice; pixels, (x, y).

    Attributes:
        layout: square or hexagonal.
        coefficients: of the smooth map by ``terms``, shape (terms, 2).
        degree: of that map; 1 where nothing bends.
        scale: by which indices are divided in it.
        origin_px: of index (0, 0) on the straight lattice, shape (2,).
        vectors_px: a, b of the straight lattice as columns, shape (2, 2).
        covariance_px: of (origin x, y, a x, y, b x, y), by the centres' departures; shape (6, 6).
        freedom: degrees of freedom of that.
        common_px: covariance of the same by the bend and by how a centre is defined, shape (6, 6).
        residual_px: robust rms of the centres off the smooth map.
        scatter_px: how far micro-images scatter about it, their own uncertainty taken off.
        bend_px: rms of the smooth map off the straight lattice.
        off: which of the centres stand off, shape (n,).
    """

    layout: Layout
    coefficients: Array
    degree: int
    scale: float
    origin_px: Array
    vectors_px: Array
    covariance_px: Array
    freedom: float
    common_px: Array
    residual_px: float
    scatter_px: float
    bend_px: float
    off: Flags

    def centres(self, indices: Whole) -> Array:
        """Where micro-images of these indices lie on the smooth map, px, shape (n, 2)."""
        design = terms(indices.astype(np.float64), self.degree, self.scale)
        return design @ self.coefficients

    def straight(self, indices: Whole) -> Array:
        """The same on the straight lattice."""
        return self.origin_px + indices @ self.vectors_px.T


def grid_through(
    layout: Layout,
    indices: Whole,
    centres: Array,
    doubt: Array,
    places: list[Whole],
    definition: float,
) -> Grid:
    """Fit a lattice to centres.

    Args:
        layout: of the array.
        indices: (i, j) of whole micro-images, shape (n, 2).
        centres: measured, shape (n, 2).
        doubt: standard uncertainty of each coordinate, shape (n, 2).
        places: indices of all that should lie wholly on the picture, found or not: of these the
            straight lattice is the nearest, shape (m, 2); then those of others that might count.
        definition: px by which all centres may lie aside alike, or apart from the middle.
    """
    scale = float(np.abs(indices).max()) + 1.0
    index = indices.astype(np.float64)
    weight = 1 / (np.hypot(*doubt.T) / math.sqrt(2) + 1e-9) ** 2
    good = np.ones(len(centres), dtype=np.bool_)
    degree, coefficients, scatter = 1, np.zeros((3, 2)), 0.0
    for _ in range(4):
        degree, coefficients = _smooth(index, centres, weight, good, scale)
        rest = centres - terms(index, degree, scale) @ coefficients
        own = np.mean(doubt**2, axis=1)
        size = np.hypot(*rest.T)
        # the median of a Rayleigh distribution is 1.18 of its parameter
        limit = CUT * np.sqrt(own + max(float(np.median(size[good]) / 1.18) ** 2, 1e-12)) * 1.3
        good = size < limit
        sure = good & (own <= 4 * np.median(own[good]))
        freedom = max(2 * np.count_nonzero(sure) - 2 * len(coefficients), 1)
        total = float(np.sum(rest[sure] ** 2)) / freedom
        scatter = math.sqrt(max(total - float(own[sure].mean()), 0.0))
        weight = 1 / (own + scatter**2 + 1e-12)
    straight, *others = (
        _straight(one.astype(np.float64), degree, scale, coefficients) for one in places
    )
    rest = centres - terms(index, degree, scale) @ coefficients
    residual = float(np.sqrt(np.sum(rest[good] ** 2) / (2 * max(np.count_nonzero(good), 1))))
    bend = (terms(index, degree, scale) @ coefficients - terms(index, 1, scale) @ straight)[good]
    units = np.repeat([1.0, 1 / scale, 1 / scale], 2)
    covariance = _sureness(terms(index[good], 1, scale), doubt[good], weight[good], scatter)
    apart = [other - straight for other in others]
    common = definition**2 * np.diag([ALIKE**2] * 2 + [scale**-2] * 4)
    for one in apart:
        moved = (one / np.array([1.0, scale, scale])[:, None]).ravel()
        common += np.outer(moved, moved)
    return Grid(
        layout=layout,
        coefficients=coefficients,
        degree=degree,
        scale=scale,
        origin_px=straight[0],
        vectors_px=straight[1:].T / scale,
        covariance_px=covariance * np.outer(units, units),
        freedom=float(max(np.count_nonzero(good) - 3, 1)),
        common_px=common,
        residual_px=residual,
        scatter_px=scatter,
        bend_px=float(np.sqrt(np.mean(bend**2) * 2)),
        off=~good,
    )


def _straight(index: Array, degree: int, scale: float, coefficients: Array) -> Array:
    """The straight lattice nearest to a smooth map at these places."""
    smooth = terms(index, degree, scale) @ coefficients
    return _least_squares(terms(index, 1, scale), smooth, np.ones(len(index)))


def _least_squares(design: Array, seen: Array, weight: Array) -> Array:
    root = np.sqrt(weight)[:, None]
    return np.asarray(np.linalg.lstsq(design * root, seen * root, rcond=None)[0], dtype=np.float64)


def _smooth(
    index: Array, centres: Array, weight: Array, good: Flags, scale: float
) -> tuple[int, Array]:
    """The degree and coefficients that the Bayesian information criterion prefers."""
    count = np.count_nonzero(good)
    best: tuple[float, int, Array] | None = None
    for degree in range(1, HIGHEST + 1):
        design = terms(index, degree, scale)
        if degree > 1 and count < PER_TERM * design.shape[1]:
            break
        found = _least_squares(design, centres, weight * good)
        rest = (centres - design @ found)[good]
        left = float(np.sum(rest**2 * weight[good, None])) + 1e-300
        score = 2 * count * math.log(left) + 2 * design.shape[1] * math.log(2 * count)
        if best is None or score < best[0]:
            best = score, degree, found
    assert best is not None  # noqa: S101
    return best[1], best[2]


def _sureness(design: Array, doubt: Array, weight: Array, scatter: float) -> Array:
    """Covariance of (origin, a, b) of the straight lattice, each centre departing by itself, and
    scale not taken off, shape (6, 6).
    """
    normal = np.linalg.inv((design * weight[:, None]).T @ design)
    covariance = np.zeros((6, 6))
    for axis in range(2):
        variance = doubt[:, axis] ** 2 + scatter**2
        single = (design * (weight**2 * variance)[:, None]).T @ design
        covariance[axis::2, axis::2] = normal @ single @ normal
    return covariance


def by_vectors(layout: Layout, vectors: Array) -> Array:
    """How pitch and angle move with (origin x, y, a x, y, b x, y), shape (2, 6)."""
    pitch, angle = pitch_and_angle(layout, vectors)
    moved = np.zeros((2, 6))
    for n, (row, column) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
        nudged = vectors.copy()
        nudged[row, column] += 1e-4 * pitch
        there = pitch_and_angle(layout, nudged)
        moved[:, 2 + n] = (there[0] - pitch) / (1e-4 * pitch), (there[1] - angle) / (1e-4 * pitch)
    return moved

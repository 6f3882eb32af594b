"""Each micro-image of a white picture by itself: its centre and the radii of its two discs, each with its covariance.

The lattice is one affine map with one profile; what differs from one micro-image to the next, by a tilt of the array above all, is
found here: the lattice's own fit once more on every micro-image, its neighbours held where the lattice has them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.lattice_fit import LatticeModel, Region, refine
from flflab.analysis.lattice_kernels import COUNT
from flflab.analysis.noise import SensorNoise
from flflab.errors import MeasurementError

Array = npt.NDArray[np.float64]

FREE = np.array([0, 1, 6, 7, 8, 9])  # centre, radii, background and light
KEPT = np.array([0, 1, 6, 7])
SMALLEST_PX = 0.05  # radius of a disc: a smaller one cannot be told from it


@dataclass(frozen=True)
class MicroImages:
    """Micro-images whose centres lie on the sensor, one entry each.

    Attributes:
        indices: position (i, j) in the lattice, shape (n, 2).
        centres_px: (x, y), shape (n, 2).
        radii_px: larger and smaller of the two discs, shape (n, 2); their sum is the outside radius, their difference the inside one.
        covariance_px: of (x, y, larger, smaller), shape (n, 4, 4), scaled up by chi^2 a pixel where that is above 1.
    """

    indices: npt.NDArray[np.int64]
    centres_px: Array
    radii_px: Array
    covariance_px: Array


def measure_micro_images(white: npt.NDArray[np.generic], lattice: Lattice, noise: SensorNoise) -> MicroImages:
    """Fit every micro-image whose centre lies on the sensor.

    Args:
        white: DN, [row, col].
        lattice: measured from the same picture.
        noise: of the sensor.

    Raises:
        MeasurementError: fewer than four of them can be fitted.
    """
    picture = np.ascontiguousarray(white, dtype=np.float32)
    size = np.array([picture.shape[1], picture.shape[0]])
    on_sensor = np.flatnonzero(np.all((lattice.centres_px > 0) & (lattice.centres_px < size - 1), axis=1))
    found = list(_fits(picture, lattice, on_sensor, noise))
    if len(found) < 4:
        raise MeasurementError(f"white picture: {len(found)} whole micro-images; at least 4 are due to see how they differ")
    which, models, corners = zip(*found, strict=True)
    values = np.array([model.values for model in models])
    covariance = np.array([model.covariance[np.ix_(KEPT, KEPT)] * max(1.0, model.chi2_per_pixel) for model in models])
    return MicroImages(lattice.indices[list(which)], values[:, :2] + np.array(corners), values[:, 6:8], covariance)


def _fits(
    picture: npt.NDArray[np.float32], lattice: Lattice, which: npt.NDArray[np.int64], noise: SensorNoise
) -> Iterator[tuple[int, LatticeModel, Array]]:
    """The fits that settled, each with the window's top-left corner."""
    half = math.ceil(max(lattice.outside_radius_px + 2, lattice.pitch_px / 2))
    present = np.ones((5, 5), dtype=np.bool_)
    large = (lattice.outside_radius_px + lattice.inside_radius_px) / 2
    small = max(SMALLEST_PX, (lattice.outside_radius_px - lattice.inside_radius_px) / 2)

    def fit(member: int) -> tuple[int, LatticeModel, Array]:
        column, row = np.rint(lattice.centres_px[member]).astype(int)
        left, top = max(0, column - half), max(0, row - half)
        window = np.ascontiguousarray(picture[top : row + half + 1, left : column + half + 1])
        corner = np.array([left, top], dtype=np.float64)
        start = np.zeros(COUNT)
        start[:2] = lattice.centres_px[member] - corner
        start[2:6] = lattice.vectors_px.T.ravel()
        start[6:10] = large, small, lattice.background_dn, lattice.light[0]
        model = LatticeModel(start, np.zeros((COUNT, COUNT)), math.inf)
        return member, refine(window, model, present, noise, Region(2.0 * half, 1), FREE, 8, 1e-3), corner

    for member in which.tolist():
        found = fit(member)
        values, moved = found[1].values, found[1].values[:2] + found[2] - lattice.centres_px[member]
        if np.isfinite(values).all() and np.hypot(*moved) < lattice.pitch_px / 4 and values[9] > 0:
            yield found

"""Distortion of a main lens in image space, in the form of Brown and Conrady."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BrownDistortion:
    """Where the main lens forms the image of a point, away from where a lens without distortion
    would.

    With r^2 = x^2 + y^2 of the undistorted image point, in mm from the axis, the point lies at
    x (1 + A1 r^2 + A2 r^4 + A3 r^6) + B1 (r^2 + 2 x^2) + 2 B2 x y and at
    y (1 + A1 r^2 + A2 r^4 + A3 r^6) + B2 (r^2 + 2 y^2) + 2 B1 x y.
    Source: D. C. Brown, Photogrammetric Engineering 37 (1971), 855.

    Attributes:
        radial: (A1, A2, A3) in 1/mm^2, 1/mm^4, 1/mm^6.
        tangential: (B1, B2) in 1/mm.
    """

    radial: tuple[float, float, float]
    tangential: tuple[float, float] = (0.0, 0.0)

    def displace(self, points: Array) -> Array:
        """The distorted places of undistorted image points, mm, shape (N, 2)."""
        square = np.sum(points**2, axis=1, keepdims=True)
        a1, a2, a3 = self.radial
        b = np.array(self.tangential)
        along = points @ b
        return (
            points * (1 + square * (a1 + square * (a2 + square * a3)))
            + square * b
            + 2 * points * along[:, None]
        )

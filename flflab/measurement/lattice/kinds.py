"""Microlenses of several focal lengths: which stands behind a micro-image, and how much wider its
disc is than the central one's.

The main lens's shadow A b/L is the same for all, the microlens's is d |kappa|, kappa = 1 + b/L -
b/f (physics.md, "One SMMS").
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.measurement.lattice.tilting import Tilting
from flflab.optics.camera import Camera, microlens_centres, microlens_types
from flflab.optics.per_type import type_smms
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Kinds:
    """The kinds of microlenses of a camera.

    Attributes:
        nearest: micro-images where the camera's description has them, px.
        kind: of each of these, shape (n,).
        wider_px: radius of each kind's disc less the central one's, shape (k,).
        focal: f/L of each kind, shape (k,).
    """

    nearest: KDTree
    kind: Whole
    wider_px: Array
    focal: Array

    def of(self, centres_px: Array) -> Whole:
        """Kind of micro-images at these centres, right to less than half a pitch; shape (..., 2) to
        (...).
        """
        return self.kind[self.nearest.query(centres_px)[1]]

    def widened(self, factor: float) -> "Kinds":
        """The same with discs that differ so many times as much: d b/f of the camera built is not
        quite that described.
        """
        return replace(self, wider_px=self.wider_px * factor)

    def radii(self, radii_px: Array, kind: int) -> Array:
        """Larger and smaller disc's radii of a kind from those of the central one, shape (2,)."""
        return radii_px + np.array([0.0, self.wider_px[kind]])

    def tilting(self, tilting: Tilting, kind: int) -> Tilting:
        """What a tilt does to a kind's micro-images, from what it does to the central one's."""
        return replace(tilting, focal=float(self.focal[kind]))

    def discs(self, radii_px: Array, kind: Whole, tilting: Tilting, rises: Array) -> Array:
        """Radii of larger and smaller disc, px, of micro-images of these kinds at these rises, from
        the central one's, shape (n, 2).
        """
        found = np.zeros((len(kind), 2))
        for k in range(len(self.focal)):
            found[kind == k] = self.tilting(tilting, k).discs(
                self.radii(radii_px, k), rises[kind == k]
            )
        return found


def kinds_of(camera: Camera) -> Kinds | None:
    """Those of a camera; None where there is one, or where a kind's disc is larger than the main
    lens's or its image on the other side.
    """
    central, every = central_smms(camera), type_smms(camera)
    alike = all(
        float(one.lens_width) >= float(one.microlens_width)
        and float(one.kappa) * float(central.kappa) > 0
        for one in every
    )
    if len(every) == 1 or not alike:
        return None
    sensor, pixel = camera.sensor, camera.sensor.pixel
    middle = (np.asarray(sensor.resolution) - 1) / 2
    centres = (
        microlens_centres(camera.array) * float(central.image_scale) - np.asarray(sensor.offset)
    ) / pixel + middle
    wider = [float(one.microlens_width - central.microlens_width) / 2 / pixel for one in every]
    focal = [float(one.focal / one.distance) for one in every]
    return Kinds(
        KDTree(centres),
        microlens_types(camera.array).astype(np.int64),
        np.array(wider),
        np.array(focal),
    )

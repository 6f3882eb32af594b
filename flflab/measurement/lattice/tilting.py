"""What a tilt of the microlens array does to the micro-images of a white picture.

A microlens at y lies z = tilt . y further from the main lens and as much nearer to the sensor. With
rise = z / L its micro-image, straight = y (L + b) / L from the axis where there is no tilt, moves
to

    c = y (L + b) / (L + z) = straight / (1 + rise)

(its pitch falls along the tilt by 2 y tilt / L: the centres bend by c (tilt . c) / (L + b)), and
its discs change, the main lens's shadow A b/L and the microlens's d |kappa|, by (physics.md's
boundary rays at L + z, b - z)

    A (b - z) / (L + z)           d |1 + (b - z) / (L + z) - (b - z) / f|

Both are odd or bent along the tilt, so neither is taken for the other nor for the lattice's own
pitch and angle.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tilting:
    """How micro-images depend on a tilt, by a camera's central microlens.

    Attributes:
        axis_px: where the main lens's axis meets the picture, (x, y).
        per_px: rise of a micro-image a px from the axis along a tilt of slope 1: pixel / (L + b).
        gap: b / L.
        focal: f / L.
        microlens_px: radius of a microlens, with the sign of kappa.
        lens_first: whether the main lens's shadow is the larger disc.
    """

    axis_px: tuple[float, float]
    per_px: float
    gap: float
    focal: float
    microlens_px: float
    lens_first: bool

    def rises(self, straight_px: Array, tilt: Array) -> Array:
        """Rise of micro-images that would lie there without a tilt; shape (..., 2) to (...)."""
        return self.per_px * ((straight_px - self.axis_px) @ tilt)

    def centres(self, straight_px: Array, tilt: Array) -> Array:
        """Where they lie, px, shape (..., 2)."""
        return (
            self.axis_px
            + (straight_px - self.axis_px) / (1 + self.rises(straight_px, tilt))[..., None]
        )

    def straightened(self, centres_px: Array, tilt: Array) -> Array:
        """Inverse of ``centres``."""
        return (
            self.axis_px
            + (centres_px - self.axis_px) / (1 - self.rises(centres_px, tilt))[..., None]
        )

    def discs(self, radii_px: Array, rises: Array) -> Array:
        """Radii of the two discs at these rises, px, from those at no rise, the larger disc's
        first; shape (..., 2).
        """
        lens, microlens = radii_px if self.lens_first else radii_px[::-1]
        slope = (self.gap - rises) / (1 + rises)
        shadow = np.abs(microlens + self.microlens_px * (slope - self.gap + rises / self.focal))
        found = lens * slope / self.gap, shadow
        return np.stack(found if self.lens_first else found[::-1], axis=-1)


def tilting_of(camera: Camera) -> Tilting:
    """That of a camera, its array counted as straight."""
    smms = central_smms(camera)
    L, pixel = float(smms.distance), camera.sensor.pixel
    columns, rows = camera.sensor.resolution
    aside = camera.sensor.offset
    return Tilting(
        axis_px=((columns - 1) / 2 - aside[0] / pixel, (rows - 1) / 2 - aside[1] / pixel),
        per_px=pixel / (L + float(smms.gap)),
        gap=float(smms.gap) / L,
        focal=float(smms.focal) / L,
        microlens_px=math.copysign(float(smms.aperture) / 2 / pixel, float(smms.kappa)),
        lens_first=float(smms.lens_width) >= float(smms.microlens_width),
    )

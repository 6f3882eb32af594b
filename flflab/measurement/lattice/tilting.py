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
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """How micro-images lie to a camera's axis.

    Attributes:
        place_px: where the main lens's axis meets the picture, (x, y).
        per_px: rise of a micro-image a px from the axis along a tilt of slope 1, and the slope of
            its middle ray: pixel / (L + b).
    """

    place_px: tuple[float, float]
    per_px: float

    def away(self, places_px: Array) -> Array:
        """Slopes of the middle rays of micro-images at these places, shape (..., 2)."""
        return self.per_px * (places_px - np.asarray(self.place_px))

    def centres(self, straight_px: Array, tilt: Array) -> Array:
        """Where those lie that would lie there without a tilt, px, shape (..., 2)."""
        rises = self.away(straight_px) @ tilt
        return self.place_px + (straight_px - self.place_px) / (1 + rises)[..., None]

    def straightened(self, centres_px: Array, tilt: Array) -> Array:
        """Inverse of ``centres``."""
        falls = self.away(centres_px) @ tilt
        return self.place_px + (centres_px - self.place_px) / (1 - falls)[..., None]


def axis_of(camera: Camera) -> Axis:
    """That of a camera."""
    smms, pixel = central_smms(camera), camera.sensor.pixel
    columns, rows = camera.sensor.resolution
    aside = camera.sensor.offset
    return Axis(
        ((columns - 1) / 2 - aside[0] / pixel, (rows - 1) / 2 - aside[1] / pixel),
        pixel / float(smms.distance + smms.gap),
    )


def discs_at(smms: Smms, pixel: float, radii_px: Array, rises: Array) -> Array:
    """Radii of the two discs of a microlens at these rises, px, from those at no rise, the larger
    disc's first; shape (..., 2).
    """
    lens_first = float(smms.lens_width) >= float(smms.microlens_width)
    lens, microlens = radii_px if lens_first else radii_px[::-1]
    gap, focal = float(smms.gap / smms.distance), float(smms.focal / smms.distance)
    signed = math.copysign(float(smms.aperture) / 2 / pixel, float(smms.kappa))
    slope = (gap - rises) / (1 + rises)
    shadow = np.abs(microlens + signed * (slope - gap + rises / focal))
    found = lens * slope / gap, shadow
    return np.stack(found if lens_first else found[::-1], axis=-1)

"""Whether a picture shows enough light to be measured at all, and not too much of it."""

import math

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import blur_px
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import Target

LIT = 5.0  # standard deviations of a dark pixel
MOST_SATURATED = 0.5  # of all pixels; more leaves nothing between dark and full


def require_light(values: npt.NDArray[np.floating], noise: SensorNoise, target: Target) -> None:
    """Refuse a picture without light or without anything else.

    Raises:
        MeasurementError: see there.
    """
    high = float(np.quantile(values[::2, ::2], 0.9999)) - noise.offset_dn
    high /= math.sqrt(noise.dark_variance)
    if high <= LIT:
        raise MeasurementError(
            f"{target.kind} picture: it is dark, its light rises to {max(high, 0.0):.2g} standard"
            f" deviations of the noise between its pixels, and more than {LIT:g} are due; expose it"
            " longer"
        )
    saturated = float(np.mean(noise.saturated(values)))
    if saturated > MOST_SATURATED:
        raise MeasurementError(
            f"{target.kind} picture: {100 * saturated:.0f} % of its pixels are saturated,"
            f" {100 * MOST_SATURATED:.0f} % are allowed; expose it shorter"
        )


def require_blur_within(lattice: Lattice, camera: Camera, distance: float) -> None:
    """Refuse dots of whose blur no bright field holds any, on a lattice that does not show how
    light falls off: it draws all spots aside.

    Raises:
        MeasurementError: see there.
    """
    blur = blur_px(camera, distance) / 2
    if blur > lattice.inside_radius_px:
        raise MeasurementError(
            f"four-dot picture: no bright field, {lattice.inside_radius_px:.1f} px in radius, holds"
            f" the dots' blur, {blur:.1f} px, and such dots do not show how light falls off in"
            " micro-images, which would change their distance by 2 %; name a picture of a white"
            " target taken alike (--white)"
        )

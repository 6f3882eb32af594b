"""The exact image of a flat target behind round apertures: defocus, vignetting by both apertures, overlap, pixel area.

For each microlens and each pixel its light can reach, the radiance averaged over the pixel is integrated over the part of the
pupil that lights the pixel. Source: physics.md, "Exact image of a flat target".
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.form import add_plane
from flflab.image.setup import make_setup
from flflab.optics.camera import Camera
from flflab.targets import Bars, Black, FourDot, Picture, Target

Array = npt.NDArray[np.float64]

TOLERANCE = 0.002
LEAST_TOLERANCE = 1e-5


def render(
    camera: Camera,
    target: Target,
    distance: float,
    *,
    tolerance: float = TOLERANCE,
    target_offset: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Form the image of a flat target.

    Args:
        camera: the camera, with round apertures.
        target: what stands in front of it.
        distance: main lens to target, mm; at infinity all that has a size in mm is a point and black.
        tolerance: largest error asked for, in units of the white level.
        target_offset: where the target's centre stands, (x, y) mm; without meaning at infinity.

    Returns:
        Irradiance [row, column] in units of the white level: that at the centre of the micro-image nearest the axis under a
        boundless white target, without its neighbours' light.

    Raises:
        InputError: the apertures are not round, a number is impossible, or a tilted array reaches through the sensor.
    """
    _check(camera, distance, tolerance, target_offset)
    columns, rows = camera.sensor.resolution
    image = np.zeros((rows, columns))
    if isinstance(target, Black) or (math.isinf(distance) and isinstance(target, FourDot | Bars | Picture)):
        return image
    add_plane(image, make_setup(camera, distance, tolerance, target_offset), target)
    return image


def _check(camera: Camera, distance: float, tolerance: float, target_offset: tuple[float, float]) -> None:
    if camera.aperture_shape != "round":
        raise InputError(f"render: images are formed for round apertures only, not {camera.aperture_shape}; set aperture_shape: round")
    if math.isnan(distance) or distance <= 0:
        raise InputError(f"render: the target's distance is {distance:g} mm; one above 0, in front of the main lens, or infinity is due")
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(f"render: the tolerance is {tolerance:g}; a share of white from {LEAST_TOLERANCE:g} to below 1 is allowed")
    if not all(math.isfinite(part) for part in target_offset):
        raise InputError(f"render: target_offset is {target_offset}; two finite lengths in mm are due")

"""The exact image of a flat target behind round apertures: defocus, vignetting by both apertures, overlap, pixel area.

For each microlens and each pixel its light can reach, the radiance averaged over the pixel is integrated over the part of the
pupil that lights the pixel. Source: physics.md, "Exact image of a flat target".
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.form import add_plane
from flflab.image.scene import ALL, Scene, without
from flflab.image.setup import make_setup
from flflab.targets import Bars, Black, FourDot, Picture

Array = npt.NDArray[np.float64]

TOLERANCE = 0.002
LEAST_TOLERANCE = 1e-5


def render(
    scene: Scene,
    *,
    tolerance: float = TOLERANCE,
    effects: frozenset[str] = ALL,
    wanted: npt.NDArray[np.bool_] | None = None,
) -> Array:
    """Form the picture of a scene without noise.

    Args:
        scene: camera and targets; what has a size in mm is a point and black at infinity.
        tolerance: largest error asked for, in units of the white level.
        effects: what is formed; an effect that the scene does not have changes nothing.
        wanted: the pixels that matter, [row, column]; the others may hold anything. None for all.

    Returns:
        Irradiance [row, column] in units of the white level: that at the centre of the micro-image nearest the axis under a
        boundless white target, without its neighbours' light.

    Raises:
        InputError: the apertures are not round, a number is impossible, an effect is unknown, or a tilted array reaches through the
            sensor.
    """
    pictured = without(scene, effects)
    columns, rows = pictured.camera.sensor.resolution
    _check(pictured, tolerance, wanted)
    image = np.zeros((rows, columns))
    for plane in pictured.planes:
        target = plane.target
        if not isinstance(target, Black) and (math.isfinite(plane.distance) or not isinstance(target, FourDot | Bars | Picture)):
            add_plane(image, make_setup(pictured, plane, tolerance, effects), target)
    return image


def _check(scene: Scene, tolerance: float, wanted: npt.NDArray[np.bool_] | None) -> None:
    shape = scene.camera.aperture_shape
    if shape != "round":
        raise InputError(f"render: images are formed for round apertures only, not {shape}; set aperture_shape: round")
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(f"render: the tolerance is {tolerance:g}; a share of white from {LEAST_TOLERANCE:g} to below 1 is allowed")
    size = scene.camera.sensor.resolution[::-1]
    if wanted is not None and wanted.shape != size:
        raise InputError(f"render: the wanted pixels are an array of {wanted.shape}; the sensor has {size} rows and columns")

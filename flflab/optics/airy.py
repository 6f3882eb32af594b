"""The Airy disc of a sharp point on the sensor, and what diffraction alone leaves of contrast."""

import math

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera
from flflab.optics.focus import limiting_aperture
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

WAVELENGTH = 550e-6  # mm: green, where no other is stated


def cone_width(camera: Camera, distance: float) -> float:
    """Width of a point's light on the microlens nearest the axis, mm: min(A |x|, d)."""
    smms = central_smms(camera)
    return float(limiting_aperture(smms, 1 / distance) * np.abs(image_offset(smms, 1 / distance)))


def airy_diameter(camera: Camera, distance: float, wavelength: float = WAVELENGTH) -> float:
    """Diameter of the first dark ring of a sharp point on the sensor, mm: 2.44 lambda b / w with w
    the cone's width.
    """
    width = cone_width(camera, distance)
    return 2.44 * wavelength * camera.optical_gap / width if width > 0 else math.inf


def diffraction_contrast(
    camera: Camera, distance: float, cycles_per_px: npt.ArrayLike, wavelength: float = WAVELENGTH
) -> npt.NDArray[np.float64]:
    """Contrast that a perfect round lens leaves: 2/pi (acos s - s sqrt(1 - s^2)), s = frequency
    lambda b / w, 0 from s = 1 on.
    """
    width = cone_width(camera, distance)
    on_sensor = np.abs(np.asarray(cycles_per_px, dtype=np.float64)) / camera.sensor.pixel
    s = (
        np.minimum(on_sensor * wavelength * camera.optical_gap / width, 1.0)
        if width > 0
        else np.ones_like(on_sensor)
    )
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))

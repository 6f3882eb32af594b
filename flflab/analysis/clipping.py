"""How far a defocused spot is off the chief ray where the main lens and the microlens cut each other's cone.

A point's light is the area common to two discs in the main lens: disc(m_c, d/(2|x|)) and disc(0, A/2); it lands at
(kappa x - b/L) m + const. The fit of a spot times the micro-image's illumination shifts the centre already by
(B^2/16) E'/E, B the blur; what is left of the true shift is taken off. In focus all of it is 0.
"""

import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.spots import illumination
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

Array = npt.NDArray[np.float64]

_GRID = 96
_TABLE = 65


def clipping_shift(away_px: Array, lattice: Lattice, camera: Camera, distance: float) -> Array:
    """Vectors in px to take off fitted centres at ``away_px`` from their micro-images' centres, shape (n, 2)."""
    smms = central_smms(camera)
    vergence = 1 / distance
    x, kappa = float(image_offset(smms, vergence)), float(smms.kappa)
    slope, pixel = float(smms.gap / smms.distance), camera.sensor.pixel
    spread = float(blur(smms, vergence)) / pixel
    by_microlens = bool(microlens_limits(smms, vergence))
    r = np.hypot(away_px[:, 0], away_px[:, 1])
    if spread < 1e-3 or x == 0 or len(r) == 0:
        return np.zeros_like(away_px)
    # both discs as the main lens's shadow on the sensor: lengths in the main lens times b/L, in px
    lens, cone = float(smms.lens_width) / 2 / pixel, float(smms.aperture) * slope / (2 * abs(x)) / pixel
    scale = 1.0 if by_microlens else slope / (kappa * x)
    radii = np.linspace(0.0, lattice.outside_radius_px, _TABLE)
    centroid = np.array([_common_centroid(lens, cone, radius * scale) for radius in radii])
    if by_microlens:
        centroid -= radii
    landed = -(kappa * x / slope - 1) * centroid
    light = illumination(lattice, radii)
    applied = spread**2 / 16 * np.gradient(light, radii) / np.maximum(light, 0.05)
    extra = np.interp(r, radii, landed - applied)
    return away_px * (extra / np.maximum(r, 1e-9))[:, None]


def _common_centroid(lens: float, cone: float, offset: float) -> float:
    """Centroid of disc(0, lens) and disc(offset, cone) in common, along the line of centres; the offset where they are apart."""
    low, high = max(-lens, offset - cone), min(lens, offset + cone)
    if high <= low:
        return offset
    along = low + (high - low) * (np.arange(_GRID) + 0.5) / _GRID
    half = np.sqrt(np.maximum(np.minimum(lens**2 - along**2, cone**2 - (along - offset) ** 2), 0.0))
    return float((along * half).sum() / half.sum())

"""How far the fit of a spot is off the chief ray where main lens and microlens cut the cone of a defocused point.

At e from the micro-image's centre the pupil points v with |v| <= microlens disc and |v - e| <= main lens disc see the dot where
|(e - spot) + beta v| <= radius, beta = b / (L x kappa) - 1: an area common to three discs, whose share of the microlens's disc is the
light. The fit takes it for a spot times the micro-image's illumination; what that does is found by fitting such pictures.
From s = kappa q - (b/L) m + (b/f) y and o V = m W - q/L (physics.md, "One SMMS") with v = kappa (q - y).
"""

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.profile import ProfileTable
from flflab.analysis.spot_profile import SpotProfile
from flflab.analysis.spots import Lit, fit_spots
from flflab.optics.camera import Camera
from flflab.optics.discs import three_disc_area, two_disc_area
from flflab.optics.focus import blur, microlens_limits
from flflab.optics.resolution import central_smms
from flflab.optics.smms import image_offset

Array = npt.NDArray[np.float64]

IN_FOCUS_PX = 0.02  # of blur
_PLACES = 25
_LEVEL_DN = 1000.0
_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@numba.njit(cache=True, error_model="numpy")
def _pictures(
    size: int, spots: Array, radius: float, main: float, small: float, beta: float, nodes: Array, weights: Array
) -> npt.NDArray[np.float32]:  # pragma: no cover - compiled
    """Windows of (2 size + 1)^2 px, one above the other, each round a dot seen ``spots`` px along x from its micro-image's centre."""
    width = 2 * size + 1
    picture = np.zeros((len(spots) * width, width), dtype=np.float32)
    whole = np.pi * small * small
    for n in range(len(spots)):
        shift = spots[n] - np.rint(spots[n])
        for row in range(width):
            for column in range(width):
                light = 0.0
                for i in range(len(nodes)):
                    for j in range(len(nodes)):
                        dx, dy = column - size - shift + nodes[i] / 2, row - size + nodes[j] / 2
                        ex = spots[n] + dx
                        if dx * dx + dy * dy > (radius + abs(beta) * small) ** 2:
                            continue
                        if abs(beta) * small > 1e-6:
                            third = radius / abs(beta)
                            area = three_disc_area(0.0, 0.0, small, ex, dy, main, -dx / beta, -dy / beta, third)
                        else:
                            area = two_disc_area(small, main, np.hypot(ex, dy))
                        light += weights[i] * weights[j] / 4 * area / whole
                picture[n * width + row, column] = light
    return picture


def clipping_shift(
    away_px: Array,
    lattice: Lattice,
    camera: Camera,
    distance: float,
    radius: float,
    table: ProfileTable,
    profile: SpotProfile,
    noise: SensorNoise,
) -> Array:
    """Vectors in px to take off fitted centres at ``away_px`` from their micro-images' centres, shape (n, 2).

    Args:
        away_px: shape (n, 2).
        lattice: measured.
        camera: nominal.
        distance: to the dots, mm, nominal.
        radius: of a spot in focus, px.
        table: the illumination that the fit assumed.
        profile: the spot that it assumed.
        noise: by which it weighted.
    """
    smms = central_smms(camera)
    x, kappa = float(image_offset(smms, 1 / distance)), float(smms.kappa)
    spread = float(blur(smms, 1 / distance)) / camera.sensor.pixel
    r = np.hypot(away_px[:, 0], away_px[:, 1])
    if len(r) == 0:
        return np.zeros_like(away_px)
    outwards = away_px / np.maximum(r, 1e-9)[:, None]
    if spread < IN_FOCUS_PX or x == 0 or kappa == 0:
        # a pixel on the edge of the spot is lit on its inner side, where the micro-image is brighter than in the pixel's middle
        light = table.values[:, 0]
        falls = np.interp(r / table.step, np.arange(len(light)), -np.gradient(light, table.step) / np.maximum(light, 0.05))
        return outwards * (falls / 12)[:, None]
    beta = float(smms.gap / smms.distance) / (x * kappa) - 1
    large, small = (lattice.outside_radius_px + lattice.inside_radius_px) / 2, (lattice.outside_radius_px - lattice.inside_radius_px) / 2
    main, microlens = (large, small) if smms.lens_width >= smms.microlens_width else (small, large)
    half = int(np.ceil(radius + spread / 2 + 3))
    first = max(0.0, min(abs(large - small) - half, float(r.max())))
    spots = np.linspace(first, max(first + 1e-3, min(float(r.max()), lattice.outside_radius_px)), _PLACES)
    by_chief = 1.0 if bool(microlens_limits(smms, 1 / distance)) else 1 + beta
    size = half + 2
    picture = _pictures(size, spots * by_chief, radius, main, max(microlens, 1e-3), beta, _GAUSS, _WEIGHTS) * _LEVEL_DN + noise.offset_dn
    middles: Array = np.stack([size + spots - np.rint(spots), size + np.arange(_PLACES) * (2.0 * size + 1)], axis=1).astype(np.float64)
    own = Lit(middles - np.stack([spots, np.zeros(_PLACES)], axis=1), np.full(_PLACES, _LEVEL_DN), table)
    found = fit_spots(picture, middles, half, own, profile, noise)
    extra = np.interp(r, spots, found.centres[:, 0] - middles[:, 0])
    return outwards * extra[:, None]

"""The lattice of micro-images from a picture of dots, where there is no white one.

Within its edge a dot is as white as a white target: there the illumination of the micro-image can be read. The fit of the white
picture is made on these pixels alone, from the camera's nominal lattice, and what they leave open stays nominal.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice, half_counts, lattice_of
from flflab.analysis.lattice_fit import LatticeModel, Region, refine
from flflab.analysis.lattice_kernels import COUNT
from flflab.analysis.noise import SensorNoise
from flflab.analysis.spot_search import SeenSpots, find_spots
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

EDGE_PX = 1.5  # of a spot that is not looked at, beside its blur
LOOSE_PX = 20.0  # standard deviations of the nominal lattice: origin
LOOSE_PITCH = 2e-3  # of the pitch
LOOSE_RADIUS_PX = 1.0
LOOSE_LIGHT = 0.05  # each of the terms by which the light may vary over the picture, relative
FREE = np.concatenate([np.arange(8), np.arange(9, 15)])


def lattice_from_dots(
    picture: npt.NDArray[np.generic], nominal: Lattice, camera: Camera, target: FourDot, distance: float, noise: SensorNoise
) -> Lattice:
    """Measure the lattice in a picture of dots.

    Args:
        picture: DN, [row, col].
        nominal: the camera's lattice, right to a few pixels; its light need not be.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: no dot found where the camera puts some.
    """
    values = np.ascontiguousarray(picture, dtype=np.float32)
    seen = find_spots(values, nominal, camera, target, distance, noise)
    plain = _plain(values, seen, noise)
    bright = seen.spots.brightness[seen.spots.brightness > 0.05]
    light = float(nominal.light[0]) * (float(np.quantile(bright, 0.75)) if len(bright) else 1.0)
    large, small = (nominal.outside_radius_px + nominal.inside_radius_px) / 2, (nominal.outside_radius_px - nominal.inside_radius_px) / 2
    values_of = np.zeros(COUNT)
    values_of[:2], values_of[2:6] = nominal.origin_px, nominal.vectors_px.T.ravel()
    values_of[6:10] = large, small, noise.offset_dn, light
    spread = np.ones(COUNT)
    spread[:2], spread[2:6], spread[6:8] = LOOSE_PX, LOOSE_PITCH * nominal.pitch_px, LOOSE_RADIUS_PX
    spread[9], spread[10:15] = light, LOOSE_LIGHT * light
    model = LatticeModel(values_of, np.zeros((COUNT, COUNT)), math.inf, None, np.stack([values_of, spread]))
    counts = half_counts(nominal.vectors_px, plain.shape, nominal.outside_radius_px + 2)
    present = np.ones((2 * counts[0] + 1, 2 * counts[1] + 1), dtype=np.bool_)
    model = refine(plain, model, present, noise, Region(max(plain.shape) / 2 + 1, 1), FREE, 12, 1e-3)
    return lattice_of(model, nominal.layout, present, (plain.shape[0], plain.shape[1]))


def _plain(values: npt.NDArray[np.float32], seen: SeenSpots, noise: SensorNoise) -> npt.NDArray[np.float32]:
    """The picture within the spots; all else saturated, which the fit leaves out."""
    plain = np.full(values.shape, noise.full_scale_dn, dtype=np.float32)
    radius = seen.radius - seen.spread / 2 - EDGE_PX
    sure = np.isfinite(seen.spots.covariance[:, 0, 0]) & (np.sqrt(np.abs(seen.spots.covariance[:, 0, 0])) < 0.3)
    for x, y in seen.spots.centres[sure]:
        top, left = max(0, math.ceil(y - radius)), max(0, math.ceil(x - radius))
        window = np.s_[top : math.floor(y + radius) + 1, left : math.floor(x + radius) + 1]
        rows, columns = np.ogrid[window]
        inside = np.hypot(columns[:, : plain[window].shape[1]] - x, rows[: plain[window].shape[0]] - y) <= radius
        plain[window] = np.where(inside, values[window], plain[window])
    return plain

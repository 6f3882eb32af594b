"""The lattice of micro-images from the parts of a picture in which the target is plain white, where
there is no white picture.

There the illumination of the micro-images can be read. The fit of the white picture is made on
these pixels alone, from the camera's nominal lattice, and what they leave open stays nominal.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.fit import Region, finish, refine
from flflab.measurement.lattice.kernels import COUNT
from flflab.measurement.lattice.model import RATE, SHARE, SLANT, WIDER, LatticeModel
from flflab.measurement.lattice.profile import Cone
from flflab.measurement.lattice.white import Lattice, half_counts, lattice_of
from flflab.measurement.sensor.noise import SensorNoise

LOOSE_PX = 20.0  # standard deviations of the nominal lattice: origin
LOOSE_PITCH = 2e-3  # of the pitch
LOOSE_RADIUS_PX = 1.0
LOOSE_LIGHT = 0.05  # each of the terms by which the light may vary over the picture, relative
LIKELY = 5.0  # of those, within which fall-off counts as found
SURE = 4.0  # standard uncertainties below half of it, from which there is none
LOOSE_SLANT = 0.01  # of the ray to the lattice's origin
FREE = np.concatenate([np.arange(8), np.arange(9, 15)])
FALLING = np.concatenate(
    [FREE, np.arange(SHARE, RATE + 1)]
)  # where light falls off within a micro-image


def lattice_within(
    plain: npt.NDArray[np.float32],
    nominal: Lattice,
    light: float,
    noise: SensorNoise,
    cone: Cone | None,
) -> Lattice:
    """Measure the lattice on the pixels that are not saturated.

    Args:
        plain: DN, [row, col]; at full scale wherever the target is not plain white.
        nominal: the camera's lattice, right to a few pixels.
        light: of white, DN above the background, roughly.
        noise: of the sensor.
        cone: how rays land, from the camera's description; None leaves fall-off out, as in
            ``find_lattice``.
    """
    values = np.zeros(COUNT)
    values[:2], values[2:6] = nominal.origin_px, nominal.vectors_px.T.ravel()
    large, small = (
        (nominal.outside_radius_px + nominal.inside_radius_px) / 2,
        (nominal.outside_radius_px - nominal.inside_radius_px) / 2,
    )
    values[6:10], values[WIDER] = (large, small, noise.offset_dn, light), 1.0
    spread = np.ones(COUNT)
    spread[:2], spread[2:6], spread[6:8] = LOOSE_PX, LOOSE_PITCH * nominal.pitch_px, LOOSE_RADIUS_PX
    spread[9], spread[10:15] = light, LOOSE_LIGHT * light
    model = LatticeModel(
        values, np.zeros((COUNT, COUNT)), math.inf, None, np.stack([values, spread])
    )
    counts = half_counts(nominal.vectors_px, plain.shape, nominal.outside_radius_px + 2)
    present = np.ones((2 * counts[0] + 1, 2 * counts[1] + 1), dtype=np.bool_)
    region = Region(max(plain.shape) / 2 + 1, 1)
    model = refine(plain, model, present, noise, region, FREE, 12, 1e-3)
    if cone is not None:
        # that of rays which come straight from the main lens's middle: expected halfway to none, it
        # would be drawn there
        values, spread = values.copy(), spread.copy()
        values[[SHARE, RATE]] = spread[[SHARE, RATE]] = 1.0, cone.tilting.per_px
        spread[SLANT] = LOOSE_SLANT
        begun = np.where(np.isin(np.arange(COUNT), FREE), model.values, values)
        falling = LatticeModel(
            begun,
            np.zeros((COUNT, COUNT)),
            math.inf,
            cone,
            np.stack([values, spread]),
            nominal.kinds,
        )
        falling = refine(plain, falling, present, noise, region, FALLING, 12, 1e-3)
        # a few small dots leave it open, and the fit goes astray
        likely = bool(np.all(np.abs(falling.values - values)[FALLING] < LIKELY * spread[FALLING]))
        # where there is none, how it grows over the picture would be anything's guess, and the
        # pitch with it
        there = falling.values[SHARE] + SURE * math.sqrt(falling.covariance[SHARE, SHARE]) > 0.5
        if likely and there and falling.chi2_per_pixel <= model.chi2_per_pixel:
            model = falling
    # the profiles till then are coarse
    model = finish(plain, model, present, noise, region, FREE if model.cone is None else FALLING)
    return lattice_of(model, nominal.layout, present, (plain.shape[0], plain.shape[1]))

"""How far out a micro-image is lit: where the illumination falls to a share of the full light.

Round apertures: area common to two discs; square ones, whose sides lie along the sensor's: the
product of two ramps. Lengths in mm. Source: paper, "Chief rays and useful chief rays", Fig. 3.
"""

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import ApertureShape, Camera
from flflab.optics.overlap import common_area, common_chord
from flflab.optics.smms import Smms, row_illumination

Array = npt.NDArray[np.float64]

# Units in the last place, and steps: where so many do not do halving takes over.
BEYOND, MOST_NEWTON = 2.0, 16


def illumination_radius(smms: Smms, share: float) -> Array:
    """Radius at which the round illumination falls to ``share``, mm, to the last bit; the outside
    radius for 0.

    The area common to two discs falls by the chord that they share for each unit that their centres
    move apart, so that Newton's steps find it; each ends a little beyond, which closes in from both
    sides, and halves what is left where it would leave that.
    """
    if share == 0:
        return smms.outside_radius
    widths = np.stack(np.broadcast_arrays(smms.lens_width, smms.microlens_width), axis=-1)
    kinds, kind = np.unique(widths.reshape(-1, 2), axis=0, return_inverse=True)
    lens, microlens = kinds.T / 2
    wanted = share * np.pi * np.minimum(lens, microlens) ** 2
    low, high = np.abs(lens - microlens), lens + microlens
    apart, steps = low + (high - low) / 2, 0
    while np.any(np.nextafter(low, high) < high):
        more = common_area(lens, microlens, apart) - wanted
        low, high = (
            np.where(more >= 0, apart, low),
            np.where(more >= 0, high, np.where(apart > low, apart, low)),
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            chord = common_chord(lens, microlens, apart)
            beyond = BEYOND * (np.spacing(apart) + np.spacing(wanted) / chord)
            further = apart + more / chord + np.copysign(beyond, more)
        apart, steps = low + (high - low) / 2, steps + 1
        if steps < MOST_NEWTON:
            apart = np.where((further > low) & (further < high), further, apart)
    return low[kind].reshape(widths.shape[:-1])


def edge_radius(smms: Smms, share: float, shape: ApertureShape) -> Array:
    """Where the illumination falls to ``share`` on the way out along an axis, mm: radius (round),
    half width (square apertures).
    """
    if shape == "round":
        return illumination_radius(smms, share)
    return smms.outside_radius - share * np.minimum(smms.lens_width, smms.microlens_width)


def useful_radii(smms: Smms, camera: Camera) -> tuple[Array, Array]:
    """How far out each micro-image is useful, and how far out it forbids others, by the camera's
    rules; see ``edge_radius``.
    """
    rules, shape = camera.useful, camera.aperture_shape
    return edge_radius(smms, rules.minimum_illumination, shape), edge_radius(
        smms, rules.maximum_crosstalk, shape
    )


def surely_blocked(smms: Smms, camera: Camera) -> Array:
    """Distance within which a micro-image's light forbids others in every direction, mm."""
    share = camera.useful.maximum_crosstalk
    # Beside an axis the light of square apertures is a product of two ramps.
    return edge_radius(
        smms, share if camera.aperture_shape == "round" else share**0.5, camera.aperture_shape
    )


def square_illumination(smms: Smms, away: Array, margin: Array) -> Array:
    """Relative illumination of square apertures at ``away`` (x, y), each coordinate first moved by
    ``margin`` but not past the centre.
    """
    moved = np.maximum(np.abs(away) + margin[:, None], 0.0)
    return row_illumination(smms, moved[:, 0]) * row_illumination(smms, moved[:, 1])

"""How natural fall-off draws bars out of focus aside, within a bright field and each frequency by
its own way.

A pixel's rays land at slopes sigma - g t, sigma its middle ray's, t the place in the pupil from -1
to 1 and g the cone's half angle, and bring (1 + slope^2)^-2 of their light: over its mean 1 + 4 g
sigma . t to first order, besides what ``dimming_disc_transfer`` knows. They look at x + (B / 2) t,
B the disc of blur on the target, signed as the defocus. Light t over a disc is -1/4 of the slope of
light (1 - t^2) over it, so a pixel sees of bars g sigma B / 2 times their slope through that disc
besides: not quite the slope of what it sees.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.data import ChirpData
from flflab.measurement.contrast.fit import ChirpFit, ChirpModel, strength_of
from flflab.measurement.contrast.search import Frame
from flflab.measurement.contrast.template import dimming_slope_at
from flflab.measurement.lattice.falloff import slants_of
from flflab.optics.contrast import cone_half_angle
from flflab.optics.focus import signed_blur

Array = npt.NDArray[np.float64]


def drawn_aside(frame: Frame, data: ChirpData, model: ChirpModel, fit: ChirpFit) -> Array:
    """What every run reads more because fall-off draws bars aside, DN, shape (n,); 0 where the
    lattice knows no fall-off.
    """
    lattice, vergence = frame.lattice, 1 / frame.distance
    if lattice.cone is None:
        return np.zeros(len(data.read))
    beside = (
        float(lattice.slants[0])
        * lattice.cone.by_place
        / frame.camera.sensor.pixel
        * data.places[:, 1]
    )
    slope = slants_of(lattice)[data.lens, 0] + beside
    disc = math.copysign(model.template.blur, float(signed_blur(frame.smms, vergence)))
    slopes = _slopes(
        data.seen_at(fit.geometry),
        model.law,
        model.edges,
        model.template.pixel,
        model.template.blur,
    )
    drawn = slope * float(cone_half_angle(frame.smms, vergence)) * disc / 2 * slopes
    return strength_of(model, fit) * (data.light @ fit.brightness) * drawn


@numba.njit(nogil=True, cache=True)
def _slopes(
    x: Array, law: tuple[float, float, float], edges: Array, pixel: float, disc: float
) -> Array:  # pragma: no cover - compiled
    slopes = np.zeros(len(x))
    for n in range(len(x)):
        along = x[n] - law[2]
        slopes[n] = dimming_slope_at(
            x[n], along * (law[0] + law[1] * along / 2), edges, pixel, disc
        )
    return slopes

"""How much light reaches each micro-image: marginal angle and irradiance against the sensor's
position, and how they fall off.

The marginal angle is a plane angle and falls as cos^2 of the field angle phi = atan(y/L) (for a
slender cone); the irradiance of the same cone falls as cos^4: the paper's "cos^4" is right for the
second. Lengths in mm, angles in rad. Source: paper, "Marginal angles", Figs. 8 and 9.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera
from flflab.optics.focus import marginal_angle
from flflab.optics.smms import Smms, camera_smms, row_illumination
from flflab.optics.useful import row_members, select

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Brightness:
    """Of every microlens of the row nearest the axis, for every position of the sensor.

    Attributes:
        sensor_distance: main lens to sensor, shape (S,), mm.
        centre: microlens centres along the row, shape (N,), mm.
        marginal_angle: full plane angle of the cone on the micro-image's centre, shape (S, N), rad.
        irradiance: share of the irradiance under a full hemisphere, shape (S, N).
    """

    sensor_distance: Array
    centre: Array
    marginal_angle: Array
    irradiance: Array


def limiting_half_width(smms: Smms) -> Array:
    """Half width, at the microlens, of the cone onto the micro-image's centre, mm: g = min(d, w_m /
    |kappa|) / 2.
    """
    with np.errstate(divide="ignore"):
        return np.minimum(smms.aperture, smms.lens_width / np.abs(smms.kappa)) / 2


def irradiance(smms: Smms) -> Array:
    """Irradiance of the cone onto each micro-image's centre, as a share of a full hemisphere's.

    E = (1 - (b^2 + t^2 - g^2) / sqrt((b^2 + t^2 - g^2)^2 + 4 b^2 g^2)) / 2 with t = y b/L, written
    without the cancellation of 1 - 1.
    """
    b, g = smms.gap, limiting_half_width(smms)
    t = np.hypot(smms.centre_x, smms.centre_y) * b / smms.distance
    near = b * b + (t - g) * (t + g)
    root = np.hypot(near, 2 * b * g)
    return np.where(
        near > 0, 2 * (b * g) ** 2 / (root * (root + np.maximum(near, 0.0))), (1 - near / root) / 2
    )


def vignetted_angle(smms: Smms, offset: Array | float) -> Array:
    """Marginal angle at ``offset`` mm from the micro-image's centre: times the relative
    illumination of the row (the paper's way).
    """
    return marginal_angle(smms) * row_illumination(smms, np.asarray(offset, dtype=np.float64))


def brightness(camera: Camera, sensor_distances: Array) -> Brightness:
    """Marginal angle and irradiance of every microlens of the row against the sensor's position
    (the paper's Fig. 9).

    Args:
        camera: the camera; its own sensor distance is not used.
        sensor_distances: main lens to sensor, shape (S,), mm, all behind the array.

    Raises:
        InputError: a position lies in front of the array.
    """
    members = row_members(camera)
    angles: list[Array] = []
    shares: list[Array] = []
    for distance in sensor_distances:
        smms = select(
            camera_smms(replace(camera, sensor=replace(camera.sensor, distance=float(distance)))),
            members,
        )
        angles.append(marginal_angle(smms))
        shares.append(irradiance(smms))
    centre = select(camera_smms(camera), members).centre_x
    return Brightness(
        np.asarray(sensor_distances, dtype=np.float64), centre, np.stack(angles), np.stack(shares)
    )


def fall_exponents(smms: Smms) -> tuple[Array, Array]:
    """Exponents n of cos^n phi near the axis for marginal angle and irradiance, closed forms with r
    = g/b.

    2 r / (atan(r) (1 + r^2)^2) and 4 / (1 + r^2)^2.
    """
    r = limiting_half_width(smms) / smms.gap
    return 2 * r / (np.arctan(r) * (1 + r * r) ** 2), 4 / (1 + r * r) ** 2


def fitted_exponent(phi: Array, value: Array) -> float:
    """Exponent n of value ~ cos^n phi in the limit of small phi: least squares of the logarithms
    with a term in phi^4 beside.

    Args:
        phi: field angles, shape (n,), rad; at least three, one of them 0 or near it.
        value: what falls off, shape (n,).
    """
    terms = np.stack([np.ones_like(phi), np.log(np.cos(phi)), np.log(np.cos(phi)) ** 2], axis=1)
    return float(np.linalg.lstsq(terms, np.log(value), rcond=None)[0][1])

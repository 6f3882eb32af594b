"""Where a microlens shows a dot: the centroid of its light on the sensor, and how much light it is.

A point of the target whose ray through the main lens's centre crosses the array at t reaches the
sensor through the point p of the microlens (from its centre y) at

    s - c = kappa p - (b/L) m,   m = (p - (t - y)) / x

from the micro-image's centre c, m being where the ray crosses the main lens, x the image offset
(physics.md, "One SMMS"). Light passes where |p| is within the microlens and |m| within the main
lens's stop: two discs on the array, whose common area, centroid and second moments are closed
forms. Rays that land at a slope s bring (1 + s^2)^-2 of the light. A dot is the mean over its
points. Defocus, cut spots, fall-off and a main lens that limits are all in these lines; diffraction
moves no centroid.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import microlens_type_of, sensor_position
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# points that stand for a dot: half as many move cut spots by a tenth of a pixel where it is as
# wide as they
RINGS, TURNS = 8, 28
LEAST = 1e-9  # of the image offset, at which the target's image lies on the array


@dataclass(frozen=True)
class Microlenses:
    """The microlens behind each micro-image in question; lengths in mm, one entry each.

    Attributes:
        centres: of the micro-images on the sensor, shape (n, 2).
        rise: by how much each lies further from the main lens, as a share of ``distance``.
        kappa_apart: what is added to kappa: another focus than the camera's.
        focal: of each microlens.
        distance: main lens to array, on the axis.
        gap: array to sensor, on the axis.
        lens_focal: of the main lens.
        stop: radius of the main lens's stop.
        radius: of a microlens.
        falloff: share of natural fall-off that counts.
        camera: whose distortion counts.
    """

    centres: Array
    rise: Array
    kappa_apart: Array
    focal: Array
    distance: float
    gap: float
    lens_focal: float
    stop: float
    radius: float
    falloff: float
    camera: Camera

    def those(self, which: Whole) -> "Microlenses":
        """Some of them, or some several times."""
        return replace(
            self,
            centres=self.centres[which],
            rise=self.rise[which],
            kappa_apart=self.kappa_apart[which],
            focal=self.focal[which],
        )

    def refocused(self, focus: float) -> "Microlenses":
        """The same of another kappa."""
        return replace(self, kappa_apart=self.kappa_apart + focus)


def microlenses_of(lattice: Lattice, camera: Camera) -> Microlenses:
    """Those of all micro-images of a lattice, the main lens's stop as wide as its shadow there."""
    smms = central_smms(camera)
    sign = 1.0 if float(smms.lens_width) >= float(smms.microlens_width) else -1.0
    shadow = (lattice.outside_radius_px + sign * lattice.inside_radius_px) / 2
    falloff = 0.0 if lattice.cone is None else float(np.clip(lattice.slants[0], 0.0, 1.0))
    return Microlenses(
        sensor_position(camera.sensor, lattice.centres_px),
        lattice.rises,
        np.zeros(len(lattice.centres_px)),
        np.asarray(microlens_type_of(lattice, camera), dtype=np.float64),
        float(smms.distance),
        float(smms.gap),
        float(smms.lens_focal),
        shadow * camera.sensor.pixel * float(smms.distance / smms.gap),
        float(smms.aperture) / 2,
        falloff,
        camera,
    )


@dataclass(frozen=True)
class Shown:
    """What microlenses show of dots, one entry a pair of both.

    Attributes:
        centroid: of the light on the sensor, from the micro-image's centre, mm, shape (n, 2).
        chief: where the ray through the centre of the limiting stop lands, the same way.
        light: over that of a whole dot on the axis, shape (n,).
        pupil: mean place on the microlens through which the light came, mm, shape (n, 2).
    """

    centroid: Array
    chief: Array
    light: Array
    pupil: Array


def shown(lenses: Microlenses, angles: Array, vergences: Array, size: float) -> Shown:
    """What microlenses show of a dot each.

    Args:
        lenses: n of them.
        angles: (x, y) of the dot times its vergence, rad, shape (n, 2).
        vergences: 1 over its distance, 1/mm, shape (n,).
        size: diameter of a dot times its vergence, rad.
    """
    away = lenses.distance * (1 + lenses.rise)
    gap = lenses.gap - lenses.distance * lenses.rise
    x = away * (vergences - 1 / lenses.lens_focal) + 1
    x = np.where(np.abs(x) < LEAST, LEAST, x)
    kappa = 1 + gap / away - gap / lenses.focal + lenses.kappa_apart
    y = lenses.centres * (away / (lenses.distance + lenses.gap))[:, None]
    t = _at_array(angles, vergences, lenses.camera) * away[:, None]
    points, weights = _disc_points()
    apart = (t - y)[:, None] + points * (size / 2 * away)[:, None, None]
    shadow = lenses.stop * np.abs(x)
    area, middle, along, across, turn = _common(lenses.radius, shadow[:, None], apart)
    per_p, per_t = (kappa - gap / away / x)[:, None, None], (gap / away / x)[:, None, None]
    landing = per_p * middle + per_t * apart
    # slopes at the sensor, and how light falls with them over the common area, to second order
    slope = (landing + lenses.centres[:, None] - y[:, None] - middle) / gap[:, None, None]
    steep, by_p = 1 + (slope**2).sum(axis=2), (per_p - 1) / gap[:, None, None]
    spread = _turned(slope, turn, along, across)
    pull = -4 * lenses.falloff * by_p / steep[..., None] * spread
    curved = 12 * (slope * spread).sum(axis=2) / steep - 2 * (along + across)
    left = (1 + by_p[..., 0] ** 2 * curved / steep) / steep**2
    light = weights * area * (1 + lenses.falloff * (left - 1))
    share = (light / np.maximum(light.sum(axis=1), 1e-300)[:, None])[..., None]
    by_stop = (shadow < lenses.radius)[:, None]
    return Shown(
        (share * (landing + per_p * pull)).sum(axis=1),
        np.where(by_stop, kappa[:, None] * (t - y), per_t[:, 0] * (t - y)),
        light.sum(axis=1) / (np.pi * np.minimum(lenses.radius, shadow) ** 2),
        (share * (middle + pull)).sum(axis=1),
    )


def _at_array(angles: Array, vergences: Array, camera: Camera) -> Array:
    """Slope of the ray from the main lens's centre to the dot's image, shape (n, 2)."""
    distortion = camera.main_lens.distortion
    if distortion is None:
        return -angles
    image = 1 / np.maximum(1 / camera.main_lens.focal_length - vergences, LEAST)
    return distortion.displace(-angles * image[:, None]) / image[:, None]


def _disc_points() -> tuple[Array, Array]:
    """Points in the unit disc, shape (k, 2), and their weights, of sum 1."""
    nodes, weights = np.polynomial.legendre.leggauss(RINGS)
    radii = np.sqrt((1 + nodes) / 2)
    turns = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    points = radii[:, None, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    return points.reshape(-1, 2), np.repeat(weights / 2 / TURNS, TURNS)


def _common(radius: float, shadow: Array, apart: Array) -> tuple[Array, Array, Array, Array, Array]:
    """What a disc round 0 shares with one round ``apart``.

    Args:
        radius: of the one.
        shadow: radius of the other, shape (n, 1).
        apart: shape (n, k, 2).

    Returns:
        Area (n, k); centroid (n, k, 2); variances along and across ``apart`` (n, k); its direction
        (n, k, 2).
    """
    r = np.maximum(np.hypot(apart[..., 0], apart[..., 1]), 1e-12)
    chord = (r * r + radius * radius - shadow * shadow) / (2 * r)
    own = _cap(radius, np.arccos(np.clip(chord / radius, -1.0, 1.0)))
    other = _cap(shadow, np.arccos(np.clip((r - chord) / shadow, -1.0, 1.0)))
    area = own[0] + other[0]
    some = np.maximum(area, 1e-300)
    # from 0 along apart: the other cap looks back from r
    mean = (own[1] + r * other[0] - other[1]) / some
    square = (own[2] + r * r * other[0] - 2 * r * other[1] + other[2]) / some
    turn = apart / r[..., None]
    along, across = np.maximum(square - mean**2, 0.0), (own[3] + other[3]) / some
    return area, mean[..., None] * turn, along, across, turn


def _cap(radius: Array | float, angle: Array) -> tuple[Array, Array, Array, Array]:
    """Area, first and second moment along, second moment across, of the cap of a disc within
    ``angle`` of an axis.
    """
    sin, cos = np.sin(angle), np.cos(angle)
    square, segment, cube = radius * radius, angle - sin * cos, sin**3
    return (
        square * segment,
        2 / 3 * square * radius * cube,
        square * square / 4 * (segment + 2 * cube * cos),
        square * square / 4 * (segment - 2 / 3 * cube * cos),
    )


def _turned(slope: Array, turn: Array, along: Array, across: Array) -> Array:
    """Covariance (along and across ``turn``) times ``slope``."""
    part = (slope * turn).sum(axis=2)[..., None] * turn
    return along[..., None] * part + across[..., None] * (slope - part)

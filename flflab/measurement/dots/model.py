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

import math
from dataclasses import dataclass, replace

import numba
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


def _disc_points() -> tuple[Array, Array]:
    """Points in the unit disc, shape (k, 2), and their weights, of sum 1."""
    nodes, weights = np.polynomial.legendre.leggauss(RINGS)
    radii = np.sqrt((1 + nodes) / 2)
    turns = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    points = radii[:, None, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    return points.reshape(-1, 2), np.repeat(weights / 2 / TURNS, TURNS)


POINTS, WEIGHTS = _disc_points()


@dataclass(frozen=True)
class Microlenses:
    """The microlens behind each micro-image in question; lengths in mm, one entry each.

    Attributes:
        centres: of the micro-images on the sensor, shape (n, 2).
        rise: by how much each lies further from the main lens, as a share of the array's distance.
        focal: of each microlens.
        stop: radius of the main lens's stop.
        falloff: share of natural fall-off that counts.
        camera: whose central system counts for all else.
        focus: by how much kappa differs from that of focal length and gap.
    """

    centres: Array
    rise: Array
    focal: Array
    stop: float
    falloff: float
    camera: Camera
    focus: float = 0.0

    def those(self, which: Whole) -> "Microlenses":
        """Some of them, or some several times."""
        centres, rise, focal = self.centres[which], self.rise[which], self.focal[which]
        return replace(self, centres=centres, rise=rise, focal=focal)


def microlenses_of(lattice: Lattice, camera: Camera) -> Microlenses:
    """Those of all micro-images of a lattice, the main lens's stop as wide as its shadow there."""
    smms = central_smms(camera)
    sign = 1.0 if float(smms.lens_width) >= float(smms.microlens_width) else -1.0
    shadow = (lattice.outside_radius_px + sign * lattice.inside_radius_px) / 2
    return Microlenses(
        sensor_position(camera.sensor, lattice.centres_px),
        lattice.rises,
        np.asarray(microlens_type_of(lattice, camera), dtype=np.float64),
        shadow * camera.sensor.pixel * float(smms.distance / smms.gap),
        lattice.fall_off,
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

    def those(self, which: npt.NDArray[np.bool_]) -> "Shown":
        """Some of them."""
        return Shown(self.centroid[which], self.chief[which], self.light[which], self.pupil[which])


def shown(lenses: Microlenses, angles: Array, vergences: Array, size: float) -> Shown:
    """What microlenses show of a dot each.

    Args:
        lenses: n of them.
        angles: (x, y) of the dot times its vergence, rad, shape (n, 2).
        vergences: 1 over its distance, 1/mm, shape (n,).
        size: diameter of a dot times its vergence, rad.
    """
    smms = central_smms(lenses.camera)
    distance, radius = float(smms.distance), float(smms.aperture) / 2
    away, gap = distance * (1 + lenses.rise), float(smms.gap) - distance * lenses.rise
    x = away * (vergences - 1 / float(smms.lens_focal)) + 1
    x = np.where(np.abs(x) < LEAST, LEAST, x)
    kappa = 1 + gap / away - gap / lenses.focal + lenses.focus
    y = lenses.centres * (away / (away + gap))[:, None]
    apart = _at_array(angles, vergences, lenses.camera) * away[:, None] - y
    shadow, by_angle = lenses.stop * np.abs(x), gap / away / x
    spots = np.stack([*apart.T, *(lenses.centres - y).T, shadow, by_angle, kappa, gap, away], 1)
    found = _formed(spots, radius, lenses.falloff, size / 2, POINTS, WEIGHTS)
    return Shown(
        found[:, :2],
        np.where(shadow < radius, kappa, by_angle)[:, None] * apart,
        found[:, 4] / (np.pi * np.minimum(radius, shadow) ** 2),
        found[:, 2:4],
    )


def shown_pairs(
    every: Microlenses, values: Array, size: float, least: float
) -> tuple[tuple[Whole, Whole], Shown]:
    """The pairs of a dot and a microlens that shows more than ``least`` of its light, and what it
    shows.

    Args:
        every: all microlenses.
        values: (x, y) of each dot times its vergence, rad, and that, 1/mm, shape (dots, 3).
        size: diameter of a dot times its vergence, rad.
        least: of a whole dot's light.

    Returns:
        Numbers of dots and of microlenses, each of shape (n,), and what these show.
    """
    lens, dot = (
        grid.ravel()
        for grid in np.meshgrid(np.arange(len(every.rise)), np.arange(len(values)), indexing="ij")
    )
    found = shown(every.those(lens), values[dot, :2], values[dot, 2], size)
    lit = found.light > least
    return (dot[lit], lens[lit]), found.those(lit)


def _at_array(angles: Array, vergences: Array, camera: Camera) -> Array:
    """Slope of the ray from the main lens's centre to the dot's image, shape (n, 2)."""
    distortion = camera.main_lens.distortion
    if distortion is None:
        return -angles
    image = 1 / np.maximum(1 / camera.main_lens.focal_length - vergences, LEAST)
    return distortion.displace(-angles * image[:, None]) / image[:, None]


@numba.njit(cache=True, error_model="numpy")
def _formed(
    spots: Array, radius: float, falloff: float, half: float, points: Array, weights: Array
) -> Array:
    """Centroid (x, y), mean place on the microlens (x, y) and light of each spot, shape (n, 5).

    Args:
        spots: a row each: t - y (x, y), c - y (x, y), radius of the main lens's shadow, b/(L x),
            kappa, gap, distance to the main lens; shape (n, 9).
        radius: of a microlens.
        falloff: share of natural fall-off that counts.
        half: radius of a dot times its vergence, rad.
        points: of a dot of radius 1, shape (k, 2).
        weights: of these, shape (k,).
    """
    found = np.zeros((len(spots), 5))
    for n in range(len(spots)):
        t_x, t_y, c_x, c_y, shadow, by_angle, kappa, gap, away = spots[n]
        per_p, by_p = kappa - by_angle, (kappa - by_angle - 1) / gap
        out, sums = half * away, found[n]
        if math.hypot(t_x, t_y) - out > radius + shadow:
            continue
        for k in range(len(points)):
            at_x, at_y = t_x + out * points[k, 0], t_y + out * points[k, 1]
            r = max(math.hypot(at_x, at_y), 1e-12)
            area, mean, along, across = _common(radius, shadow, r)
            if area <= 0:
                continue
            p_x, p_y = mean * at_x / r, mean * at_y / r
            land_x, land_y = per_p * p_x + by_angle * at_x, per_p * p_y + by_angle * at_y
            # slopes at the sensor, and how light falls with them over the common area
            slope_x, slope_y = (land_x + c_x - p_x) / gap, (land_y + c_y - p_y) / gap
            steep = 1 + slope_x * slope_x + slope_y * slope_y
            radial = (along - across) * (slope_x * at_x + slope_y * at_y) / (r * r)
            spread_x, spread_y = across * slope_x + radial * at_x, across * slope_y + radial * at_y
            pull = -4 * falloff * by_p / steep
            pull_x, pull_y = pull * spread_x, pull * spread_y
            curved = 12 * (slope_x * spread_x + slope_y * spread_y) / steep - 2 * (along + across)
            left = (1 + by_p * by_p * curved / steep) / steep**2
            light = weights[k] * area * (1 + falloff * (left - 1))
            sums[0] += light * (land_x + per_p * pull_x)
            sums[1] += light * (land_y + per_p * pull_y)
            sums[2] += light * (p_x + pull_x)
            sums[3] += light * (p_y + pull_y)
            sums[4] += light
        sums[:4] /= max(sums[4], 1e-300)
    return found


@numba.njit(cache=True, error_model="numpy")
def _common(radius: float, shadow: float, r: float) -> tuple[float, float, float, float]:
    """Area, centroid from 0, and variances along and across, of what a disc round 0 shares with
    one of radius ``shadow`` round r.
    """
    chord = (r * r + radius * radius - shadow * shadow) / (2 * r)
    area, one, two, across = _cap(radius, chord / radius)
    area_2, one_2, two_2, across_2 = _cap(shadow, (r - chord) / shadow)
    whole = area + area_2
    some = max(whole, 1e-300)
    # from 0 along apart: the other cap looks back from r
    mean = (one + r * area_2 - one_2) / some
    square = (two + r * r * area_2 - 2 * r * one_2 + two_2) / some
    return whole, mean, max(square - mean * mean, 0.0), (across + across_2) / some


@numba.njit(cache=True, error_model="numpy")
def _cap(radius: float, cos: float) -> tuple[float, float, float, float]:
    """Area, first and second moment along, second moment across, of the cap of a disc beyond
    ``cos`` of its radius.
    """
    cos = min(max(cos, -1.0), 1.0)
    angle, sin = math.acos(cos), math.sqrt(1 - cos * cos)
    square, segment, cube = radius * radius, angle - sin * cos, sin**3
    return (
        square * segment,
        2 / 3 * square * radius * cube,
        square * square / 4 * (segment + 2 * cube * cos),
        square * square / 4 * (segment - 2 / 3 * cube * cos),
    )

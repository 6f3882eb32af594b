"""Where to look for the dots of a picture: where the nominal camera puts them, or, where none is
there, where the spots say.
"""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.dots.blind import CLOSE_PX, FAINT, blind_pose, darkness_of, spots_in
from flflab.measurement.dots.pose import Pose, candidates_near, places
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import blur_px, target_scales
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

WIDEST_SHIFT_PX = 30.0  # how far all dots together may be from where the nominal camera puts them
NEAR_PX = 8.0  # how far each may then still be
THERE = 0.9  # of light and spots: with less agreement dots are looked for everywhere
LEAST = 0.5  # the same: less is none
HALF = 0.5  # of the light: so well lit a place says whether a dot is there


def where_to_look(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> Pose:
    """The pose by which spots are looked for.

    It is the nominal one, moved sideways by up to 30 px. Where less than ``THERE`` of the light due
    is where that puts it, or of the spots seen where spots are due, they are matched blindly, and
    the pose that agrees better with the picture is taken.

    Raises:
        MeasurementError: target at infinity, or light is due and the better of the two agrees with
            less than ``LEAST``.
    """
    across, _ = target_scales(camera, distance)
    pose, found = _moved(values, Pose(distance), lattice, camera, target, noise, WIDEST_SHIFT_PX)
    spots = spots_in(values, target.diameter / 2 / abs(across) / camera.sensor.pixel, noise)
    agreed = _agreed(found, spots, pose, lattice, camera, target)
    if agreed >= THERE:
        return pose
    blind = blind_pose(spots, lattice, camera, target, distance)
    if blind is not None:
        there, found_there = _moved(values, blind, lattice, camera, target, noise, CLOSE_PX)
        if _agreed(found_there, spots, there, lattice, camera, target) > max(agreed, LEAST):
            return there
    if found is not None and agreed < LEAST:
        raise MeasurementError(
            f"four-dot picture: no pattern of dots {target.spacing:g} mm apart found:"
            f" {100 * agreed:.0f} % of the expected light is there ({100 * LEAST:.0f} % needed);"
            " check exposure, distance, and the target's spacing"
        )
    return pose


def _agreed(
    found: float | None,
    spots: Array,
    pose: Pose,
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
) -> float:
    """The lesser of the shares of the light due that is found (``found``), and of the spots seen
    that are due.
    """
    near = candidates_near(pose, lattice, camera, target, NEAR_PX)
    due = places(pose, near, lattice, camera, target)
    if len(spots) == 0 or len(due) == 0:
        return 0.0
    off = spots - due[KDTree(due).query(spots)[1]]
    # all may be off together by the pose's coarse shift, and each by what its micro-image cuts of
    # its blur
    reach = NEAR_PX + blur_px(camera, pose.distance) / 2
    good = np.hypot(*(off - np.median(off, axis=0)).T) < reach
    return min(found or 0.0, float(good.mean()))


def _moved(
    values: npt.NDArray[Any],
    pose: Pose,
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    noise: SensorNoise,
    widest_px: float,
) -> tuple[Pose, float | None]:
    """The pose moved by the common shift that puts most well lit places of dots on light, and the
    share found of the light due there.

    The shift goes in steps of half a radius; the share is None where no light is due.
    """
    columns, rows = camera.sensor.resolution
    across, along = target_scales(camera, pose.distance)
    size = 1 / abs(across) / camera.sensor.pixel
    radius = target.diameter / 2 * size
    step = max(1.0, radius / 2)
    # beyond half a parallax from one micro-image to the next, one dot would be taken for another
    # view of it
    parallax = abs(1 - along / across) * lattice.pitch_px
    most = int(min(widest_px, 0.4 * parallax, 0.4 * target.spacing * size) / step)
    every = candidates_near(pose, lattice, camera, target, most * step)
    centres = lattice.centres_px[every.lens]
    steps = np.arange(-most, most + 1)
    i, j = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    due = places(pose, every, lattice, camera, target)
    moved = due[None] + step * np.stack([i, j], axis=1)[:, None]
    at = np.rint(moved).astype(np.int64)
    seen = np.all((at >= 0) & (at < [columns, rows]), axis=2)
    light = _box_means(values, at, seen, int(radius / 2)) - noise.offset_dn
    light[~seen] = 0.0
    dark = darkness_of(values) - noise.offset_dn
    bright = (
        max(float(np.quantile(light[seen], 0.98)) - dark, FAINT * math.sqrt(noise.dark_variance))
        if seen.any()
        else 1.0
    )
    share = _illumination(lattice, np.hypot(*np.moveaxis(moved - centres[None], 2, 0))) * seen
    lit = np.where(share > HALF, share, 0.0)
    found = np.minimum(np.clip((light - dark) / bright, 0, None), lit).sum(axis=1)
    # light where the dots should be counts for, its absence against; the nearest of equals wins
    best = int(np.argmax(found - 0.5 * lit.sum(axis=1) - 1e-3 * np.hypot(i, j)))
    there = float(found[best] / lit[best].sum()) if lit[best].any() else None
    return pose.moved(step * complex(i[best], j[best]) * camera.sensor.pixel), there


def _box_means(
    values: npt.NDArray[Any], at: npt.NDArray[np.int64], seen: npt.NDArray[np.bool_], half: int
) -> Array:
    """Means of squares of (2 half + 1)^2 px round places; 0 where these are not seen."""
    means = np.zeros(seen.shape)
    if seen.any():
        low = np.maximum(at[seen].min(axis=0) - half - 1, 0)
        high = at[seen].max(axis=0) + half + 2
        part = np.ascontiguousarray(values[low[1] : high[1], low[0] : high[0]], dtype=np.float32)
        side = 2 * half + 1
        smooth = cv2.blur(part, (side, side), borderType=cv2.BORDER_REPLICATE)
        x, y = (at[seen] - low).T
        means[seen] = smooth[y, x]
    return means


def _illumination(lattice: Lattice, distance: Array) -> Array:
    """Roughly the illumination at distances in px from the centre of a micro-image, 1 inside."""
    ends = [
        lattice.inside_radius_px,
        max(lattice.outside_radius_px, lattice.inside_radius_px + 0.1),
    ]
    return np.interp(distance, ends, [1.0, 0.0])

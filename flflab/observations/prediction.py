"""What a camera's model says of points of a board: where their views land, how many there are, and
their virtual depth.

The poses of a published set may be turned against its camera by one rotation common to all frames;
that rotation is fitted, and nothing else.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from flflab.errors import InputError
from flflab.observations.points import SeenPoints
from flflab.observations.reading import Array, Numbers
from flflab.optics.camera import Camera
from flflab.optics.focus import virtual_depth
from flflab.optics.smms import Smms, camera_smms
from flflab.optics.useful import select, sensor_fields
from flflab.optics.views import chief_crossings, chief_view_indices


@dataclass(frozen=True)
class Alignment:
    """Points turned by the one rotation that brings them closest to where they were seen.

    Attributes:
        rotation: vector about the world's x, y, z, rad, shape (3,).
        uncertainty: of it, the larger of what the residuals say and of how it changes where one
            frame is left out (jackknife), shape (3,).
        position: (x, y, D) of every point after it, mm, shape (P, 3).
        residual: measured less predicted place of each view on the sensor, mm, shape (K, 2).
    """

    rotation: Array
    uncertainty: Array
    position: Array
    residual: Array

    def tilt(self, normal: Array) -> float:
        """Angle between the axis and a normal that is turned with the points, rad."""
        along = abs(float(Rotation.from_rotvec(self.rotation).apply(normal)[2]))
        return math.acos(min(along, 1.0))

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, one coordinate, mm."""
        return float(np.sqrt(np.mean(self.residual**2)))


@dataclass(frozen=True)
class PredictedPoints:
    """Number of chief views and mean virtual depth over each point's microlenses; shape (P,)."""

    views: Numbers
    virtual_depth: Array


def align(camera: Camera, seen: SeenPoints) -> Alignment:
    """Fit the one rotation of all poses by least squares of the views' places on the sensor."""
    smms = select(camera_smms(camera), seen.microlens)

    every = np.arange(len(seen.owner))

    def residuals(turn: Array, views: Numbers) -> Array:
        position = Rotation.from_rotvec(turn).apply(seen.position)[seen.owner[views]]
        return seen.landing[views] - landing_points(camera, select(smms, views), position)

    def fit(start: Array, views: Numbers) -> OptimizeResult:
        return least_squares(lambda turn: residuals(turn, views).ravel(), start, x_scale=0.01)

    found = fit(np.zeros(3), every)
    best = np.asarray(found.x)
    variance = 2 * found.cost / max(len(found.fun) - 3, 1)
    uncertainty = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * variance)
    frames = np.unique(seen.frame)
    if len(frames) > 1:
        of = seen.frame[seen.owner]
        without = [fit(best, np.flatnonzero(of != frame)).x for frame in frames]
        jackknife = np.sqrt((len(frames) - 1) * np.var(without, axis=0))
        uncertainty = np.maximum(uncertainty, jackknife)
    return Alignment(
        best, uncertainty, Rotation.from_rotvec(best).apply(seen.position), residuals(best, every)
    )


def image_angles(camera: Camera, position: Array) -> Array:
    """o V of object points, distortion of the main lens included, shape (N, 2).

    The image point lies at -o V D', D' behind the lens; distortion moves it there, which is as if
    the object point lay under another angle.

    Raises:
        InputError: the lens distorts and a point lies within its focal length.
    """
    angle = position[:, :2] / position[:, 2:]
    bent = camera.main_lens.distortion
    if bent is None:
        return angle
    focal = camera.main_lens.focal_length
    if position[:, 2].min() <= focal:
        raise InputError(
            f"observations: a point lies {position[:, 2].min():.4g} mm in front of the lens; with"
            f" main_lens.distortion more than the focal length, {focal:.4g} mm, is due"
        )
    behind = 1 / (1 / focal - 1 / position[:, 2:])
    return -bent.displace(-angle * behind) / behind


def landing_points(camera: Camera, smms: Smms, position: Array) -> Array:
    """Where the chief ray of each object point through its microlens lands, mm, shape (N, 2)."""
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    return chief_crossings(smms, 1 / position[:, 2], image_angles(camera, position), centre)[2]


def predict_points(camera: Camera, seen: SeenPoints, position: Array) -> PredictedPoints:
    """Chief views and virtual depth of points at (x, y, D), shape (P, 3)."""
    vergence = 1 / position[:, 2]
    fields = sensor_fields(camera)
    views = np.array(
        [
            len(chief_view_indices(fields, float(v), angle))
            for v, angle in zip(vergence, image_angles(camera, position), strict=True)
        ]
    )
    return PredictedPoints(views, predict_depth(camera, seen, position))


def predict_depth(camera: Camera, seen: SeenPoints, position: Array) -> Array:
    """Mean virtual depth of points at (x, y, D) over the microlenses that saw each, shape (P,)."""
    smms = select(camera_smms(camera), seen.microlens)
    depth = virtual_depth(smms, 1 / position[seen.owner, 2])
    return np.bincount(seen.owner, depth) / np.bincount(seen.owner)

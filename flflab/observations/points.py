"""Points of a board as a camera saw them, measured and predicted: number of views, and virtual
depth from parallax.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.observations.reading import Array, Numbers, Observations
from flflab.optics.camera import Camera, pixel_positions
from flflab.optics.focus import virtual_depth
from flflab.optics.smms import camera_smms
from flflab.optics.useful import select, sensor_fields
from flflab.optics.views import chief_crossings, chief_view_indices


@dataclass(frozen=True)
class SeenPoints:
    """What was measured; P points (one per frame and point of the board), K views.

    Attributes:
        frame: shape (P,).
        point: number on the board, shape (P,).
        position: (x, y, D) in the world, mm, shape (P, 3); the origin of x and y is free in each
            frame.
        views: measured number of views, shape (P,).
        owner: point each view belongs to, shape (K,).
        microlens: position of each view's microlens in the camera's list, shape (K,).
        array_position: mean (x, y) of each point's microlenses, mm, shape (P, 2).
        landing: (x, y) of each view on the sensor, mm, shape (K, 2).
        slope: parallax slope of sensor position over microlens position, shape (P,); nan for fewer
            than two views.
        slope_uncertainty: its standard uncertainty, shape (P,).
    """

    frame: Numbers
    point: Numbers
    position: Array
    views: Numbers
    owner: Numbers
    microlens: Numbers
    array_position: Array
    landing: Array
    slope: Array
    slope_uncertainty: Array

    @property
    def virtual_depth(self) -> Array:
        """Virtual depth from the parallax: 1 / |slope - 1|, as the slope is 1 - 1/v (Galilean) or 1
        + 1/v (Keplerian).
        """
        with np.errstate(divide="ignore"):
            return 1 / np.abs(self.slope - 1)

    @property
    def with_parallax(self) -> npt.NDArray[np.bool_]:
        """Points whose parallax slope is known, shape (P,)."""
        return np.isfinite(self.slope) & np.isfinite(self.slope_uncertainty)


@dataclass(frozen=True)
class PredictedPoints:
    """What a camera's model says of the same points.

    Attributes:
        views: number of chief views, shape (P,).
        virtual_depth: mean over each point's microlenses, shape (P,).
        offset: fitted lateral origin (x, y) of each point's frame, mm, shape (P, 2).
        residual: measured less predicted position of each view on the sensor, mm, shape (K, 2).
    """

    views: Numbers
    virtual_depth: Array
    offset: Array
    residual: Array


def measure_points(observations: Observations, camera: Camera) -> SeenPoints:
    """Bring observations onto the camera's array and sensor, and take the parallax slope of every
    point.

    The slope is the least-squares line through the views of one point, one slope for x and y, all
    views of equal weight (the files give no uncertainties). Its uncertainty comes from the
    residuals, pooled over the points of a frame: a point seen four times has too few of its own.

    Raises:
        InputError: a microlens or a pixel that the camera does not have.
    """
    _check_inside(observations, camera)
    _, first, owner = np.unique(
        observations.frame * len(observations.board.corners()) + observations.point,
        return_index=True,
        return_inverse=True,
    )
    frame, point = observations.frame[first], observations.point[first]
    corners = observations.board.corners()
    position = np.array(
        [
            observations.poses[int(f)].positions(corners[p])
            for f, p in zip(frame, point, strict=True)
        ]
    )
    _check_in_front(observations, frame, point, position)
    microlens = observations.microlens[:, 0] + observations.microlens[:, 1] * camera.array.count[0]
    smms = camera_smms(camera)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)[microlens]
    x, y = pixel_positions(camera.sensor)
    landing = np.array([x[0], y[0]]) + observations.pixel * camera.sensor.pixel
    views = np.bincount(owner)
    array_position = _mean(centre, owner)
    slope, uncertainty = _slopes(
        centre - array_position[owner], landing - _mean(landing, owner)[owner], owner, frame
    )
    return SeenPoints(
        frame, point, position, views, owner, microlens, array_position, landing, slope, uncertainty
    )


def predict_points(camera: Camera, seen: SeenPoints) -> PredictedPoints:
    """Chief views and virtual depth of the same points by the model of a camera.

    The lateral origin of each frame is fitted first: two offsets by least squares of predicted
    against measured positions on the sensor, on which the landing point of a chief ray depends
    linearly.
    """
    smms = camera_smms(camera)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)
    vergence = 1 / seen.position[:, 2]
    landing, per_mm = np.empty_like(seen.landing), np.empty(len(seen.owner))
    depth = np.empty(len(seen.owner))
    order = np.argsort(seen.owner, kind="stable")
    for number, members in enumerate(np.split(order, np.cumsum(seen.views)[:-1])):
        seeing, v = select(smms, seen.microlens[members]), float(vergence[number])
        angle, places = seen.position[number, :2] * v, centre[seen.microlens[members]]
        _, _, landing[members] = chief_crossings(seeing, v, angle, places)
        per_mm[members] = (chief_crossings(seeing, v, angle + v, places)[2] - landing[members])[
            :, 0
        ]
        depth[members] = virtual_depth(seeing, v)
    offset = np.empty((len(seen.frame), 2))
    residual = seen.landing - landing
    for frame in np.unique(seen.frame):
        members = seen.frame[seen.owner] == frame
        slope = per_mm[members][:, None]
        fitted = np.sum(slope * residual[members], axis=0) / np.sum(slope**2)
        offset[seen.frame == frame] = fitted
        residual[members] -= slope * fitted
    fields = sensor_fields(camera)
    angles = (seen.position[:, :2] + offset) * vergence[:, None]
    views = np.array(
        [
            len(chief_view_indices(fields, float(v), angle))
            for v, angle in zip(vergence, angles, strict=True)
        ]
    )
    return PredictedPoints(views, _mean(depth[:, None], seen.owner)[:, 0], offset, residual)


def _mean(values: Array, owner: Numbers) -> Array:
    """Mean over the views of each point, shape (P, k)."""
    return (
        np.stack([np.bincount(owner, column) for column in values.T], axis=1)
        / np.bincount(owner)[:, None]
    )


def _slopes(across: Array, landed: Array, owner: Numbers, frame: Numbers) -> tuple[Array, Array]:
    """Slope of ``landed`` over ``across`` (both less their means) of each point, and its standard
    uncertainty.
    """
    spread = np.bincount(owner, np.sum(across**2, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.bincount(owner, np.sum(across * landed, axis=1)) / spread
    squares = np.bincount(
        owner, np.sum((landed - np.nan_to_num(slope)[owner, None] * across) ** 2, axis=1)
    )
    freedom = np.maximum(
        2 * np.bincount(owner) - 3, 0
    )  # two coordinates a view, less two means and a slope
    variance = np.full(len(frame), np.nan)
    for number in np.unique(frame):
        members = (frame == number) & (freedom > 0)
        if freedom[members].sum() > 0:
            variance[frame == number] = squares[members].sum() / freedom[members].sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0, slope, np.nan), np.where(
            spread > 0, np.sqrt(variance / spread), np.nan
        )


def _check_inside(observations: Observations, camera: Camera) -> None:
    file = observations.folder / "observations.csv"
    for name, given, count, unit in (
        ("k", observations.microlens[:, 0], camera.array.count[0], "columns of microlenses"),
        ("l", observations.microlens[:, 1], camera.array.count[1], "rows of microlenses"),
        ("u", observations.pixel[:, 0], camera.sensor.resolution[0], "columns of pixels"),
        ("v", observations.pixel[:, 1], camera.sensor.resolution[1], "rows of pixels"),
    ):
        outside = (given < -0.5) | (given > count - 0.5)
        if outside.any():
            raise InputError(
                f"{file}: {name}: {given[outside][0]:g} lies outside this camera, which has {count}"
                f" {unit}, 0 to {count - 1}; give the camera that took these pictures"
            )


def _check_in_front(
    observations: Observations, frame: Numbers, point: Numbers, position: Array
) -> None:
    behind = position[:, 2] <= 0
    if behind.any():
        raise InputError(
            f"{observations.folder / 'poses.json'}: {frame[behind][0]}: point {point[behind][0]} of"
            f" the board lies {position[behind][0, 2]:.4g} mm in front of the lens; a distance"
            " above 0 mm is due"
        )

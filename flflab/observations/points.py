"""Points of a board as a camera saw them: number of views, landing points, and virtual depth from
parallax.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.observations.reading import Array, Numbers, Observations
from flflab.optics.camera import Camera, pixel_positions
from flflab.optics.smms import camera_smms

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SeenPoints:
    """What was measured; P points (one per frame and point of the board), K views.

    Attributes:
        frame: shape (P,).
        point: number on the board, shape (P,).
        position: (x, y, D) in the world by the poses as published, mm, shape (P, 3).
        views: measured number of views, shape (P,).
        owner: point each view belongs to, shape (K,).
        microlens: position of each view's microlens in the camera's list, shape (K,).
        landing: (x, y) of each view on the sensor, mm, shape (K, 2).
        from_centre: distance of each view from the centre of its micro-image, mm, shape (K,).
        beyond_field: whether it lies outside the total field of its micro-image, shape (K,).
    """

    frame: Numbers
    point: Numbers
    position: Array
    views: Numbers
    owner: Numbers
    microlens: Numbers
    landing: Array
    from_centre: Array
    beyond_field: Flags


@dataclass(frozen=True)
class Parallax:
    """Parallax of P points: sensor position over microlens position through the views of each.

    Attributes:
        slope: shape (P,); nan for fewer than two views.
        uncertainty: its standard uncertainty, shape (P,).
        array_position: mean (x, y) of each point's microlenses, mm, shape (P, 2).
    """

    slope: Array
    uncertainty: Array
    array_position: Array

    @property
    def virtual_depth(self) -> Array:
        """Virtual depth: 1 / |slope - 1|, as the slope is 1 - 1/v (Galilean) or 1 + 1/v
        (Keplerian).
        """
        with np.errstate(divide="ignore"):
            return 1 / np.abs(self.slope - 1)

    @property
    def known(self) -> Flags:
        """Points whose slope is known, shape (P,)."""
        return np.isfinite(self.slope) & np.isfinite(self.uncertainty)


def measure_points(observations: Observations, camera: Camera) -> SeenPoints:
    """Bring observations onto the camera's array and sensor.

    Raises:
        InputError: a microlens or a pixel that the camera does not have, or a board behind the
            lens.
    """
    _check_inside(observations, camera)
    corners = observations.board.corners()
    _, first, owner = np.unique(
        observations.frame * len(corners) + observations.point,
        return_index=True,
        return_inverse=True,
    )
    frame, point = observations.frame[first], observations.point[first]
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
    from_centre = np.linalg.norm(landing - smms.image_scale[microlens, None] * centre, axis=1)
    return SeenPoints(
        frame,
        point,
        position,
        np.bincount(owner),
        owner,
        microlens,
        landing,
        from_centre,
        from_centre > smms.outside_radius[microlens],
    )


def measure_parallax(seen: SeenPoints, camera: Camera, within: float = np.inf) -> Parallax:
    """The parallax slope of every point: the least-squares line through its views, one slope for x
    and y, all views of equal weight (the files give no uncertainties).

    The uncertainty comes from the residuals, pooled over the points of a frame: a point seen four
    times has too few of its own.

    Args:
        seen: the points.
        camera: whose microlenses saw them.
        within: only views at most so far from the centre of their micro-image count, mm.
    """
    kept = seen.from_centre <= within
    owner, landing = seen.owner[kept], seen.landing[kept]
    smms = camera_smms(camera)
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1)[seen.microlens[kept]]
    place = _mean(centre, owner, len(seen.frame))
    across = centre - place[owner]
    landed = landing - _mean(landing, owner, len(seen.frame))[owner]
    slope, uncertainty = _slopes(across, landed, owner, seen.frame)
    return Parallax(slope, uncertainty, place)


def _mean(values: Array, owner: Numbers, points: int) -> Array:
    """Mean over the views of each point, shape (points, k); nan where it has none."""
    sums = [np.bincount(owner, column, points) for column in values.T]
    with np.errstate(invalid="ignore"):
        return np.stack(sums, axis=1) / np.bincount(owner, minlength=points)[:, None]


def _slopes(across: Array, landed: Array, owner: Numbers, frame: Numbers) -> tuple[Array, Array]:
    """Slope of ``landed`` over ``across`` (both less their means) of each point, and its standard
    uncertainty.
    """
    points = len(frame)
    spread = np.bincount(owner, np.sum(across**2, axis=1), points)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.bincount(owner, np.sum(across * landed, axis=1), points) / spread
    squares = np.bincount(
        owner, np.sum((landed - np.nan_to_num(slope)[owner, None] * across) ** 2, axis=1), points
    )
    # two coordinates a view, less two means and a slope
    freedom = np.maximum(2 * np.bincount(owner, minlength=points) - 3, 0)
    variance = np.full(points, np.nan)
    for number in np.unique(frame):
        members = (frame == number) & (freedom > 0)
        if freedom[members].sum() > 0:
            variance[frame == number] = squares[members].sum() / freedom[members].sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        return slope, np.sqrt(variance / spread)


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

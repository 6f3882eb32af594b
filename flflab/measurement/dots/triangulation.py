"""Where in space a dot stands, from the places of its images in several micro-images."""

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import sensor_position
from flflab.optics.camera import Camera
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]


def triangulate(
    centres_px: Array,
    uncertainty_px: Array,
    together_px: Array,
    lens: npt.NDArray[np.int64],
    lattice: Lattice,
    camera: Camera,
    distance: float,
) -> tuple[Array, Array, Array]:
    """World position (x, y, z) in mm of a dot seen at ``centres_px``, and its standard
    uncertainties from those of centres and lattice.

    The ray through microlens Q's centre meets the sensor at s = (1 + b/L - b/(L x)) Q - o V b/x.
    With x = L V + 1 - L/F and c = (1 + b/L) Q the micro-image's centre this is linear in the
    vergence and in the angle o V: (s - c) L V + b (o V) = -b c/(L + b) - (s - c)(1 - L/F). The
    camera counts as known; behind a tilted array each microlens has its own L and b, by the tilt
    that the lattice shows, of the same sum.

    Args:
        centres_px: where the dot is seen, shape (n, 2).
        uncertainty_px: of each in x and in y by itself, shape (n, 2).
        together_px: how all of them move with a standard deviation along either axis of focus and
            dots' radius, shape (n, 2, 2).
        lens: position of each micro-image in the lattice, shape (n,).
        lattice: the micro-images.
        camera: nominal.
        distance: nominal, mm; says only which stop limits and how errors grow.

    Returns:
        Position, uncertainties, and how the position moves with a standard uncertainty of each
        thing that other dots share: the focus, the lattice's six numbers, what of them centres
        follow, two of the tilt; shape (3, 16). nan for fewer than two views, or where the main lens
        limits: then all views look along one ray.
    """
    nowhere, alike = np.full(3, np.nan), np.full((3, 16), np.nan)
    smms = central_smms(camera)
    if len(centres_px) < 2 or not bool(microlens_limits(smms, 1 / distance)):
        return nowhere, nowhere, alike
    L, b, F = float(smms.distance), float(smms.gap), float(smms.lens_focal)
    c = sensor_position(camera.sensor, lattice.centres_px[lens])
    L_each, b_each = (
        (L * (1 + lattice.rises[lens]))[:, None],
        (b - L * lattice.rises[lens])[:, None],
    )
    away = sensor_position(camera.sensor, centres_px) - c
    x = L / distance + 1 - L / F
    design = np.zeros((len(lens), 2, 3))
    design[:, :, 0] = away * L_each
    design[:, 0, 1] = design[:, 1, 2] = b_each[:, 0]
    right = -b_each * c / (L + b) - away * (1 - L_each / F)
    scatter = uncertainty_px.reshape(-1) * camera.sensor.pixel * x
    if lattice.doubts_px is not None:
        own = lattice.doubts_px[lens] * camera.sensor.pixel * _by_centre(x, camera)
        scatter = np.hypot(scatter, np.repeat(own, 2))
    together = together_px.reshape(-1, 2) * camera.sensor.pixel * x
    spread = np.sqrt(scatter**2 + (together**2).sum(axis=1))
    rows, values = design.reshape(-1, 3) / spread[:, None], right.reshape(-1) / spread
    scale = np.sqrt((rows**2).sum(axis=0))
    normal = (rows / scale).T @ (rows / scale)
    if np.linalg.cond(normal) > 1e12:
        return nowhere, nowhere, alike
    inverse = np.linalg.inv(normal)
    best = inverse @ ((rows / scale).T @ values)
    gains = (rows / scale) @ inverse / spread[:, None]
    tilt = _from_tilt(gains, away * (x - 1 + L * x / b), lattice, lens)
    common = np.concatenate(
        [gains.T @ together, _from_lattice(gains, lattice, lens, camera, x), tilt], axis=1
    )
    vergence, angle_x, angle_y = best / scale
    far = 1 / vergence
    # world: x = (o V)/V, y likewise, z = -1/V
    jacobian = np.array(
        [[-angle_x * far**2, far, 0.0], [-angle_y * far**2, 0.0, far], [far**2, 0.0, 0.0]]
    )
    position = np.array([angle_x * far, angle_y * far, -far])
    common, alone = (
        jacobian @ (common / scale[:, None]),
        jacobian @ (gains.T * scatter / scale[:, None]),
    )
    return position, np.sqrt((common**2).sum(axis=1) + (alone**2).sum(axis=1)), common


def departures_px(
    position: Array,
    centres_px: Array,
    lens: npt.NDArray[np.int64],
    lattice: Lattice,
    camera: Camera,
) -> Array:
    """How far images of a dot at ``position`` lie from where it is due, px, shape (n, 2)."""
    smms = central_smms(camera)
    L, b, F = float(smms.distance), float(smms.gap), float(smms.lens_focal)
    rises, vergence = lattice.rises[lens][:, None], -1 / position[2]
    L_each, b_each = L * (1 + rises), b - L * rises
    c = sensor_position(camera.sensor, lattice.centres_px[lens])
    offset = L_each * vergence + 1 - L_each / F
    due = -b_each * (c / (L + b) + position[:2] * vergence) / offset
    return (sensor_position(camera.sensor, centres_px) - c - due) / camera.sensor.pixel


def _by_centre(x: float, camera: Camera) -> float:
    """By how much the equations (s - c) x + b (o V) + (b/L) c / (1 + b/L) = 0 move per c."""
    smms = central_smms(camera)
    slope = float(smms.gap / smms.distance)
    return x - slope / (1 + slope)


def _from_lattice(
    gains: Array, lattice: Lattice, lens: npt.NDArray[np.int64], camera: Camera, x: float
) -> Array:
    """How the solution moves with the lattice's six numbers, by a standard deviation along each
    axis of their covariances, shape (3, 12): all centres together, and those that follow it.

    0 where no covariance is known.

    Args:
        gains: of the solution by the right sides of the equations, shape (2 n, 3).
        lattice: the micro-images.
        lens: position of each in the lattice, shape (n,).
        camera: nominal.
        x: image offset.
    """
    if not np.isfinite(lattice.covariance_px).all():
        return np.zeros((3, 12))
    common = lattice.covariance_px if lattice.common_px is None else lattice.common_px
    i, j = lattice.indices[lens].T
    moves = np.zeros((len(lens), 2, 6))
    for n in range(2):
        moves[:, n, n], moves[:, n, 2 + n], moves[:, n, 4 + n] = 1.0, i, j
    by_centres = gains.T * camera.sensor.pixel * _by_centre(x, camera)
    followed = np.ones(len(lens)) if lattice.followed is None else lattice.followed[lens]
    alike = by_centres @ moves.reshape(-1, 6) @ _axes(common)
    fitted = (moves * followed[:, None, None]).reshape(-1, 6)
    return np.concatenate(
        [alike, by_centres @ fitted @ _axes(lattice.covariance_px - common)], axis=1
    )


def _axes(covariance: Array) -> Array:
    """A standard deviation along each axis of a covariance, as columns."""
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)), dtype=np.float64)


def _from_tilt(
    gains: Array, by_rise: Array, lattice: Lattice, lens: npt.NDArray[np.int64]
) -> Array:
    """How the solution moves with a standard uncertainty of each slope of the array, shape (3, 2).

    Args:
        gains: as in ``_from_lattice``.
        by_rise: how the equations (s - c) x + b (o V) + b c / (L + b) = 0 move with the rise of
            their microlens, shape (n, 2).
        lattice: the micro-images.
        lens: position of each in the lattice, shape (n,).
    """
    if lattice.cone is None:
        return np.zeros((3, 2))
    tilting = lattice.cone.tilting
    moves = (
        by_rise[:, :, None]
        * tilting.per_px
        * (lattice.centres_px[lens] - tilting.axis_px)[:, None, :]
    )
    return gains.T @ moves.reshape(-1, 2) * lattice.tilt_uncertainty

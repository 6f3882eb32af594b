"""From pixels to the target: which object point a pixel of a bright field looks at, by the camera's
nominal geometry.

A pixel at s (mm) of the micro-image centred at c looks at o = across (s - c) + along c on the
target. Along the ray through the centre of the narrower of the two discs that make the bright
field: across = -x/(b V) where that is the microlens (q = y_i), -1/(kappa L V) where it is the main
lens (m = 0); along = -D/(L + b), the ray through the main lens's centre. From s = kappa q - (b/L) m
+ (b/f) y_i and o V = m W - q/L (physics.md, "One SMMS").
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera, Sensor, microlens_centres, microlens_types
from flflab.optics.focus import blur
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms, image_offset

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PixelSet:
    """Pixels of micro-images, one entry a pixel.

    Attributes:
        rows: row, shape (n,).
        columns: column, shape (n,).
        lens: position of its micro-image in the lattice, shape (n,).
    """

    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]
    lens: npt.NDArray[np.int64]

    def kept(self, which: npt.NDArray[np.bool_]) -> "PixelSet":
        """Only the pixels marked."""
        return PixelSet(self.rows[which], self.columns[which], self.lens[which])


def sensor_position(sensor: Sensor, pixels: Array) -> Array:
    """World (x, y) in mm of positions in pixels, shape (n, 2)."""
    middle = (np.asarray(sensor.resolution) - 1) / 2
    return (pixels - middle) * sensor.pixel + np.asarray(sensor.offset)


def sensor_pixel(sensor: Sensor, position: Array) -> Array:
    """Inverse of ``sensor_position``."""
    middle = (np.asarray(sensor.resolution) - 1) / 2
    return (position - np.asarray(sensor.offset)) / sensor.pixel + middle


def require_picture(picture: npt.NDArray[np.generic], camera: Camera, what: str) -> Array:
    """The picture as float64 after checking that it is one of this camera.

    Raises:
        MeasurementError: wrong shape, or not finite.
    """
    require_shape(picture, camera, what)
    values = np.asarray(picture, dtype=np.float64)
    if strange := values.size - np.count_nonzero(np.isfinite(values)):
        raise MeasurementError(
            f"{what} picture: {strange} of its {values.size} pixels are not finite numbers; all"
            " must be, as read"
        )
    return values


def require_shape(picture: npt.NDArray[np.generic], camera: Camera, what: str) -> None:
    """Check that the picture has the camera's pixels.

    Raises:
        MeasurementError: it has not.
    """
    columns, rows = camera.sensor.resolution
    if picture.shape != (rows, columns):
        raise MeasurementError(
            f"{what} picture: shape {picture.shape} does not fit the camera's sensor of {rows} rows"
            f" x {columns} columns"
        )


def blur_px(camera: Camera, distance: float) -> float:
    """Diameter of the blur of a target ``distance`` mm away, behind the central microlens."""
    return float(blur(central_smms(camera), 1 / distance)) / camera.sensor.pixel


def target_scales(camera: Camera, distance: float) -> tuple[float, float]:
    """``scales_of`` the central microlens."""
    return scales_of(central_smms(camera), distance)


def scales_of(smms: Smms, distance: float) -> tuple[float, float]:
    """(across, along): mm on the target per mm on the sensor, within a micro-image and from one to
    the next.

    Raises:
        MeasurementError: the target is at infinity, or on the array's conjugate, where a
            micro-image is a view of one point.
    """
    if not (np.isfinite(distance) and distance > 0):
        raise MeasurementError(
            f"the target's distance is {distance} mm; measuring on a target needs a finite distance"
            " above 0"
        )
    vergence = 1 / distance
    if float(smms.lens_width) >= float(smms.microlens_width):
        across = -float(image_offset(smms, vergence)) / (float(smms.gap) * vergence)
    else:
        across = -1 / (float(smms.kappa) * float(smms.distance) * vergence)
    return across, -distance / float(smms.distance + smms.gap)


def kind_of_each(camera: Camera, centres_px: Array) -> npt.NDArray[np.int64]:
    """Which of the camera's focal lengths the nominally nearest microlens has, shape (n,)."""
    nominal = microlens_centres(camera.array) * float(central_smms(camera).image_scale)
    _, nearest = KDTree(sensor_pixel(camera.sensor, nominal)).query(centres_px)
    return microlens_types(camera.array)[nearest].astype(np.int64)


def microlens_type_of(lattice: Lattice, camera: Camera) -> Array:
    """Focal length of the microlens behind each micro-image, mm: the nominally nearest one's."""
    return np.asarray(camera.array.focal_lengths)[kind_of_each(camera, lattice.centres_px)]


def bright_pixels(
    lattice: Lattice, shape: tuple[int, int], margin_px: float, chosen: npt.NDArray[np.bool_]
) -> PixelSet:
    """Pixels at least ``margin_px`` within the bright field of a chosen micro-image and as far
    outside all neighbours' total fields.
    """
    radius = lattice.inside_radius_px - margin_px
    if radius <= 0:
        return PixelSet(*(np.zeros(0, dtype=np.int64) for _ in range(3)))
    reach = int(np.ceil(radius)) + 1
    window = np.arange(-reach, reach + 1)
    members = np.flatnonzero(chosen)
    whole = np.rint(lattice.centres_px[members]).astype(np.int64)
    columns = (
        whole[:, 0, None, None]
        + window[None, None, :]
        + np.zeros((1, len(window), 1), dtype=np.int64)
    )
    rows = (
        whole[:, 1, None, None]
        + window[None, :, None]
        + np.zeros((1, 1, len(window)), dtype=np.int64)
    )
    away_x = columns - lattice.centres_px[members, 0, None, None]
    away_y = rows - lattice.centres_px[members, 1, None, None]
    inside = (
        (away_x**2 + away_y**2 <= radius**2)
        & (rows >= 0)
        & (rows < shape[0])
        & (columns >= 0)
        & (columns < shape[1])
    )
    keep_off = lattice.outside_radius_px + margin_px
    if keep_off + radius > lattice.pitch_px:
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                step = lattice.vectors_px @ np.array([i, j], dtype=np.float64)
                if (i, j) != (0, 0) and np.hypot(*step) < keep_off + radius:
                    inside &= (away_x - step[0]) ** 2 + (away_y - step[1]) ** 2 >= keep_off**2
    lens = np.broadcast_to(members[:, None, None], inside.shape)
    return PixelSet(rows[inside], columns[inside], lens[inside])

"""A picture of a chirp and what is known before it is measured: which pixels look at the target,
and what light diffraction takes from them.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    PixelSet,
    bright_pixels,
    microlens_type_of,
    require_picture,
    require_shape,
    scales_of,
    sensor_position,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, Sensor
from flflab.optics.contrast import cone_half_angle, far_light
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.optics.smms import Smms
from flflab.targets import Bars, BarsAlongY

Array = npt.NDArray[np.float64]

MARGIN_PX = 1.0  # within the bright field: keeps the averaging of the rim's pixels out
NARROWEST = 7.0  # pixels, radius of what counts of a bright field
MOST_LOST = 0.007  # of the light over one edge: nearer to it, what is lost follows the bars


@dataclass(frozen=True)
class Frame:
    """A picture and what is known before it is measured.

    Attributes:
        values: DN, [row, col].
        lattice: of the micro-images.
        sensor: nominal.
        focal_lengths: of the microlens behind each micro-image, mm.
        smms: the kind of microlens that is measured.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.
        gains: of a colour filter's four sub-lattices, None without filters.
        wavelength: of the light, mm; None where diffraction is too little to count.
    """

    values: npt.NDArray[np.generic]
    lattice: Lattice
    sensor: Sensor
    focal_lengths: Array
    smms: Smms
    target: Bars
    distance: float
    noise: SensorNoise
    gains: Array | None
    wavelength: float | None

    @property
    def start(self) -> Array:
        """Shift mm, across x and y, along x and y, nominal, shape (5,)."""
        across, along = scales_of(self.smms, self.distance)
        return np.array([0.0, across, 0.0, along, 0.0])

    @property
    def scale(self) -> float:
        """Image over target within a micro-image, nominal."""
        return float(magnification(self.smms, 1 / self.distance))


def frame_of(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    camera: Camera,
    target: Bars,
    distance: float,
    noise: SensorNoise,
    gains: Array | None,
    wavelength: float | None,
) -> Frame:
    """Of the central kind of microlens; of bars along y with x and y exchanged.

    Arguments and errors as ``flflab.measurement.contrast.curve.fit_contrast``.
    """
    require_shape(picture, camera, target.kind)
    if picture.dtype.kind != "u":  # a copy of ten million pixels would cost as much as the fit
        picture = require_picture(picture, camera, target.kind)
    smms, focal, sensor = central_smms(camera), microlens_type_of(lattice, camera), camera.sensor
    if isinstance(target, BarsAlongY):
        picture, gains = picture.T, None if gains is None else gains.T
        places, vectors = lattice.centres_px[:, ::-1], lattice.vectors_px[::-1]
        lattice = replace(lattice, centres_px=places, vectors_px=vectors)
        sensor = replace(sensor, resolution=sensor.resolution[::-1], offset=sensor.offset[::-1])
        target = target.unturned
    return Frame(picture, lattice, sensor, focal, smms, target, distance, noise, gains, wavelength)


def on_target(frame: Frame) -> PixelSet:
    """Pixels of bright fields that look at the target well within its edges."""
    target, lattice, sensor = frame.target, frame.lattice, frame.sensor
    chosen = np.ones(len(lattice.centres_px), dtype=np.bool_)
    radius = lattice.inside_radius_px
    if len(set(frame.focal_lengths)) > 1:
        chosen = frame.focal_lengths == float(frame.smms.focal)
        # a lattice of several kinds has the central one's measured radius
        radius = min(radius, float(frame.smms.inside_radius) / sensor.pixel)
    if radius - MARGIN_PX < NARROWEST:
        raise MeasurementError(
            f"{target.kind} picture: the bright fields are {max(2 * radius, 0.0):.0f} px wide and"
            f" {2 * (NARROWEST + MARGIN_PX):.0f} are due, in fewer one bar is easily taken for the"
            " next; choose another f-number"
        )
    across, along = frame.start[1], frame.start[3]
    ends = np.array([target.width, target.height]) / 2 - _margin(frame)
    centres = sensor_position(sensor, lattice.centres_px)
    reach = abs(across) * radius * sensor.pixel
    chosen &= (np.abs(centres * along) < ends + reach).all(axis=1)
    lattice = replace(lattice, inside_radius_px=radius)
    pixels = bright_pixels(lattice, frame.values.shape, MARGIN_PX, chosen)
    inside, centre = places_of(frame, pixels)
    looks_at = inside * across + centre * along
    return pixels.kept((np.abs(looks_at) < ends).all(axis=1))


def places_of(frame: Frame, pixels: PixelSet) -> tuple[Array, Array]:
    """Of pixels from the centre of their micro-image, and of that centre, mm, each of shape
    (n, 2).
    """
    sensor, at = frame.sensor, np.stack([pixels.columns, pixels.rows], axis=1)
    centre = sensor_position(sensor, frame.lattice.centres_px)[pixels.lens]
    return sensor_position(sensor, at.astype(np.float64)) - centre, centre


def _margin(frame: Frame) -> float:
    """How far within the target's edges a pixel must look, mm."""
    half_angle = float(cone_half_angle(frame.smms, 1 / frame.distance))
    waves = float(far_light(half_angle, frame.wavelength)) / MOST_LOST if frame.wavelength else 0.0
    return (
        float(blur(frame.smms, 1 / frame.distance)) / 2 + 3 * frame.sensor.pixel + waves
    ) / frame.scale + 0.01 * frame.target.width

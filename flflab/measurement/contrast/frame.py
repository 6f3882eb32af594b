"""A picture of a chirp and what is known before it is measured: which pixels look at the target,
and what light diffraction takes from them.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.model import Fit
from flflab.measurement.contrast.runs import Runs, gather
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    PixelSet,
    bright_pixels,
    microlens_type_of,
    scales_of,
    sensor_position,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.contrast import cone_half_angle, far_light, lost_over_edges
from flflab.optics.focus import blur, magnification
from flflab.optics.smms import Smms
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

MARGIN_PX = 1.0  # within the bright field: keeps the averaging of the rim's pixels out
FEWEST_PIXELS = 300
NARROWEST = 7.0  # pixels, radius of what counts of a bright field
MOST_SATURATED = 0.2
MOST_LOST = 0.007  # of the light over one edge: nearer to it, what is lost follows the bars


@dataclass(frozen=True)
class Frame:
    """A picture and what is known before it is measured.

    Attributes:
        values: DN, [row, col].
        lattice: of the micro-images.
        camera: nominal.
        smms: the kind of microlens that is measured.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.
        gains: of a colour filter's four sub-lattices, None without filters.
        wavelength: of the light, mm; None where diffraction is too little to count.
    """

    values: npt.NDArray[np.generic]
    lattice: Lattice
    camera: Camera
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


def on_target(frame: Frame) -> PixelSet:
    """Pixels of bright fields that look at the target well within its edges."""
    target, lattice, sensor = frame.target, frame.lattice, frame.camera.sensor
    kinds = len(frame.camera.array.focal_lengths)
    chosen = np.ones(len(lattice.centres_px), dtype=np.bool_)
    radius = lattice.inside_radius_px
    if kinds > 1:
        chosen = microlens_type_of(lattice, frame.camera) == float(frame.smms.focal)
        # a lattice of several kinds has the central one's measured radius
        radius = min(radius, float(frame.smms.inside_radius) / sensor.pixel)
    if radius <= MARGIN_PX:
        raise MeasurementError(
            f"{target.kind} picture: the micro-images have no bright field; a larger f-number"
            " gives one"
        )
    if radius - MARGIN_PX < NARROWEST:
        raise MeasurementError(
            f"{target.kind} picture: the bright fields are {2 * radius:.0f} px wide and"
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
    sensor, at = frame.camera.sensor, np.stack([pixels.columns, pixels.rows], axis=1)
    centre = sensor_position(sensor, frame.lattice.centres_px)[pixels.lens]
    return sensor_position(sensor, at.astype(np.float64)) - centre, centre


def runs_of(frame: Frame, pixels: PixelSet, rows: int) -> Runs:
    """Runs of unsaturated pixels."""
    kind = frame.target.kind
    runs, saturated = gather(
        frame.values, pixels, frame.lattice, frame.camera.sensor, frame.noise, rows, frame.gains
    )
    number = int(runs.pixels.sum())
    if number < FEWEST_PIXELS:
        raise MeasurementError(
            f"{kind} picture: only {number} unsaturated pixels of bright fields look at the"
            f" target, {FEWEST_PIXELS} are due; check exposure, f-number and the target's distance"
        )
    if saturated > MOST_SATURATED * len(pixels.rows):
        raise MeasurementError(
            f"{kind} picture: {saturated} pixels of bright fields are saturated; expose it shorter"
        )
    return runs


def _margin(frame: Frame) -> float:
    """How far within the target's edges a pixel must look, mm."""
    half_angle = float(cone_half_angle(frame.smms, 1 / frame.distance))
    waves = float(far_light(half_angle, frame.wavelength)) / MOST_LOST if frame.wavelength else 0.0
    return (
        float(blur(frame.smms, 1 / frame.distance)) / 2 + 3 * frame.camera.sensor.pixel + waves
    ) / frame.scale + 0.01 * frame.target.width


def lost_light(frame: Frame, runs: Runs, fit: Fit, x: Array) -> Array:
    """Share of the mean light that diffraction takes from each run over the target's edges, beyond
    which it is dark, shape (n,).
    """
    if frame.wavelength is None:
        return np.zeros(len(runs.read))
    ends = np.array([frame.target.width, frame.target.height]) / 2
    up = runs.places[:, 2] * fit.common[1] + runs.places[:, 4] * fit.common[3]
    seen = np.stack([x, up], axis=1)
    away = np.stack([ends - seen, ends + seen], axis=2).reshape(-1, 4) * frame.scale
    half_angle = float(cone_half_angle(frame.smms, 1 / frame.distance))
    return lost_over_edges(away, half_angle, frame.wavelength)

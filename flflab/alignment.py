"""How the microlens array stands to the sensor, from one white picture: roll, tilt, and the
sensor's place against the exit pupil.

What a tilt does to centres and radii of the micro-images stands in
``measurement/lattice/tilting.py``; the measurement of the lattice finds it from them.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

ANGLES = ("roll", "yaw", "pitch")
SHADOW_PX = 0.02  # how far a fitted radius of about a pixel is off, with exact pictures
SLOPE_SHARE = 0.1  # standard uncertainty of a slope by the camera's description
LEAST_KNOWN = 0.02  # rad: standard uncertainty of a tilt that nothing was seen of


@dataclass(frozen=True)
class Attitude:
    """How the array is turned against the sensor, rad.

    Attributes:
        roll: from the sensor's rows towards y, modulo a quarter turn (hexagonal: a sixth).
        yaw: positive takes the array's edge at +x away from the main lens.
        pitch: positive takes the array's edge at +y away from the main lens.
        covariance: of (roll, yaw, pitch), shape (3, 3).
    """

    roll: float
    yaw: float
    pitch: float
    covariance: Array

    @property
    def angles(self) -> dict[str, tuple[float, float]]:
        """Each angle with its standard uncertainty, by the names of ``ANGLES``."""
        spread = np.sqrt(np.diag(self.covariance))
        return {
            name: (getattr(self, name), float(u)) for name, u in zip(ANGLES, spread, strict=True)
        }


def attitude_of(lattice: Lattice) -> Attitude:
    """Roll and tilt by a measured lattice.

    The tilt bends the lattice and changes the discs; of the camera's description only L, b, f and d
    scale it: where they are 2 % off so is the tilt, and no tilt stays no tilt.

    Raises:
        MeasurementError: the micro-images do not tell the tilt: too few, or in one row.
    """
    if not float(np.max(lattice.tilt_uncertainty)) < LEAST_KNOWN:
        raise MeasurementError(
            f"white picture: {len(lattice.centres_px)} micro-images do not determine the array's"
            " tilt; at least 3 x 3, some of them off the axis, are needed"
        )
    yaw, pitch = np.arctan(lattice.tilt)
    spread = np.array(
        [lattice.angle_uncertainty, *lattice.tilt_uncertainty / (1 + lattice.tilt**2)]
    )
    return Attitude(lattice.angle, float(yaw), float(pitch), np.diag(spread**2))


@dataclass(frozen=True)
class Outcome:
    """What became of one thing that was to be aligned.

    Attributes:
        what: ``roll``, ``yaw``, ``pitch``, ``exit pupil`` or ``overlap``.
        axis: name of the axis that moved, empty where there is none.
        before: deviation in the first picture, rad; of the sensor mm.
        after: deviation in the last one.
        uncertainty: standard, of ``after``.
        reading: of the axis in the end, rad or mm; 0 where there is none.
        pictures: how many were looked at.
        why: it stopped.
    """

    what: str
    axis: str
    before: float
    after: float
    uncertainty: float
    reading: float
    pictures: int
    why: str

    @property
    def unit(self) -> str:
        """Of the deviation."""
        return "rad" if self.what in ANGLES else "mm"


@dataclass(frozen=True)
class Crossing:
    """Where the sensor has to stand: world z and standard uncertainty in mm, and by how much a mm
    of travel changes what is sought.
    """

    place: float
    uncertainty: float
    slope: float


def microlens_shadow(lattice: Lattice, camera: Camera) -> tuple[float, float]:
    """Radius d kappa/2 of the microlens's shadow, mm, and its standard uncertainty: 0 with the
    sensor in the exit pupil.

    Its sign, which no picture shows, is that of the camera's description.
    """
    smms = central_smms(camera)
    sign = 1.0 if float(smms.lens_width) >= float(smms.microlens_width) else -1.0
    radius = (lattice.outside_radius_px - sign * lattice.inside_radius_px) / 2 * camera.sensor.pixel
    doubt = math.hypot(
        lattice.outside_uncertainty_px / 2, lattice.inside_uncertainty_px / 2, SHADOW_PX
    )
    return math.copysign(radius, float(smms.kappa)), doubt * camera.sensor.pixel


def measured_overlap(lattice: Lattice, camera: Camera) -> tuple[float, float]:
    """How far neighbouring micro-images overlap, mm, negative for a gap, and its standard
    uncertainty.
    """
    doubt = math.hypot(2 * lattice.outside_uncertainty_px, lattice.pitch_uncertainty_px)
    return (
        2 * lattice.outside_radius_px - lattice.pitch_px
    ) * camera.sensor.pixel, doubt * camera.sensor.pixel


def nominal_slopes(camera: Camera) -> tuple[float, float]:
    """Change in mm a mm of the sensor's place: of d kappa/2, and of the overlap A b/L + d |kappa| -
    p (1 + b/L).
    """
    smms = central_smms(camera)
    L, f, d = float(smms.distance), float(smms.focal), float(smms.aperture)
    by_gap = d * (1 / L - 1 / f)
    overlap = (float(smms.lens_aperture) - min(camera.array.pitch)) / L + math.copysign(
        1.0, float(smms.kappa)
    ) * by_gap
    return by_gap / 2, overlap


def find_crossing(
    places: Array,
    values: Array,
    uncertainties: Array,
    slope: float,
    wanted: float = 0.0,
    signed: bool = True,
) -> Crossing:
    """Where a straight line through measured values is as wanted.

    The line's slope is that of the camera's description to ``SLOPE_SHARE``, so that one place is
    enough to begin with.

    Args:
        places: of the sensor, world z in mm, shape (n,).
        values: measured there, mm.
        uncertainties: standard ones of the values.
        slope: by the camera's description.
        wanted: value sought.
        signed: False where only sizes are known: the line is the one that fits best with any choice
            of signs after the first, which is believed.
    """
    choices = (
        [np.ones(len(values))]
        if signed
        else [
            np.array([1.0, *rest])
            for rest in itertools.product((1.0, -1.0), repeat=len(values) - 1)
        ]
    )
    sized = values if signed else np.concatenate([values[:1], np.abs(values[1:])])
    lines = (_line(places, signs * sized - wanted, uncertainties, slope) for signs in choices)
    return min(lines, key=lambda line: line[1])[0]


def _line(
    places: Array, values: Array, uncertainties: Array, slope: float
) -> tuple[Crossing, float]:
    """The line through the values, its slope known beforehand to a share; with chi^2."""
    middle = float(np.average(places, weights=1 / uncertainties**2))
    known = np.array([0.0, 1 / (SLOPE_SHARE * abs(slope))])
    design = np.vstack(
        [np.stack([np.ones_like(places), places - middle], axis=1) / uncertainties[:, None], known]
    )
    seen = np.append(values / uncertainties, known[1] * slope)
    covariance = np.linalg.inv(design.T @ design)
    level, found = covariance @ design.T @ seen
    chi2 = float(np.sum((design @ [level, found] - seen) ** 2))
    by = np.array([-1 / found, level / found**2])
    spread = math.sqrt(float(by @ covariance @ by) * max(1.0, chi2 / max(len(places) - 1, 1)))
    return Crossing(middle - float(level / found), spread, float(found)), chi2

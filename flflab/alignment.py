"""How the microlens array stands to the sensor, from one white picture: roll, tilt, and the
sensor's place against the exit pupil.

What a tilt does to centres and radii of the micro-images stands in
``measurement/lattice/tilting.py``; here it is read from each of them by itself.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.errors import MeasurementError
from flflab.measurement.lattice.kinds import Kinds
from flflab.measurement.lattice.tilting import Tilting, tilting_of
from flflab.measurement.lattice.white import Lattice, pitch_and_angle
from flflab.measurement.micro_images import MicroImages
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

ANGLES = ("roll", "yaw", "pitch")
SHADOW_PX = 0.02  # how far a fitted radius of about a pixel is off, with exact pictures
SLOPE_SHARE = 0.1  # standard uncertainty of a slope by the camera's description
CENTRES, RADII = np.array([0, 1]), np.array([2, 3])  # of what is measured of a micro-image
BY_CENTRES = np.array([0, 1, 2, 3, 4, 5, 8, 9])  # of what is fitted: all but the radii


@dataclass(frozen=True)
class Attitude:
    """How the array is turned against the sensor, rad.

    Attributes:
        roll: from the sensor's rows towards y, modulo a quarter turn (hexagonal: a sixth).
        yaw: positive takes the array's edge at +x away from the main lens.
        pitch: positive takes the array's edge at +y away from the main lens.
        covariance: of (roll, yaw, pitch), shape (3, 3).
        by_centres: (yaw, pitch) by the bend of the centres alone, and their standard uncertainties,
            shape (2, 2).
        by_radii: the same by the discs' radii alone.
        chi2: reduced chi^2 of the fit of all; the uncertainties are scaled up by its root where
            above 1.
    """

    roll: float
    yaw: float
    pitch: float
    covariance: Array
    by_centres: Array
    by_radii: Array
    chi2: float

    @property
    def angles(self) -> dict[str, tuple[float, float]]:
        """Each angle with its standard uncertainty, by the names of ``ANGLES``."""
        spread = np.sqrt(np.diag(self.covariance))
        return {
            name: (getattr(self, name), float(u)) for name, u in zip(ANGLES, spread, strict=True)
        }


@dataclass(frozen=True)
class Sensitivity:
    """What a tilt of 1 rad does at a point of the array, mm on the sensor, to first order.

    Attributes:
        centre: how far the micro-image moves, along the line from the axis.
        lens_radius: change of the radius of the main lens's shadow.
        microlens_radius: change of the radius of the microlens's shadow.
    """

    centre: float
    lens_radius: float
    microlens_radius: float


def sensitivity(camera: Camera, height: float) -> Sensitivity:
    """Derivatives by a tilt towards a point at ``height`` mm from the axis: of y S/(L + z), A (b -
    z)/(2 (L + z)), d |kappa|/2.
    """
    smms = central_smms(camera)
    L, b, f = float(smms.distance), float(smms.gap), float(smms.focal)
    by_z = -(L + b) / L**2
    return Sensitivity(
        centre=height * by_z * height,
        lens_radius=float(smms.lens_aperture) / 2 * by_z * height,
        microlens_radius=math.copysign(float(smms.aperture) / 2, float(smms.kappa))
        * (by_z + 1 / f)
        * height,
    )


def measure_attitude(images: MicroImages, lattice: Lattice, camera: Camera) -> Attitude:
    """Roll and tilt by least squares on the centres and radii of all micro-images.

    Origin, vectors and the two radii of the lattice are free; of the camera only L, b, f and d are
    used, and they scale the tilt: where they are 2 % off so is the tilt, and no tilt stays no tilt.
    Microlenses of several kinds have each the radii of their kind; where the lattice took them for
    one, the centres alone tell the tilt.

    Args:
        images: each micro-image by itself.
        lattice: of the same picture.
        camera: where the stages say that array and sensor stand.

    Raises:
        MeasurementError: all micro-images lie in one row, or there are too few.
    """
    tilting = tilting_of(camera)
    told_apart = lattice.kinds is not None or len(camera.array.focal_lengths) == 1
    # radii of kinds that the lattice took for one say more of the kinds than of the tilt
    seen_columns, free = (np.arange(4), np.arange(10)) if told_apart else (CENTRES, BY_CENTRES)
    both = _fit(images, lattice, tilting, seen_columns, free)
    vectors = both.values[2:6]
    _, roll = pitch_and_angle(lattice.layout, vectors.reshape(2, 2).T)
    by_values = np.zeros((3, 10))
    for k, nudge in enumerate(np.eye(4) * 1e-4 * lattice.pitch_px):
        by_values[0, 2 + k] = (
            pitch_and_angle(lattice.layout, (vectors + nudge).reshape(2, 2).T)[1] - roll
        ) / (1e-4 * lattice.pitch_px)
    by_values[[1, 2], [8, 9]] = 1 / (1 + both.values[8:10] ** 2)  # from slopes to angles
    return Attitude(
        roll=roll,
        yaw=math.atan(both.values[8]),
        pitch=math.atan(both.values[9]),
        covariance=by_values @ both.covariance @ by_values.T,
        by_centres=_angles(_fit(images, lattice, tilting, CENTRES, BY_CENTRES)),
        by_radii=_angles(_fit(images, lattice, tilting, RADII, np.array([6, 7, 8, 9]))),
        chi2=both.chi2,
    )


@dataclass(frozen=True)
class _Fit:
    """Origin, a, b and radii in px, slopes of the tilt; what was not free stands as in the lattice,
    with covariance 0.
    """

    values: Array
    covariance: Array
    chi2: float


def _angles(fit: _Fit) -> Array:
    return np.stack([np.arctan(fit.values[8:10]), np.sqrt(np.diag(fit.covariance)[8:10])])


def _fit(
    images: MicroImages,
    lattice: Lattice,
    tilting: Tilting,
    seen_columns: npt.NDArray[np.int64],
    free: npt.NDArray[np.int64],
) -> _Fit:
    """Fit some of the parameters to some of (x, y, larger, smaller radius) of every micro-image."""
    seen = np.concatenate([images.centres_px, images.radii_px], axis=1)[:, seen_columns]
    whiten = np.linalg.inv(
        np.linalg.cholesky(images.covariance_px[:, seen_columns[:, None], seen_columns])
    )
    radii = np.median(images.radii_px, axis=0)
    start = np.concatenate([lattice.origin_px, lattice.vectors_px.T.ravel(), radii, [0.0, 0.0]])
    places = images.indices.astype(np.float64)
    scale = np.array([1.0, 1, 0.1, 0.1, 0.1, 0.1, 1, 1, 1e-3, 1e-3])[free]

    def residuals(changed: Array) -> Array:
        values = start.copy()
        values[free] = changed
        return np.einsum(
            "nij,nj->ni",
            whiten,
            seen - _expected(values, places, tilting, lattice.kinds)[:, seen_columns],
        ).ravel()

    found = least_squares(residuals, start[free], x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    normal = (found.jac * scale).T @ (found.jac * scale)
    freedom = seen.size - len(free)
    if freedom < 1 or np.linalg.cond(normal) > 1e14:
        raise MeasurementError(
            f"white picture: {len(seen)} micro-images do not determine the array's tilt; at"
            " least 3 x 3, some of them off the axis, are needed"
        )
    chi2 = 2 * float(found.cost) / freedom
    values, covariance = start.copy(), np.zeros((10, 10))
    values[free] = found.x
    covariance[np.ix_(free, free)] = np.linalg.inv(normal) * np.outer(scale, scale) * max(1.0, chi2)
    return _Fit(values, covariance, chi2)


def _expected(values: Array, places: Array, tilting: Tilting, kinds: Kinds | None) -> Array:
    """(x, y, larger, smaller radius) of the micro-images at these places in the lattice, px, shape
    (n, 4).
    """
    straight, tilt = values[:2] + places @ values[2:6].reshape(2, 2), values[8:10]
    centres, rises = tilting.centres(straight, tilt), tilting.rises(straight, tilt)
    discs = (
        tilting.discs(values[6:8], rises)
        if kinds is None
        else kinds.discs(values[6:8], kinds.of(centres), tilting, rises)
    )
    return np.concatenate([centres, discs], axis=1)


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

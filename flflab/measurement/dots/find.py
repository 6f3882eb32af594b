"""The images of the four dots in a picture: looked for, measured, and the dots' places fitted, in
turns until they agree.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.dots.fit import Seen, Stand, stand_of
from flflab.measurement.dots.model import Microlenses, Shown, microlenses_of, shown
from flflab.measurement.dots.pose import Candidates, candidates_near
from flflab.measurement.dots.search import NEAR_PX, where_to_look
from flflab.measurement.dots.spots import BESIDE_PX, Spots, measure_spots
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import blur_px, sensor_pixel, sensor_position
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

LEAST_LIGHT = 0.15  # of a whole spot's: darker ones say little of where a dot is
FAINTEST = 1e-3  # the same: darker ones do not matter to others either
MODEL_PX = 0.001  # of a spot's centroid, beside exact pictures by rays: up to so much
RIM_PX = 1.5  # beyond its outside radius, in which a micro-image may have light
RADIUS_PX = 1.0  # by which rims that are soft may mislead the white picture's radii
ROUNDS, SETTLED_PX = 4, 0.2  # of measuring and fitting, until no place moves by more
# of the width of blurred dots: so far apart, what light they have of one another moves them by less
# than is stated
APART = 0.9


@dataclass(frozen=True)
class Found:
    """The spots of a picture, one entry for each pair of dot and micro-image.

    Attributes:
        candidates: dot and micro-image of each.
        spots: as measured.
        seen: the same as fitted.
        stand: where the dots stand, and what their spots then are.
        distance: main lens to target, mm: the nominal one, or where the dots were found.
        reach_px: radius of a spot with its blur.
        radius_px: of a spot in focus.
    """

    candidates: Candidates
    spots: Spots
    seen: Seen
    stand: Stand
    distance: float
    reach_px: float
    radius_px: float

    @property
    def chief_px(self) -> Array:
        """Where the rays through the centre of the limiting stop land, px, shape (n, 2)."""
        place = self.seen.lenses.centres + self.stand.shown.chief
        return sensor_pixel(self.seen.lenses.camera.sensor, place)


def find_dots(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> Found:
    """Find the images of the dots round where the nominal camera puts them, to 30 px, and if they
    are not there, anywhere.

    Raises:
        MeasurementError: target at infinity, no dot found where the camera puts some, dots blurred
            into one another, or no spot that can be measured.
    """
    pose = where_to_look(values, lattice, camera, target, distance, noise)
    smms, pixel = central_smms(camera), camera.sensor.pixel
    size = float(magnification(smms, 1 / pose.distance)) / pixel
    radius, blur = target.diameter / 2 * size, blur_px(camera, pose.distance)
    _require_apart(target.spacing * size, 2 * radius, blur)
    reach = radius + blur / 2
    every = microlenses_of(lattice, camera)
    candidates = candidates_near(pose, lattice, camera, target, reach + NEAR_PX)
    values_of = pose.start(camera, target)
    at = values_of[candidates.dot]
    lit = shown(every.those(candidates.lens), at[:, :2], at[:, 2], target.diameter).light > 0
    candidates = candidates.those(lit)
    lenses = every.those(candidates.lens)

    def due(stands: Array) -> Shown:
        at = stands[candidates.dot]
        return shown(lenses, at[:, :2], at[:, 2], target.diameter)

    def measured(seen_as: Shown, search: float) -> Spots:
        places = sensor_pixel(camera.sensor, lenses.centres + seen_as.centroid)
        rims = sensor_pixel(camera.sensor, lenses.centres), lattice.outside_radius_px + RIM_PX
        return measure_spots(values, places, reach, blur, *rims, search, noise)

    # beyond halfway to the next dot a micro-image may show that one
    room = max(target.spacing * size / 2 - radius - blur / 2 - BESIDE_PX, 0.0)
    for search in (NEAR_PX, NEAR_PX / 2):
        expected = due(values_of)
        spots = measured(expected, min(search, room))
        values_of = _shifted(values_of, candidates, lenses, spots, expected, camera)
    light = due(values_of).light
    kept = light > FAINTEST
    candidates, lenses = candidates.those(kept), every.those(candidates.lens[kept])
    place = np.zeros(len(lenses.rise))
    if lattice.doubts_px is not None:
        place = lattice.doubts_px[candidates.lens] * pixel
    focus = lattice.radii_apart_px * pixel / every.radius
    kappa = _kappa_apart(lattice, camera)
    search, first, rounds = min(NEAR_PX / 4, room), values_of, 0
    expected, shift = due(values_of), kappa[0]
    while True:
        spots = measured(expected, search)
        seen = Seen(
            lenses,
            candidates.dot,
            sensor_position(camera.sensor, spots.centroids) - lenses.centres,
            (spots.variance + MODEL_PX**2) * pixel**2,
            place,
            focus,
            spots.whole & (expected.light > LEAST_LIGHT),
            kappa,
            target.diameter,
        )
        if not seen.counted.any():
            raise _nothing(spots, expected)
        stand = stand_of(seen, first, values_of, shift)
        moved = np.abs(stand.shown.centroid - expected.centroid).max() / pixel
        rounds += 1
        if search == 0.0 and (moved < SETTLED_PX or rounds >= ROUNDS):
            break
        values_of, expected, shift, search = stand.values, stand.shown, stand.focus, 0.0
    return Found(candidates, spots, seen, stand, pose.distance, reach, radius)


def _kappa_apart(lattice: Lattice, camera: Camera) -> tuple[float, float]:
    """By how much kappa differs from the camera's as the microlenses' discs in the white picture
    show it, d |kappa| in width, and its standard uncertainty.
    """
    smms, pixel = central_smms(camera), camera.sensor.pixel
    sign = 1.0 if float(smms.microlens_width) > float(smms.lens_width) else -1.0
    radius = (lattice.outside_radius_px + sign * lattice.inside_radius_px) / 2
    doubt = math.hypot(
        RADIUS_PX, (lattice.outside_uncertainty_px + lattice.inside_uncertainty_px) / 2
    )
    kappa, per_px = float(smms.kappa), 2 * pixel / float(smms.aperture)
    return math.copysign(radius * per_px, kappa) - kappa, doubt * per_px


def _require_apart(apart: float, width: float, blur: float) -> None:
    if apart < APART * (width + blur):
        raise MeasurementError(
            f"four-dot picture: the dots' images are {apart:.1f} px apart and, with {blur:.1f} px"
            f" of blur, {width + blur:.1f} px wide; {APART * (width + blur):.1f} px apart are"
            " needed to separate them; take dots further apart, or move them towards the focus"
        )


def _shifted(
    values: Array,
    candidates: Candidates,
    lenses: Microlenses,
    spots: Spots,
    expected: Shown,
    camera: Camera,
) -> Array:
    """The dots moved aside to the median of their spots."""
    shifted = values.copy()
    off = sensor_position(camera.sensor, spots.centroids) - lenses.centres - expected.centroid
    for dot in range(len(values)):
        mine = (candidates.dot == dot) & spots.whole & (expected.light > 0.5)
        if mine.any():
            step = np.median(off[mine], axis=0)
            away = lenses.distance * (values[dot, 2] - 1 / lenses.lens_focal) + 1
            shifted[dot, :2] -= step * away / lenses.gap
    return shifted


def _nothing(spots: Spots, expected: Shown) -> MeasurementError:
    """What keeps all spots from being measured."""
    due = expected.light > LEAST_LIGHT
    if due.any():
        why = (
            "each is cut by the sensor's edge, covered by another, or lost in noise; move the"
            " target, or expose it longer"
        )
    else:
        why = "no micro-image shows one; check the target's distance and place"
    return MeasurementError(f"four-dot picture: none of the dots' images can be measured: {why}")

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
from flflab.optics.focus import blur, magnification
from flflab.optics.per_type import type_smms
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

LEAST_LIGHT = 0.15  # of a whole spot's: darker ones say little of where a dot is
FAINTEST = 1e-3  # the same: darker ones do not matter to others either
MODEL_PX = 0.001  # of a spot's centroid, beside exact pictures by rays: up to so much
RIM_PX = 1.5  # beyond its outside radius, in which a micro-image may have light
RADIUS_PX = 1.0  # by which rims that are soft may mislead the white picture's radii
WELL_LIT = 0.5  # of a whole spot's light: such spots say where a dot is, roughly
SEARCHES = NEAR_PX, NEAR_PX / 2  # px, by which spots may lie elsewhere, before they are fitted
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
    pixel, vergence = camera.sensor.pixel, 1 / pose.distance
    size = float(magnification(central_smms(camera), vergence)) / pixel
    radius = target.diameter / 2 * size
    _require_apart(target.spacing * size, 2 * radius, blur_px(camera, pose.distance))
    widest = max(float(blur(one, vergence)) for one in type_smms(camera)) / pixel
    reach = radius + widest / 2
    every, kappa = microlenses_of(lattice, camera), _kappa_apart(lattice, camera)
    stands, shift = pose.start(camera, target), kappa[0]
    wide = target.diameter / pose.distance
    pairs = candidates_near(pose, lattice, camera, target, reach + NEAR_PX)
    # beyond halfway to the next dot a micro-image may show that one
    room = max(target.spacing * size / 2 - reach - BESIDE_PX, 0.0)
    rounds = 0
    while True:
        coarse = rounds < len(SEARCHES)
        candidates, lenses, expected = _lit(pairs, every, stands, shift, wide)
        search = min(SEARCHES[rounds], room) if coarse else 0.0
        spots = measure_spots(
            values,
            sensor_pixel(camera.sensor, lenses.centres + expected.centroid),
            lattice.centres_px[candidates.lens],
            (lattice.outside_radius_px + RIM_PX, reach + search, widest),
            noise,
        )
        rounds += 1
        away = sensor_position(camera.sensor, spots.centroids) - lenses.centres
        if coarse:
            stands = _shifted(stands, candidates, lenses, away - expected.centroid, spots, expected)
            continue
        seen = Seen(
            lenses,
            candidates.dot,
            candidates.lens,
            away,
            (spots.variance + MODEL_PX**2) * pixel**2,
            _places_unsure(lattice, len(every.rise))[candidates.lens] * pixel,
            lattice.radii_apart_px * pixel / every.radius,
            spots.whole & (expected.light > LEAST_LIGHT),
            kappa,
            wide,
        )
        if not seen.counted.any():
            raise _nothing(expected)
        stand = stand_of(seen, pose.start(camera, target), stands, shift)
        moved = np.abs(stand.shown.centroid - expected.centroid).max() / pixel
        stands, shift = stand.values, stand.focus
        wide = _angular_size(stands, np.unique(candidates.dot[seen.counted]), target) or wide
        if moved < SETTLED_PX or rounds == ROUNDS + len(SEARCHES):
            break
    return Found(candidates, spots, seen, stand, pose.distance, reach, radius)


def _lit(
    candidates: Candidates, every: Microlenses, stands: Array, shift: float, size: float
) -> tuple[Candidates, Microlenses, Shown]:
    """The candidates that show any light, their microlenses, and what they show."""
    at = stands[candidates.dot]
    lenses = every.those(candidates.lens).refocused(shift)
    light = shown(lenses, at[:, :2], at[:, 2], size).light > FAINTEST
    candidates, at = candidates.those(light), at[light]
    lenses = every.those(candidates.lens)
    return candidates, lenses, shown(lenses.refocused(shift), at[:, :2], at[:, 2], size)


def _angular_size(stands: Array, seen: Whole, target: FourDot) -> float | None:
    """Diameter of a dot times its vergence by how far apart the dots seen are: a main lens a little
    longer leaves their depth open by much. None of fewer than two.
    """
    if len(seen) < 2:
        return None
    apart, due = (
        np.linalg.norm(at[seen] - at[seen].mean(axis=0)) for at in (stands[:, :2], target.centres)
    )
    return target.diameter * float(apart / due)


def _places_unsure(lattice: Lattice, count: int) -> Array:
    """Standard uncertainty of each micro-image's own centre, px."""
    return np.zeros(count) if lattice.doubts_px is None else lattice.doubts_px


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
    stands: Array,
    candidates: Candidates,
    lenses: Microlenses,
    off: Array,
    spots: Spots,
    expected: Shown,
) -> Array:
    """The dots moved aside to the median of how far their spots are off, mm."""
    shifted = stands.copy()
    for dot in range(len(stands)):
        mine = (candidates.dot == dot) & spots.whole & (expected.light > WELL_LIT)
        if mine.any():
            x = lenses.distance * (stands[dot, 2] - 1 / lenses.lens_focal) + 1
            shifted[dot, :2] -= np.median(off[mine], axis=0) * x / lenses.gap
    return shifted


def _nothing(expected: Shown) -> MeasurementError:
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

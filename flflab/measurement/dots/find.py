"""The images of the four dots in a picture: looked for, measured, and the dots' places fitted, in
turns until they agree.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.dots.fit import Seen, Stand, stand_of
from flflab.measurement.dots.model import Microlenses, Shown, microlenses_of, shown_pairs
from flflab.measurement.dots.pose import NEAR_PX, pose_of
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
KAPPA = 0.015  # standard uncertainty of the camera's kappa: its gap is right to 1 %
# px, by which spots may lie elsewhere in each round of measuring and fitting, until no place moves
# by more than the last
SEARCHES, SETTLED_PX = (NEAR_PX, 0.0, 0.0, 0.0, 0.0), 0.2
# of the width of blurred dots: so far apart, what light they have of one another moves them by less
# than is stated
APART = 0.9


@dataclass(frozen=True)
class Found:
    """The spots of a picture, one entry for each pair of dot and micro-image.

    Attributes:
        spots: as measured.
        seen: the same as fitted.
        stand: where the dots stand, and what their spots then are.
        distance: main lens to target, mm: the nominal one, or where the dots were found.
        reach_px: radius of a spot with its blur.
    """

    spots: Spots
    seen: Seen
    stand: Stand
    distance: float
    reach_px: float

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
    """Find the images of the dots where the nominal camera puts them, and if they are not there,
    anywhere.

    Raises:
        MeasurementError: target at infinity, no dot found, dots blurred into one another, or no
            spot that can be measured.
    """
    every = microlenses_of(lattice, camera)
    pose = pose_of(values, lattice, every, target, distance, noise)
    pixel, vergence = camera.sensor.pixel, float(pose[0, 2])
    size = float(magnification(central_smms(camera), vergence)) / pixel
    radius = target.diameter / 2 * size
    _require_apart(target.spacing * size, 2 * radius, blur_px(camera, 1 / vergence))
    widest = max(float(blur(one, vergence)) for one in type_smms(camera)) / pixel
    reach = radius + widest / 2
    microlens = float(central_smms(camera).aperture) / 2
    doubts = np.zeros(len(every.rise)) if lattice.doubts_px is None else lattice.doubts_px
    stands, focus, wide = pose, 0.0, target.diameter * vergence
    # beyond halfway to the next dot a micro-image may show that one
    room = max(target.spacing * size / 2 - reach - BESIDE_PX, 0.0)
    rounds = 0
    while True:
        search = SEARCHES[rounds]
        rounds += 1
        (dot, lens), expected = _lit(replace(every, focus=focus), stands, wide, reach)
        lenses = every.those(lens)
        around = reach + BESIDE_PX + min(search, room)
        spots = measure_spots(
            values,
            sensor_pixel(camera.sensor, lenses.centres + expected.centroid),
            lattice.centres_px[lens],
            (lattice.outside_radius_px + RIM_PX, reach, around),
            widest,
            noise,
        )
        seen = Seen(
            lenses,
            dot,
            lens,
            sensor_position(camera.sensor, spots.centroids) - lenses.centres,
            (spots.variance + MODEL_PX**2) * pixel**2,
            doubts[lens] * pixel,
            lattice.radii_apart_px * pixel / microlens,
            spots.whole & (expected.light > LEAST_LIGHT),
            (0.0, KAPPA),
            wide,
        )
        if search > 0 and not seen.counted.any():
            continue
        if not seen.counted.any():
            raise _nothing(expected)
        stand = stand_of(seen, pose, stands, focus)
        moved = np.abs(stand.shown.centroid - expected.centroid).max() / pixel
        stands, focus = stand.values, stand.focus
        wide = target.diameter * float(np.mean(stands[np.unique(dot[seen.counted]), 2]))
        if rounds == len(SEARCHES) or (search == 0 and moved < SETTLED_PX):
            break
    return Found(spots, seen, stand, 1 / vergence, reach)


def _lit(
    every: Microlenses, stands: Array, size: float, reach_px: float
) -> tuple[tuple[Whole, Whole], Shown]:
    """Dots and microlenses of which any light falls on the sensor, and what they show."""
    (dot, lens), expected = shown_pairs(every, stands, size, FAINTEST)
    sensor = every.camera.sensor
    due = sensor_pixel(sensor, every.centres[lens] + expected.centroid)
    on = np.all((due > -reach_px) & (due < np.array(sensor.resolution) + reach_px), axis=1)
    return (dot[on], lens[on]), expected.those(on)


def _require_apart(apart: float, width: float, blur: float) -> None:
    if apart < APART * (width + blur):
        raise MeasurementError(
            f"four-dot picture: the dots' images are {apart:.1f} px apart and, with {blur:.1f} px"
            f" of blur, {width + blur:.1f} px wide; {APART * (width + blur):.1f} px apart are"
            " needed to separate them; take dots further apart, or move them towards the focus"
        )


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

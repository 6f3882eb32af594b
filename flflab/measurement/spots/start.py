"""Where to look for the dots of a picture: where the nominal camera puts them, or, where none is
there, where the spots say.
"""

import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import ProfileTable
from flflab.measurement.lattice.registration import blur_px, target_scales
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.blind import CLOSE_PX, FAINT, blind_law, darkness_of, spots_in
from flflab.measurement.spots.fit import illumination
from flflab.measurement.spots.law import HALF, SEARCH_PX, candidates_near, law_at, law_places
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]

WIDEST_SHIFT_PX = 30.0  # how far all dots together may be from where the nominal camera puts them
THERE = 0.9  # of light and spots: with less agreement dots are looked for everywhere
LEAST = 0.5  # the same: less is none


def where_to_look(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    table: ProfileTable,
    noise: SensorNoise,
) -> tuple[Array, float]:
    """The law by which spots are looked for, shape (5, 2), and the distance of the target it stands
    for, mm.

    It is the nominal camera's, moved sideways by up to 30 px. Where less than ``THERE`` of the
    light due is where that puts it, or of the spots seen where spots are due, they are matched
    blindly, and the law that agrees better with the picture is taken.

    Raises:
        MeasurementError: target at infinity, or light is due and the better of the two agrees with
            less than ``LEAST``.
    """
    across, along = target_scales(camera, distance)
    law, found = _moved(
        values,
        lattice,
        camera,
        target,
        law_at(1 / across, -along / across),
        table,
        noise,
        WIDEST_SHIFT_PX,
    )
    spots = spots_in(values, target.diameter / 2 / abs(across) / camera.sensor.pixel, noise)
    agreed = _agreed(found, spots, lattice, camera, target, law, blur_px(camera, distance))
    if agreed >= THERE:
        return law, distance
    blind = blind_law(spots, lattice, camera, target, distance)
    if blind is not None:
        there, found_there = _moved(
            values, lattice, camera, target, blind.law, table, noise, CLOSE_PX
        )
        if _agreed(
            found_there, spots, lattice, camera, target, there, blur_px(camera, blind.distance)
        ) > max(agreed, LEAST):
            return there, blind.distance
    if found is not None and agreed < LEAST:
        raise MeasurementError(
            f"four-dot picture: no pattern of dots {target.spacing:g} mm apart found:"
            f" {100 * agreed:.0f} % of the expected light is there ({100 * LEAST:.0f} % needed);"
            " check exposure, distance, and the target's spacing"
        )
    return law, distance


def _agreed(
    found: float | None,
    spots: Array,
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
    soft: float,
) -> float:
    """The lesser of the shares of the light due that is found (``found``), and of the spots seen
    (``soft`` px wide) that are due.
    """
    places, _ = law_places(
        lattice, camera, target, law, candidates_near(lattice, camera, target, law, SEARCH_PX)
    )
    if len(spots) == 0 or len(places) == 0:
        return 0.0
    _, nearest = KDTree(places).query(spots)
    off = spots - places[nearest]
    # all may be off together by the law's coarse shift, and each by what its micro-image cuts of
    # its blur
    due = np.hypot(*(off - np.median(off, axis=0)).T) < SEARCH_PX + soft / 2
    return min(found or 0.0, float(due.mean()))


@numba.njit(cache=True, nogil=True)
def _box_means(
    picture: npt.NDArray[np.generic], places: npt.NDArray[np.int64], half: int
) -> npt.NDArray[np.float64]:  # pragma: no cover - compiled
    """Means of squares of (2 half + 1)^2 px round places, cut at the picture's border; 0 where
    there is nothing.
    """
    means = np.zeros(len(places))
    for n in range(len(places)):
        total, count = 0.0, 0
        for row in range(
            max(0, places[n, 1] - half), min(picture.shape[0], places[n, 1] + half + 1)
        ):
            for column in range(
                max(0, places[n, 0] - half), min(picture.shape[1], places[n, 0] + half + 1)
            ):
                total += picture[row, column]
                count += 1
        means[n] = total / max(count, 1)
    return means


def _moved(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
    table: ProfileTable,
    noise: SensorNoise,
    widest_px: float,
) -> tuple[Array, float | None]:
    """The law moved by the common shift that puts most well lit places of dots on light, and the
    share found of the light due there.

    The shift goes in steps of half a radius; the share is None where no light is due.
    """
    columns, rows = camera.sensor.resolution
    size = float(np.hypot(*law[1])) / camera.sensor.pixel
    radius = target.diameter / 2 * size
    step = max(1.0, radius / 2)
    # beyond half a parallax from one micro-image to the next, one dot would be taken for another
    # view of it
    parallax = float(np.hypot(*(law[3] + [1.0, 0.0]))) * lattice.pitch_px
    most = int(min(widest_px, 0.4 * parallax, 0.4 * target.spacing * size) / step)
    every = candidates_near(lattice, camera, target, law, most * step)
    places, _ = law_places(lattice, camera, target, law, every)
    centres = lattice.centres_px[every.lens]
    i, j = (
        grid.ravel()
        for grid in np.meshgrid(
            np.arange(-most, most + 1), np.arange(-most, most + 1), indexing="ij"
        )
    )
    moved = places[None] + step * np.stack([i, j], axis=1)[:, None]
    at = np.rint(moved).astype(np.int64)
    seen = np.all((at >= 0) & (at < [columns, rows]), axis=2)
    light = np.zeros(seen.shape)
    light[seen] = _box_means(values, at[seen], int(radius / 2))
    light[seen] -= noise.offset_dn
    dark = darkness_of(values) - noise.offset_dn
    bright = (
        max(float(np.quantile(light[seen], 0.98)) - dark, FAINT * math.sqrt(noise.dark_variance))
        if seen.any()
        else 1.0
    )
    share = illumination(table, np.hypot(*np.moveaxis(moved - centres[None], 2, 0))) * seen
    due = np.where(share > HALF, share, 0.0)
    found = np.minimum(np.clip((light - dark) / bright, 0, None), due).sum(axis=1)
    # light where the dots should be counts for, its absence against; the nearest of equals wins
    best = int(np.argmax(found - 0.5 * due.sum(axis=1) - 1e-3 * np.hypot(i, j)))
    there = float(found[best] / due[best].sum()) if due[best].any() else None
    return law + law_at(0.0, 0.0, step * complex(i[best], j[best]) * camera.sensor.pixel), there

"""Where the dots of a picture lie: one law for all their spots, found round where the nominal camera puts them.

s - c = shift + (o_x, o_y, c_x, c_y) of the law, all mm: a spot's place s in the micro-image of centre c, o the dot on the target.
"""

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.profile import ProfileTable
from flflab.analysis.registration import sensor_pixel, sensor_position
from flflab.analysis.spots import flat_centroids, illumination, lit
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

WIDEST_SHIFT_PX = 30.0  # how far all dots together may be from where the nominal camera puts them
SEARCH_PX = 8.0  # how far each may then still be
HALF = 0.5  # of the dot's expected light: a view has at least this


@dataclass(frozen=True)
class Candidates:
    """Every pair of a dot and a micro-image it may be seen in."""

    dot: Whole
    lens: Whole


def law_places(lattice: Lattice, camera: Camera, target: FourDot, law: Array, candidates: Candidates) -> tuple[Array, Array]:
    """Where a law puts each candidate's spot, px, and the regressors of the law, shape (n, 5).

    The same numbers with a turn serve x and y.
    """
    centre = sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
    dots = target.centres[candidates.dot]
    regressors = np.concatenate([np.ones((len(dots), 1)), dots, centre], axis=1)
    return sensor_pixel(camera.sensor, centre + regressors @ law), regressors


def candidates_near(lattice: Lattice, camera: Camera, target: FourDot, law: Array, reach_px: float) -> Candidates:
    """Dots and micro-images so near to where a law puts a spot that, ``reach_px`` wide, it is seen there."""
    lens, dot = (grid.ravel() for grid in np.meshgrid(np.arange(len(lattice.centres_px)), np.arange(len(target.centres)), indexing="ij"))
    every = Candidates(dot, lens)
    places, _ = law_places(lattice, camera, target, law, every)
    near = np.hypot(*(places - lattice.centres_px[lens]).T) < lattice.outside_radius_px + reach_px
    columns, rows = camera.sensor.resolution
    near &= np.all((places > -reach_px) & (places < np.array([columns, rows]) + reach_px), axis=1)
    return Candidates(dot[near], lens[near])


def register(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
    spread: float,
    sizes: Array,
    table: ProfileTable,
    noise: SensorNoise,
) -> tuple[Array, float]:
    """The law that the spots themselves follow, and a spot's radius in px: centroids in shrinking windows, robustly regressed."""
    radius = target.diameter / 2 * float(np.hypot(*law[1])) / camera.sensor.pixel
    nominal, law = law, law + _shift(values, lattice, camera, target, law, radius, table, noise)
    for search in (SEARCH_PX, SEARCH_PX / 2, 3.0):
        candidates = candidates_near(lattice, camera, target, law, 0.0)
        places, regressors = law_places(lattice, camera, target, law, candidates)
        half = math.ceil(radius + spread / 2 + search)
        own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), sizes, table)
        centroids, total = flat_centroids(values, places, half, radius, own, noise)
        whole = _well_lit(places, centroids, total, lattice, candidates, radius, table)
        if not whole.any():
            return law, radius
        offsets = sensor_position(camera.sensor, centroids) - sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
        law = regress(law, nominal, regressors[whole], offsets[whole], camera.sensor.pixel)
        radius = target.diameter / 2 * float(np.hypot(*law[1])) / camera.sensor.pixel
    return law, radius


@numba.njit(cache=True, nogil=True)
def _box_means(
    picture: npt.NDArray[np.generic], places: npt.NDArray[np.int64], half: int
) -> npt.NDArray[np.float64]:  # pragma: no cover - compiled
    """Means of squares of (2 half + 1)^2 px round places, cut at the picture's border; 0 where there is nothing."""
    means = np.zeros(len(places))
    for n in range(len(places)):
        total, count = 0.0, 0
        for row in range(max(0, places[n, 1] - half), min(picture.shape[0], places[n, 1] + half + 1)):
            for column in range(max(0, places[n, 0] - half), min(picture.shape[1], places[n, 0] + half + 1)):
                total += picture[row, column]
                count += 1
        means[n] = total / max(count, 1)
    return means


def _shift(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
    radius: float,
    table: ProfileTable,
    noise: SensorNoise,
) -> Array:
    """The common shift, in steps of half a radius, that puts most well lit places of dots on light; as a change of the law."""
    columns, rows = camera.sensor.resolution
    step = max(1.0, radius / 2)
    # beyond half a parallax from one micro-image to the next, one dot would be taken for another view of it
    parallax = float(np.hypot(*(law[3] + [1.0, 0.0]))) * lattice.pitch_px
    most = int(min(WIDEST_SHIFT_PX, 0.4 * parallax, 0.4 * target.spacing * float(np.hypot(*law[1])) / camera.sensor.pixel) / step)
    every = candidates_near(lattice, camera, target, law, most * step)
    places, _ = law_places(lattice, camera, target, law, every)
    centres = lattice.centres_px[every.lens]
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(-most, most + 1), np.arange(-most, most + 1), indexing="ij"))
    moved = places[None] + step * np.stack([i, j], axis=1)[:, None]
    at = np.rint(moved).astype(np.int64)
    seen = np.all((at >= 0) & (at < [columns, rows]), axis=2)
    light = np.zeros(seen.shape)
    light[seen] = _box_means(values, at[seen], int(radius / 2))
    light[seen] -= noise.offset_dn
    dark = float(np.median(np.asarray(values[:: max(1, rows // 300), :: max(1, columns // 300)], dtype=np.float64))) - noise.offset_dn
    bright = max(float(np.quantile(light[seen], 0.98)) - dark, 1e-9) if seen.any() else 1.0
    share = illumination(table, np.hypot(*np.moveaxis(moved - centres[None], 2, 0))) * seen
    # light where the dots should be counts for, its absence against; the nearest of equals wins
    score = np.where(share > HALF, np.clip((light - dark) / bright, 0, share) - 0.5 * share, 0.0).sum(axis=1) - 1e-3 * np.hypot(i, j)
    best = int(np.argmax(score))
    change = np.zeros((5, 2))
    change[0] = step * np.array([i[best], j[best]]) * camera.sensor.pixel
    return change


def _well_lit(
    places: Array, centroids: Array, total: Array, lattice: Lattice, candidates: Candidates, radius: float, table: ProfileTable
) -> npt.NDArray[np.bool_]:
    """Spots that hold enough light, where there is enough, to say where the dots are.

    Raises:
        MeasurementError: none, though the nominal camera puts some well inside a bright field.
    """
    own = lattice.centres_px[candidates.lens]
    lit = illumination(table, np.hypot(*(centroids - own).T)) > HALF
    enough = total > 0.25 * np.pi * radius**2 * max(float(np.quantile(total, 0.98)) / (np.pi * radius**2), 0.1) if len(total) else lit
    expected = np.hypot(*(places - own).T) + WIDEST_SHIFT_PX < (lattice.inside_radius_px + lattice.outside_radius_px) / 2
    if expected.any() and not (lit & enough).any():
        raise MeasurementError("four-dot picture: no dot was found where the camera puts them; check exposure, target and distance")
    return lit & enough


def regress(law: Array, nominal: Array, regressors: Array, offsets: Array, pixel: float) -> Array:
    """Update the law by a shift, and by one complex factor for dots and one for centres (scale and turn), outliers left out."""
    rest = offsets - regressors @ law
    z, o, c = rest @ [1, 1j], regressors[:, 1:3] @ [1, 1j], regressors[:, 3:5] @ [1, 1j]
    # few spots, or dots that are seen once each, cannot tell the factors apart: then those of the nominal camera hold
    prior = np.diag([0.0, 1e-3, 1e-3]) * len(z)
    off = (law - nominal)[[0, 1, 3]] @ [1, 1j]
    weight = np.ones(len(z))
    step = np.zeros(3, dtype=np.complex128)
    design = np.stack([np.ones(len(z)), o, c], axis=1)
    for _ in range(5):
        normal = (design.conj().T * weight) @ design
        step = np.linalg.solve(normal + prior, (design.conj().T * weight) @ z - prior @ off)
        left = np.abs(z - design @ step)
        limit = max(3 * float(np.median(left)), 0.3 * pixel)
        weight = np.minimum(1.0, limit / np.maximum(left, 1e-12)) ** 2
    shift, dots, centres = step
    change = np.array([[part.real, part.imag] for part in (shift, dots, 1j * dots, centres, 1j * centres)])
    return law + change

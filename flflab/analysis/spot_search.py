"""The images of round dots in a picture of many micro-images: found round where the nominal camera puts them, and fitted."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.clipping import FAR_PX, cut_spots, pupils_of, step_of_cut_spots
from flflab.analysis.lattice import Lattice
from flflab.analysis.lowest import lowest
from flflab.analysis.noise import SensorNoise
from flflab.analysis.profile import ProfileTable
from flflab.analysis.registration import require_shape, sensor_pixel, sensor_position, target_scales, tilted_scales
from flflab.analysis.spot_focus import SHARPEST_PX, Focus, nominal_focus
from flflab.analysis.spot_profile import defocused_dot
from flflab.analysis.spots import LIT, Lit, Spots, fit_spots, flat_centroids, illumination, illumination_table, lit
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, microlens_limits
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

WIDEST_SHIFT_PX = 30.0  # how far all dots together may be from where the nominal camera puts them
SEARCH_PX = 8.0  # how far each may then still be
MOST_ROUNDS, SETTLED_PX = 12, 0.001  # a further round moves centres and radius by a tenth of that
SETTLED_BLUR_PX = 0.001  # of the focus, a tenth of its uncertainty: it moves all cut spots alike, and depth with them
SOFTER, SOFTER_PX = 0.03, 0.01  # share of the blur, and px: as much more leaves the centres of whole spots in few micro-images alone
NEAR_PX = 1.0  # of blur, up to which edges hardly tell the sides of the focus apart
HALF = 0.5  # of the dot's expected light: a view has at least this


@dataclass(frozen=True)
class Candidates:
    """Every pair of a dot and a micro-image it may be seen in."""

    dot: Whole
    lens: Whole


@dataclass(frozen=True)
class SeenSpots:
    """The spots of a picture, one for each candidate, and what they were taken for.

    Attributes:
        spots: fitted.
        candidates: dot and micro-image of each.
        law: where the spots lie, as ``law_places`` reads it, shape (5, 2).
        radius: of a spot in focus, px.
        spread: diameter of the blur, px.
        focus: how far it is off the nominal, as the cut spots show it.
        table: how light falls off within a micro-image.
    """

    spots: Spots
    candidates: Candidates
    law: Array
    radius: float
    spread: float
    focus: Focus
    table: ProfileTable


def find_spots(
    values: npt.NDArray[Any], lattice: Lattice, camera: Camera, target: FourDot, distance: float, noise: SensorNoise
) -> SeenSpots:
    """Find the images of the dots round where the nominal camera puts them, to 30 px.

    Raises:
        MeasurementError: target at infinity, or no dot found where the camera puts some.
    """
    across, along = target_scales(camera, distance)
    law = np.array([[0.0, 0.0], [1 / across, 0.0], [0.0, 1 / across], [-along / across, 0.0], [0.0, -along / across]])
    spread = float(blur(central_smms(camera), 1 / distance)) / camera.sensor.pixel
    table = illumination_table(lattice)
    nominal = law
    sizes = 1 / tilted_scales(lattice, central_smms(camera), distance)
    law, radius = _register(values, lattice, camera, target, law, spread, sizes, table, noise)
    candidates = _candidates(lattice, camera, target, law, _half_width(radius, spread))
    places, regressors = law_places(lattice, camera, target, law, candidates)
    own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), sizes, table)
    pupils = pupils_of(lattice, candidates.lens, camera, distance)
    spots = fit_spots(values, places, _half_width(radius, spread), own, defocused_dot(radius, spread), noise)
    reach = radius + spread / 2
    cut = cut_spots(spots, own, lattice, reach, pupils)
    whole = np.setdiff1d(np.arange(len(places)), cut)
    limited = bool(microlens_limits(central_smms(camera), 1 / distance))
    focus = nominal_focus(0.0 if pupils is None else pupils.blur, known=not limited)

    def settled(seen: SeenSpots, moved: float) -> SeenSpots:
        # spots and focus want the radius, the radius the law and the law the spots: a step of each, until they agree
        spots, law, radius, spread, focus, fitted = seen.spots, seen.law, seen.radius, seen.spread, seen.focus, (seen.radius, seen.spread)
        for _ in range(MOST_ROUNDS):
            before, last, focused, half = spots.centres, radius, focus.blur_px, _half_width(radius, spread)
            if limited and not _lit(spots, own)[cut].any():
                spread = _softness(values, spots, whole, half, own, radius, spread, noise)
            if abs(radius - fitted[0]) > SETTLED_PX or abs(spread - fitted[1]) > max(SOFTER * spread, SOFTER_PX):
                again = fit_spots(values, before[whole], half, own.those(whole), defocused_dot(radius, spread), noise)
                spots, fitted = spots.with_those(whole, again), (radius, spread)
            spots, focus = step_of_cut_spots(values, spots, cut, half, own, pupils, focus, radius, noise, moved)
            bright = _lit(spots, own)
            if limited and bright[cut].any():
                spread = focus.softness_px
            # the place of one that the sensor's border cuts depends on the radius, which must not depend on it
            good = bright & np.all((spots.centres > reach) & (spots.centres < np.asarray(camera.sensor.resolution) - 1 - reach), axis=1)
            if not good.any():
                break
            offsets = sensor_position(camera.sensor, spots.centres) - sensor_position(camera.sensor, own.centres)
            law = _regress(law, nominal, regressors[good], offsets[good], camera.sensor.pixel)
            radius = target.diameter / 2 * float(np.hypot(*law[1])) / camera.sensor.pixel
            far, moved = moved > FAR_PX, float(np.abs(spots.centres - before)[bright].max())
            if max(moved, abs(radius - last)) < SETTLED_PX and abs(focus.blur_px - focused) < SETTLED_BLUR_PX and not far:
                break
        return SeenSpots(spots, candidates, law, radius, spread, focus, table)

    def misfit(seen: SeenSpots) -> float:
        return float(seen.spots.chi2_per_pixel[cut][_lit(seen.spots, own)[cut]].sum())

    seen = settled(SeenSpots(spots, candidates, law, radius, spread, focus, table), math.inf)
    if limited and 3 * seen.focus.uncertainty_px < abs(seen.focus.blur_px) < NEAR_PX:
        # a blur on the wrong side of the focus is a lesser misfit than any near it
        other = settled(replace(seen, focus=replace(seen.focus, blur_px=-seen.focus.blur_px)), 0.0)
        seen = min(seen, other, key=misfit)
    return seen


def _lit(spots: Spots, own: Lit) -> npt.NDArray[np.bool_]:
    """Which spots are seen in enough light to say where dots are, and in which focus."""
    return (illumination(own.table, np.hypot(*(spots.centres - own.centres).T)) > LIT) & spots.seen


def _softness(
    values: npt.NDArray[Any], spots: Spots, whole: Whole, half: int, own: Lit, radius: float, spread: float, noise: SensorNoise
) -> float:
    """Diameter of the disc, px, through which whole spots fit best: where none is cut, nothing else tells it."""
    mine = own.those(whole)
    bright = _lit(spots, own)[whole]
    if not bright.any():
        return spread

    def misfit(square: float) -> float:
        fitted = fit_spots(values, spots.centres[whole], half, mine, defocused_dot(radius, math.sqrt(square)), noise)
        return float(fitted.chi2_per_pixel[bright].sum()) * (2 * half + 1) ** 2

    squares = [max(spread, SHARPEST_PX) ** 2 + step for step in (0.0, 0.01, 0.04)]
    return math.sqrt(lowest(misfit, squares, SHARPEST_PX**2))


def _half_width(radius: float, spread: float) -> int:
    """Of the windows that hold a spot, px."""
    return math.ceil(radius + spread / 2 + 3)


def usable_pixels(
    picture: npt.NDArray[np.generic], white: npt.NDArray[np.generic] | None, camera: Camera, kind: str, noise: SensorNoise
) -> npt.NDArray[Any]:
    """The picture as it is, or, where the white one is saturated, a copy that is saturated there too.

    Raises:
        MeasurementError: wrong shape, or not finite.
    """
    require_shape(picture, camera, kind)
    values = np.ascontiguousarray(picture)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise MeasurementError(f"{kind} picture: every pixel must be a finite number")
    if white is not None:
        require_shape(white, camera, "white")
        # of ten million pixels a maximum costs less than a comparison
        if float(np.fmax.reduce(white, axis=None)) >= noise.full_scale_dn:
            return np.where(np.asarray(white, dtype=np.float32) >= noise.full_scale_dn, noise.full_scale_dn, values.astype(np.float32))
    return values


def law_places(lattice: Lattice, camera: Camera, target: FourDot, law: Array, candidates: Candidates) -> tuple[Array, Array]:
    """Where a law puts each candidate's spot, px, and the regressors of the law, shape (n, 5).

    s - c = shift + (o_x, o_y, c_x, c_y) of the law, all mm; the same numbers with a turn serve x and y.
    """
    centre = sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
    dots = target.centres[candidates.dot]
    regressors = np.concatenate([np.ones((len(dots), 1)), dots, centre], axis=1)
    return sensor_pixel(camera.sensor, centre + regressors @ law), regressors


def _candidates(lattice: Lattice, camera: Camera, target: FourDot, law: Array, reach_px: float) -> Candidates:
    lens, dot = (grid.ravel() for grid in np.meshgrid(np.arange(len(lattice.centres_px)), np.arange(len(target.centres)), indexing="ij"))
    every = Candidates(dot, lens)
    places, _ = law_places(lattice, camera, target, law, every)
    near = np.hypot(*(places - lattice.centres_px[lens]).T) < lattice.outside_radius_px + reach_px
    columns, rows = camera.sensor.resolution
    near &= np.all((places > -reach_px) & (places < np.array([columns, rows]) + reach_px), axis=1)
    return Candidates(dot[near], lens[near])


def _register(
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
        candidates = _candidates(lattice, camera, target, law, 0.0)
        places, regressors = law_places(lattice, camera, target, law, candidates)
        half = math.ceil(radius + spread / 2 + search)
        own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), sizes, table)
        centroids, total = flat_centroids(values, places, half, radius, own, noise)
        whole = _well_lit(places, centroids, total, lattice, candidates, radius, table)
        if not whole.any():
            return law, radius
        offsets = sensor_position(camera.sensor, centroids) - sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
        law = _regress(law, nominal, regressors[whole], offsets[whole], camera.sensor.pixel)
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
    every = _candidates(lattice, camera, target, law, most * step)
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


def _regress(law: Array, nominal: Array, regressors: Array, offsets: Array, pixel: float) -> Array:
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

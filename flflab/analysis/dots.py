"""In which micro-images each dot of a four-dot target is seen, where exactly, and where that puts the dot in space."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.clipping import clipping_shift
from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.profile import ProfileTable
from flflab.analysis.registration import require_shape, sensor_pixel, sensor_position, target_scales
from flflab.analysis.spot_profile import SpotProfile, defocused_dot
from flflab.analysis.spots import Spots, fit_spots, flat_centroids, illumination, illumination_table, lit
from flflab.analysis.triangulation import triangulate
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.optics.focus import blur
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

WIDEST_SHIFT_PX = 30.0  # how far all dots together may be from where the nominal camera puts them
SEARCH_PX = 8.0  # how far each may then still be
FIT_ERROR_PX = 0.001  # of a spot's centre
CUT_ERROR_PX = 0.002  # more where the micro-image cuts its cone
BLUR_ERROR = 0.005  # and there for each px of nominal blur; these found with exact pictures
HALF = 0.5  # of the dot's expected light: a view has at least this


@dataclass(frozen=True)
class DotViews:
    """The views of one dot.

    Attributes:
        dot: number of the dot: corners (-,-), (+,-), (-,+), (+,+) in (x, y).
        views: in how many micro-images it is seen: its centre lies in their useful region, with half its light at least.
        views_uncertain: number of micro-images whose decision lies within two standard uncertainties of its limit.
        indices: lattice indices of the views' micro-images, shape (n, 2).
        centres_px: centres of the dot's images, shape (n, 2).
        centre_uncertainty_px: standard uncertainty of each centre in one coordinate, shape (n,).
        position_mm: of the dot in the world (main lens at z = 0, target at negative z), given the nominal camera; nan where fewer
            than two views leave it open, shape (3,).
        uncertainty_mm: standard uncertainties from the noise, shape (3,).
    """

    dot: int
    views: int
    views_uncertain: int
    indices: Whole
    centres_px: Array
    centre_uncertainty_px: Array
    position_mm: Array
    uncertainty_mm: Array


@dataclass(frozen=True)
class Candidates:
    """Every pair of a dot and a micro-image it may be seen in."""

    dot: Whole
    lens: Whole


def count_views(
    picture: npt.NDArray[np.generic],
    white: npt.NDArray[np.generic] | None,
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> tuple[DotViews, ...]:
    """Find the images of each dot, decide which of them are views, and triangulate the dots.

    The nominal camera only says where to look first, to 30 px; one common shift, turn, magnification and parallax are then fitted
    to the spots themselves. A view counts when the fitted centre lies in the useful region as measured: on the sensor, illumination
    at least the camera's ``minimum_illumination``, outside every neighbour's circle of more than ``maximum_crosstalk``, and within
    the circle in which the dot keeps half its light.

    Args:
        picture: DN, [row, col].
        white: white picture of the same configuration; pixels saturated in it are left out. None: none was taken.
        lattice: measured from the white picture.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: wrong shape, target at infinity, or no dot found where the camera puts some.
    """
    values = _usable(picture, white, camera, target.kind, noise)
    seen = find_spots(values, lattice, camera, target, distance, noise)
    spots, candidates, law, radius, spread = seen.spots, seen.candidates, seen.law, seen.radius, seen.spread
    away = spots.centres - lattice.centres_px[candidates.lens]
    shift = clipping_shift(away, lattice, camera, distance, radius, seen.table, seen.profile, noise)
    spots = replace(spots, centres=spots.centres - shift)
    # the brightest half of the well lit spots are whole: they say what a dot's full light is
    level = _full_light(spots, candidates, lattice)
    doubts = _centre_doubts(spots, candidates, lattice, radius, spread)
    agreed, agreed_doubts = _agreed_centres(spots, doubts, candidates, lattice, camera, target, law)
    decided = Decided(spots, doubts, np.where((agreed_doubts < doubts)[:, None], agreed, spots.centres), np.minimum(agreed_doubts, doubts))
    return tuple(_views(dot, decided, candidates, lattice, camera, level, distance) for dot in range(len(target.centres)))


@dataclass(frozen=True)
class SeenSpots:
    """The spots of a picture, one for each candidate, and what they were taken for.

    Attributes:
        spots: fitted.
        candidates: dot and micro-image of each.
        law: where the spots lie, as ``_places`` reads it, shape (5, 2).
        radius: of a spot in focus, px.
        spread: diameter of the blur, px.
        table: illumination of a micro-image.
        profile: of a spot.
    """

    spots: Spots
    candidates: Candidates
    law: Array
    radius: float
    spread: float
    table: ProfileTable
    profile: SpotProfile


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
    law, radius = _register(values, lattice, camera, target, law, spread, table, noise)
    half = math.ceil(radius + spread / 2 + 3)
    candidates = _candidates(lattice, camera, target, law, half)
    places, _ = _places(lattice, camera, target, law, candidates)
    profile = defocused_dot(radius, spread)
    own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), table)
    spots = fit_spots(values, places, half, own, profile, noise)
    return SeenSpots(spots, candidates, law, radius, spread, table, profile)


def _usable(
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
        blind = np.asarray(white, dtype=np.float32) >= noise.full_scale_dn
        if blind.any():
            return np.where(blind, noise.full_scale_dn, values.astype(np.float32))
    return values


def _places(lattice: Lattice, camera: Camera, target: FourDot, law: Array, candidates: Candidates) -> tuple[Array, Array]:
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
    places, _ = _places(lattice, camera, target, law, every)
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
    table: ProfileTable,
    noise: SensorNoise,
) -> tuple[Array, float]:
    """The law that the spots themselves follow, and a spot's radius in px: centroids in shrinking windows, robustly regressed."""
    radius = target.diameter / 2 * float(np.hypot(*law[1])) / camera.sensor.pixel
    law = law + _shift(values, lattice, camera, target, law, radius, noise)
    for search in (SEARCH_PX, SEARCH_PX / 2, 3.0):
        candidates = _candidates(lattice, camera, target, law, 0.0)
        places, regressors = _places(lattice, camera, target, law, candidates)
        half = math.ceil(radius + spread / 2 + search)
        own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), table)
        centroids, total = flat_centroids(values, places, half, radius, own, noise)
        whole = _well_lit(places, centroids, total, lattice, candidates, radius)
        if not whole.any():
            return law, radius
        offsets = sensor_position(camera.sensor, centroids) - sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
        law = _regress(law, regressors[whole], offsets[whole], camera.sensor.pixel)
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
    values: npt.NDArray[Any], lattice: Lattice, camera: Camera, target: FourDot, law: Array, radius: float, noise: SensorNoise
) -> Array:
    """The common shift, in steps of half a radius, that puts most well lit places of dots on light; as a change of the law."""
    columns, rows = camera.sensor.resolution
    step = max(1.0, radius / 2)
    # beyond half a parallax from one micro-image to the next, one dot would be taken for another view of it
    parallax = float(np.hypot(*(law[3] + [1.0, 0.0]))) * lattice.pitch_px
    most = int(min(WIDEST_SHIFT_PX, 0.4 * parallax, 0.4 * target.spacing * float(np.hypot(*law[1])) / camera.sensor.pixel) / step)
    every = _candidates(lattice, camera, target, law, most * step)
    places, _ = _places(lattice, camera, target, law, every)
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
    share = illumination(lattice, np.hypot(*np.moveaxis(moved - centres[None], 2, 0))) * seen
    # light where the dots should be counts for, its absence against; the nearest of equals wins
    score = np.where(share > HALF, np.clip((light - dark) / bright, 0, share) - 0.5 * share, 0.0).sum(axis=1) - 1e-3 * np.hypot(i, j)
    best = int(np.argmax(score))
    change = np.zeros((5, 2))
    change[0] = step * np.array([i[best], j[best]]) * camera.sensor.pixel
    return change


def _well_lit(
    places: Array, centroids: Array, total: Array, lattice: Lattice, candidates: Candidates, radius: float
) -> npt.NDArray[np.bool_]:
    """Spots that hold enough light, where there is enough, to say where the dots are.

    Raises:
        MeasurementError: none, though the nominal camera puts some well inside a bright field.
    """
    own = lattice.centres_px[candidates.lens]
    lit = illumination(lattice, np.hypot(*(centroids - own).T)) > HALF
    enough = total > 0.25 * np.pi * radius**2 * max(float(np.quantile(total, 0.98)) / (np.pi * radius**2), 0.1) if len(total) else lit
    expected = np.hypot(*(places - own).T) + WIDEST_SHIFT_PX < (lattice.inside_radius_px + lattice.outside_radius_px) / 2
    if expected.any() and not (lit & enough).any():
        raise MeasurementError("four-dot picture: no dot was found where the camera puts them; check exposure, target and distance")
    return lit & enough


def _regress(law: Array, regressors: Array, offsets: Array, pixel: float) -> Array:
    """Update the law by a shift, and by one complex factor for dots and one for centres (scale and turn), outliers left out."""
    rest = offsets - regressors @ law
    z, o, c = rest @ [1, 1j], regressors[:, 1:3] @ [1, 1j], regressors[:, 3:5] @ [1, 1j]
    # few spots, or all of one dot, cannot tell the factors apart: a weak prior at 0 keeps them
    prior = np.diag([0.0, 1e-3, 1e-3]) * len(z)
    weight = np.ones(len(z))
    step = np.zeros(3, dtype=np.complex128)
    design = np.stack([np.ones(len(z)), o, c], axis=1)
    for _ in range(5):
        normal = (design.conj().T * weight) @ design
        step = np.linalg.solve(normal + prior, (design.conj().T * weight) @ z)
        left = np.abs(z - design @ step)
        limit = max(3 * float(np.median(left)), 0.3 * pixel)
        weight = np.minimum(1.0, limit / np.maximum(left, 1e-12)) ** 2
    shift, dots, centres = step
    change = np.array([[part.real, part.imag] for part in (shift, dots, 1j * dots, centres, 1j * centres)])
    return law + change


def _full_light(spots: Spots, candidates: Candidates, lattice: Lattice) -> float:
    """Brightness of a whole dot over that of a white target: the well lit spots', or 1 (equal exposures) where there are none."""
    away = np.hypot(*(spots.centres - lattice.centres_px[candidates.lens]).T)
    lit = (illumination(lattice, away) > HALF) & np.isfinite(spots.covariance[:, 2, 2]) & (spots.brightness > 0.05)
    if not lit.any():
        return 1.0
    bright = spots.brightness[lit]
    return float(np.median(bright[bright >= np.median(bright)]))


def _margins(centres: Array, lens: Whole, lattice: Lattice, camera: Camera) -> tuple[Array, Array]:
    """How far each centre lies inside its micro-image's useful region, px (negative: outside), and how sure the region's edge is."""
    own = lattice.centres_px[lens]
    away = np.hypot(*(centres - own).T)
    limit = min(_radius_of(lattice, camera.useful.minimum_illumination), (lattice.inside_radius_px + lattice.outside_radius_px) / 2)
    blocked = _radius_of(lattice, camera.useful.maximum_crosstalk)
    margin = limit - away
    width, height = camera.sensor.resolution
    low, high = np.array([-0.5, -0.5]), np.array([width - 0.5, height - 0.5])
    for edge in (centres - low, high - centres):
        margin = np.minimum(margin, edge.min(axis=1))
    centre_inside = np.all((own >= low) & (own <= high), axis=1)
    for i in range(-2, 3):
        for j in range(-2, 3):
            step = lattice.vectors_px @ np.array([i, j], dtype=np.float64)
            if (i, j) != (0, 0) and np.hypot(*step) < limit + blocked + 1:
                margin = np.minimum(margin, np.hypot(*(centres - own - step).T) - blocked)
    edge_sure = math.hypot(lattice.inside_uncertainty_px, lattice.outside_uncertainty_px)
    return np.where(centre_inside, margin, -np.inf), np.full(len(centres), edge_sure)


def _radius_of(lattice: Lattice, share: float) -> float:
    """Radius at which the measured illumination falls to ``share``."""
    if share <= 0:
        return lattice.outside_radius_px
    r = np.linspace(lattice.outside_radius_px, lattice.inside_radius_px, 4001)
    return float(np.interp(share, illumination(lattice, r), r))


@dataclass(frozen=True)
class Decided:
    """Spots, and the places by which views are decided.

    A spot that its micro-image cuts is known better from all other spots than from itself. Uncertainties are standard, px, in one
    coordinate.
    """

    spots: Spots
    doubts: Array
    places: Array
    place_doubts: Array


def _centre_doubts(spots: Spots, candidates: Candidates, lattice: Lattice, radius: float, spread: float) -> Array:
    noise = np.sqrt(np.maximum(spots.covariance[:, 0, 0], spots.covariance[:, 1, 1]) * np.maximum(spots.chi2_per_pixel, 1.0))
    away = np.hypot(*(spots.centres - lattice.centres_px[candidates.lens]).T)
    cut = np.where(away + radius + spread / 2 > lattice.inside_radius_px, np.hypot(CUT_ERROR_PX, BLUR_ERROR * spread), 0.0)
    return np.sqrt(np.where(np.isfinite(noise), noise, 100.0) ** 2 + FIT_ERROR_PX**2 + cut**2)


def _agreed_centres(
    spots: Spots,
    doubts: Array,
    candidates: Candidates,
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
) -> tuple[Array, Array]:
    """Where one law for all spots puts each, px, and how sure that is: shift, complex factor of dots and of micro-image centres."""
    _, regressors = _places(lattice, camera, target, law, candidates)
    centre = sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
    z = (sensor_position(camera.sensor, spots.centres) - centre - regressors @ law) @ [1, 1j] / camera.sensor.pixel
    o, c = regressors[:, 1:3] @ [1, 1j], regressors[:, 3:5] @ [1, 1j]
    design = np.stack([np.ones(len(z)), o, c], axis=1) / [1.0, np.abs(o).max(initial=1e-9), np.abs(c).max(initial=1e-9)]
    weight = np.where((doubts < 10) & (spots.brightness > 0.05), 1 / doubts**2, 0.0)
    step, covariance, excess = np.zeros(3, dtype=np.complex128), np.eye(3), 1.0
    for _ in range(4):
        covariance = np.linalg.inv((design.conj().T * weight) @ design + np.eye(3) / SEARCH_PX**2)
        step = covariance @ ((design.conj().T * weight) @ z)
        left = np.abs(z - design @ step)
        excess = max(1.0, float((weight * left**2).sum()) / max(2 * np.count_nonzero(weight) - 6, 1))
        weight = np.where(left > 6 * doubts * math.sqrt(excess), 0.0, weight)
    shift = design @ step
    spread = np.sqrt(np.einsum("nk,km,nm->n", design, covariance, design.conj()).real * excess)
    places, _ = _places(lattice, camera, target, law, candidates)
    return places + np.stack([shift.real, shift.imag], axis=1), np.hypot(spread, FIT_ERROR_PX)


def _views(
    dot: int,
    decided: Decided,
    candidates: Candidates,
    lattice: Lattice,
    camera: Camera,
    level: float,
    distance: float,
) -> DotViews:
    mine = np.flatnonzero(candidates.dot == dot)
    spots, lens = decided.spots, candidates.lens[mine]
    margin, edge = _margins(decided.places[mine], lens, lattice, camera)
    doubt = np.hypot(decided.place_doubts[mine], edge)
    light = spots.brightness[mine] / level
    light_doubt = np.sqrt(np.minimum(spots.covariance[mine, 2, 2], 1.0)) / level
    counted = (margin >= 0) & (light >= HALF)
    near_edge = (np.abs(margin) < 2 * doubt) & (light > HALF - 2 * light_doubt)
    near_dark = (np.abs(light - HALF) < 2 * light_doubt) & (margin > -2 * doubt)
    centres, sure = spots.centres[mine][counted], decided.doubts[mine][counted]
    position, uncertainty = triangulate(centres, sure, lens[counted], lattice, camera, distance)
    return DotViews(
        dot=dot,
        views=int(counted.sum()),
        views_uncertain=int(np.count_nonzero(near_edge | near_dark)),
        indices=lattice.indices[lens[counted]],
        centres_px=centres,
        centre_uncertainty_px=sure,
        position_mm=position,
        uncertainty_mm=uncertainty,
    )

"""In which micro-images each dot of a four-dot target is seen, where exactly, and where that puts
the dot in space.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.dots.triangulation import departures_px, triangulate
from flflab.measurement.lattice.falloff import unshaded
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import ProfileTable
from flflab.measurement.lattice.registration import sensor_position
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.fit import Spots, illumination
from flflab.measurement.spots.law import HALF, SEARCH_PX, Candidates, law_places
from flflab.measurement.spots.search import find_spots, usable_pixels
from flflab.optics.camera import Camera
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

CLEARLY = 2.0  # standard deviations of chi squared by which views must scatter more than stated
SHARED = 2, 14  # where in ``common_mm`` the lattice's part begins, and the tilt's
FIT_ERROR_PX = 0.0001  # of a spot's centre; pictures without noise show this much
OF_BLUR = 0.07  # of the blur's diameter, by which a cut spot's centre is misplaced
CUT_ERROR_PX = 0.0002  # more where the micro-image cuts its cone


@dataclass(frozen=True)
class DotViews:
    """The views of one dot.

    Attributes:
        dot: number of the dot: corners (-,-), (+,-), (-,+), (+,+) in (x, y).
        views: in how many micro-images it is seen: its centre lies in their useful region, with
            half its light at least.
        views_uncertain: number of micro-images whose decision lies within two standard
            uncertainties of its limit.
        indices: lattice indices of the views' micro-images, shape (n, 2).
        centres_px: centres of the dot's images, shape (n, 2).
        centre_uncertainty_px: standard uncertainties of each centre's x and y, shape (n, 2).
        position_mm: of the dot in the world (main lens at z = 0, target at negative z), given the
            nominal camera; nan where fewer than two views leave it open, shape (3,).
        uncertainty_mm: its standard uncertainties, shape (3,).
        common_mm: how it moves with a standard uncertainty of each thing that all dots of the
            picture share: focus and radius, the lattice, the tilt of the array; part of
            ``uncertainty_mm``, shape (3, k).
        at_limit_px: images whose decision is not sure, shape (m, 2).
        misfit: rms of what is left of the spots' light beyond noise, as a share of it.
    """

    dot: int
    views: int
    views_uncertain: int
    indices: Whole
    centres_px: Array
    centre_uncertainty_px: Array
    position_mm: Array
    uncertainty_mm: Array
    common_mm: Array
    at_limit_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
    misfit: float = 0.0

    @property
    def own_mm(self) -> Array:
        """What of ``uncertainty_mm`` is this dot's own: of its spots and their lenses' places."""
        shared = np.sum(self.common_mm**2, axis=1)
        return np.sqrt(np.maximum(self.uncertainty_mm**2 - shared, 0.0))

    @property
    def by_cause_mm(self) -> dict[str, Array]:
        """What of it dots of a picture share, by name, each of shape (3,)."""
        parts = np.split(self.common_mm, SHARED, axis=1)
        return {
            name: np.sqrt(np.sum(part**2, axis=1))
            for name, part in zip(("focus", "lattice", "tilt"), parts, strict=True)
        }


@dataclass(frozen=True)
class Decided:
    """Spots, and the places by which views are decided.

    A spot that its micro-image cuts is known better from all other spots than from itself.
    Uncertainties are standard, px: of each coordinate those of the spots for a known focus and
    radius of the dots, shape (n, 2); in one coordinate those of the places, shape (n,).
    """

    spots: Spots
    doubts: Array
    places: Array
    place_doubts: Array


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

    The nominal camera only says where to look first, to 30 px. Where the dots are not there, they
    are looked for in all micro-images, whatever the target's distance, place and turn (less than 45
    degrees). One common shift, turn, magnification and parallax are then fitted to the spots
    themselves. A view counts when the fitted centre lies in the useful region as measured: on the
    sensor, illumination at least the camera's ``minimum_illumination``, outside every neighbour's
    circle of more than ``maximum_crosstalk``, and within the circle in which the dot keeps half its
    light.

    Args:
        picture: DN, [row, col].
        white: white picture of the same configuration; pixels saturated in it are left out. None:
            none was taken.
        lattice: measured from the white picture.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: wrong shape, target at infinity, or no dot found where the camera puts
            some.
    """
    values = unshaded(usable_pixels(picture, white, camera, target.kind, noise), lattice, noise)
    seen = find_spots(values, lattice, camera, target, distance, noise)
    distance = seen.distance
    spots, candidates, law, radius, spread = (
        seen.spots,
        seen.candidates,
        seen.law,
        seen.radius,
        seen.spread,
    )
    # the brightest half of the well lit spots are whole: they say what a dot's full light is
    level = _full_light(spots, candidates, lattice, seen.table)
    doubts = _centre_doubts(spots, candidates, lattice, radius, spread)
    worse = _with_shared(doubts, spots.together).max(axis=1)
    agreed, agreed_doubts = _agreed_centres(spots, worse, candidates, lattice, camera, target, law)
    places = np.where((agreed_doubts < worse)[:, None], agreed, spots.centres)
    decided = Decided(spots, doubts, places, np.minimum(agreed_doubts, worse))
    misfit = _misfit(spots, lattice, noise, level)

    def counted(spots: Decided) -> tuple[DotViews, ...]:
        return tuple(
            _views(dot, spots, candidates, lattice, seen.table, camera, level, distance, misfit)
            for dot in range(len(target.centres))
        )

    return counted(_as_scattered(counted(decided), decided, candidates, lattice, camera))


def _as_scattered(
    dots: tuple[DotViews, ...],
    decided: Decided,
    candidates: Candidates,
    lattice: Lattice,
    camera: Camera,
) -> Decided:
    """The spots as unsure as views scatter about one place for each dot, where that is clearly more
    than they state.
    """
    own = np.zeros(len(candidates.lens))
    if lattice.doubts_px is not None:
        own = lattice.doubts_px[candidates.lens]
    variance, total, freedom = decided.doubts**2 + own[:, None] ** 2, 0.0, 0
    for dot in dots:
        if dot.views < 3 or not np.isfinite(dot.position_mm).all():
            continue
        mine = np.flatnonzero(
            (candidates.dot == dot.dot)
            & (decided.spots.centres[:, None] == dot.centres_px[None]).all(axis=2).any(axis=1)
        )
        left = departures_px(
            dot.position_mm, dot.centres_px, candidates.lens[mine], lattice, camera
        )
        total += float(np.sum(left**2 / variance[mine]))
        freedom += 2 * len(mine) - 3
    if freedom == 0 or total / freedom < 1 + CLEARLY * math.sqrt(2 / freedom):
        return decided
    grown = total / freedom
    return replace(
        decided, doubts=np.sqrt(grown * decided.doubts**2 + (grown - 1) * own[:, None] ** 2)
    )


def _full_light(
    spots: Spots, candidates: Candidates, lattice: Lattice, table: ProfileTable
) -> float:
    """Brightness of a whole dot over that of a white target: the well lit spots', or 1 (equal
    exposures) where there are none.
    """
    away = np.hypot(*(spots.centres - lattice.centres_px[candidates.lens]).T)
    lit = (
        (illumination(table, away) > HALF)
        & np.isfinite(spots.covariance[:, 2, 2])
        & (spots.brightness > 0.05)
    )
    if not lit.any():
        return 1.0
    bright = spots.brightness[lit]
    return float(np.median(bright[bright >= np.median(bright)]))


def _misfit(spots: Spots, lattice: Lattice, noise: SensorNoise, level: float) -> float:
    """Share of their light that usual spots leave beyond noise."""
    bright = spots.chi2_per_pixel[spots.seen]
    light = max(float(lattice.light[0]) * level, 1e-9)
    left = max(float(np.median(bright)) - 1, 0.0) if len(bright) else 0.0
    return math.sqrt(left * (noise.dark_variance + noise.dn_per_electron * light)) / light


def _margins(
    centres: Array, lens: Whole, lattice: Lattice, table: ProfileTable, camera: Camera
) -> tuple[Array, Array]:
    """How far each centre lies inside its micro-image's useful region, px (negative: outside), and
    how sure the region's edge is.
    """
    own = lattice.centres_px[lens]
    away = np.hypot(*(centres - own).T)
    limit = min(
        _radius_of(lattice, table, camera.useful.minimum_illumination),
        (lattice.inside_radius_px + lattice.outside_radius_px) / 2,
    )
    blocked = _radius_of(lattice, table, camera.useful.maximum_crosstalk)
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


def _radius_of(lattice: Lattice, table: ProfileTable, share: float) -> float:
    """Radius at which the measured illumination falls to ``share``."""
    if share <= 0:
        return lattice.outside_radius_px
    r = np.linspace(lattice.outside_radius_px, lattice.inside_radius_px, 4001)
    return float(np.interp(share, illumination(table, r), r))


def _centre_doubts(
    spots: Spots, candidates: Candidates, lattice: Lattice, radius: float, spread: float
) -> Array:
    """Standard uncertainties of each spot's x and y, px, shape (n, 2): the noise's and the fit's
    own.
    """
    noise = (
        np.einsum("nkk->nk", spots.covariance)[:, :2]
        * np.maximum(spots.chi2_per_pixel, 1.0)[:, None]
    )
    away = np.hypot(*(spots.centres - lattice.centres_px[candidates.lens]).T)
    # of a cut spot only a part of the rim is seen, which a blur of its own moves
    cut = CUT_ERROR_PX**2 + (OF_BLUR * 2 * lattice.radii_apart_px) ** 2
    own = FIT_ERROR_PX**2 + np.where(
        away + radius + spread / 2 > lattice.inside_radius_px, cut, 0.0
    )
    return np.sqrt(np.where(np.isfinite(noise), noise, 100.0**2) + own[:, None])


def _with_shared(doubts: Array, together: Array) -> Array:
    """Standard uncertainties of x and y by themselves and of what moves all spots together, shape
    (n, 2).
    """
    return np.sqrt(doubts**2 + (together**2).sum(axis=2))


def _agreed_centres(
    spots: Spots,
    doubts: Array,
    candidates: Candidates,
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    law: Array,
) -> tuple[Array, Array]:
    """Where one law for all spots puts each, px, and how sure that is: shift, complex factor of
    dots and of micro-image centres.
    """
    _, regressors = law_places(lattice, camera, target, law, candidates)
    centre = sensor_position(camera.sensor, lattice.centres_px)[candidates.lens]
    z = (
        (sensor_position(camera.sensor, spots.centres) - centre - regressors @ law)
        @ [1, 1j]
        / camera.sensor.pixel
    )
    o, c = regressors[:, 1:3] @ [1, 1j], regressors[:, 3:5] @ [1, 1j]
    design = np.stack([np.ones(len(z)), o, c], axis=1) / [
        1.0,
        np.abs(o).max(initial=1e-9),
        np.abs(c).max(initial=1e-9),
    ]
    weight = np.where((doubts < 10) & (spots.brightness > 0.05), 1 / doubts**2, 0.0)
    step, covariance, excess = np.zeros(3, dtype=np.complex128), np.eye(3), 1.0
    for _ in range(4):
        covariance = np.linalg.inv((design.conj().T * weight) @ design + np.eye(3) / SEARCH_PX**2)
        step = covariance @ ((design.conj().T * weight) @ z)
        left = np.abs(z - design @ step)
        excess = max(
            1.0, float((weight * left**2).sum()) / max(2 * np.count_nonzero(weight) - 6, 1)
        )
        weight = np.where(left > 6 * doubts * math.sqrt(excess), 0.0, weight)
    shift = design @ step
    together = design @ (
        covariance @ ((design.conj().T * weight) @ np.einsum("nck,c->nk", spots.together, [1, 1j]))
    )
    spread = np.sqrt(
        np.einsum("nk,km,nm->n", design, covariance, design.conj()).real * excess
        + (np.abs(together) ** 2).sum(axis=1)
    )
    places, _ = law_places(lattice, camera, target, law, candidates)
    return places + np.stack([shift.real, shift.imag], axis=1), np.hypot(spread, FIT_ERROR_PX)


def _views(
    dot: int,
    decided: Decided,
    candidates: Candidates,
    lattice: Lattice,
    table: ProfileTable,
    camera: Camera,
    level: float,
    distance: float,
    misfit: float,
) -> DotViews:
    mine = np.flatnonzero(candidates.dot == dot)
    spots, lens = decided.spots, candidates.lens[mine]
    margin, edge = _margins(decided.places[mine], lens, lattice, table, camera)
    doubt = np.hypot(decided.place_doubts[mine], edge)
    light = spots.brightness[mine] / level
    light_doubt = np.sqrt(np.minimum(spots.covariance[mine, 2, 2], 1.0)) / level
    counted = (margin >= 0) & (light >= HALF)
    near_edge = (np.abs(margin) < 2 * doubt) & (light > HALF - 2 * light_doubt)
    near_dark = (np.abs(light - HALF) < 2 * light_doubt) & (margin > -2 * doubt)
    centres, sure, together = (
        spots.centres[mine][counted],
        decided.doubts[mine][counted],
        spots.together[mine][counted],
    )
    position, uncertainty, common = triangulate(
        centres, sure, together, lens[counted], lattice, camera, distance
    )
    return DotViews(
        dot=dot,
        views=int(counted.sum()),
        views_uncertain=int(np.count_nonzero(near_edge | near_dark)),
        indices=lattice.indices[lens[counted]],
        centres_px=centres,
        centre_uncertainty_px=_with_shared(sure, together),
        position_mm=position,
        uncertainty_mm=uncertainty,
        common_mm=common,
        at_limit_px=decided.places[mine][near_edge | near_dark],
        misfit=misfit,
    )

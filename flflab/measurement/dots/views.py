"""In which micro-images each dot of a four-dot target is seen, where exactly, and where that puts
the dot in space.
"""

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.dots.find import Found, find_dots
from flflab.measurement.dots.places import CAUSES, places_of, root, shared_by_all
from flflab.measurement.dots.scale import DotScale, scale_of
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import require_shape
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.overlap import common_area
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

HALF = 0.5  # of the dot's expected light: a view has at least this
WELL_LIT = 0.5  # of a whole spot's light: such spots show how bright a dot is


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
        centres_px: centres of the dot's images, shape (n, 2): where the ray through the centre of
            the limiting stop lands, by the spot's light. Where that cannot be measured, by the
            other views.
        centre_uncertainty_px: standard uncertainties of each centre's x and y, shape (n, 2); a
            spot's radius where it was not measured.
        position_mm: of the dot in the world (main lens at z = 0, target at negative z), given the
            nominal camera; nan where fewer than two views leave it open, shape (3,).
        uncertainty_mm: its standard uncertainties, shape (3,).
        common_mm: how it moves with a standard uncertainty of each thing that all dots of the
            picture share: focus, lattice, tilt of the array, and the model's own error; part of
            ``uncertainty_mm``, shape (3, k).
        lenses: lattice indices of the microlenses that show any dot's spots, shape (m, 2).
        by_lens_mm: how it moves with a standard deviation of each one's own place (x, y) and
            focus, which it has in every picture; part of ``uncertainty_mm``, shape (3, m, 3).
        at_limit_px: images whose decision is not sure, shape (m, 2).
        misfit: rms by which spots' light differs from what is expected beyond noise, as a share of
            it.
        freedom: degrees of freedom of the uncertainty, of all dots together.
        saturated: pixels left out of its spots.
        scale: of the square of all dots; None where too few views tell it.
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
    lenses: Whole = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    by_lens_mm: Array = field(default_factory=lambda: np.zeros((3, 0, 3)))
    at_limit_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
    misfit: float = 0.0
    freedom: float = 0.0
    saturated: int = 0
    scale: DotScale | None = None

    @property
    def own_mm(self) -> Array:
        """What of ``uncertainty_mm`` is this dot's own: of its spots and their lenses' places."""
        shared = np.sum(self.common_mm**2, axis=1)
        return np.sqrt(np.maximum(self.uncertainty_mm**2 - shared, 0.0))

    @property
    def by_cause_mm(self) -> dict[str, Array]:
        """What of it dots of a picture share, by name, each of shape (3,)."""
        ends = np.cumsum(list(CAUSES.values()))[:-1]
        parts = np.split(self.common_mm, ends, axis=1)
        return {
            name: np.sqrt(np.sum(part**2, axis=1)) for name, part in zip(CAUSES, parts, strict=True)
        }


def count_views(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> tuple[DotViews, ...]:
    """Find the images of each dot, decide which of them are views, and triangulate the dots.

    The nominal camera only says where to look first, to 30 px. Where the dots are not there, they
    are looked for in all micro-images, whatever the target's distance, place and turn (less than 45
    degrees). The places of all four dots are then fitted to the centroids of their spots' light. A
    view counts when its centre lies in the useful region as measured: on the sensor, illumination
    at least the camera's ``minimum_illumination``, outside every neighbour's circle of more than
    ``maximum_crosstalk``, with half of the light expected there.

    Args:
        picture: DN, [row, col]. Saturated pixels are left out.
        lattice: measured from the white picture.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: wrong shape, target at infinity, or no dot found where the camera puts
            some.
    """
    values = _finite(picture, camera, target.kind)
    found = find_dots(values, lattice, camera, target, distance, noise)
    seen, stand, pixel = found.seen, found.stand, camera.sensor.pixel
    share, doubt, misfit = _light(found, lattice, values.shape)
    margin, edge = _margins(found, lattice, camera)
    counted = (margin >= 0) & (share >= HALF)
    near_edge = (np.abs(margin) < 2 * edge) & (share > HALF - 2 * doubt)
    near_dark = (np.abs(share - HALF) < 2 * doubt) & (margin > -2 * edge)
    # where a spot was not measured the other views say where its middle is
    measured = seen.counted[:, None]
    rest = np.where(measured, seen.centroids - stand.shown.centroid, 0.0) / pixel
    lag = (stand.lags @ root(stand.covariance)).reshape(len(rest), 2, -1)
    sure = np.sqrt(stand.excess * stand.spread**2 + (lag**2).sum(axis=2)) / pixel
    centres, sure = found.chief_px + rest, np.where(measured, sure, found.reach_px)
    shared = shared_by_all(found, lattice)
    scale = scale_of(found, shared, target, distance)
    views: list[DotViews] = []
    for dot, (position, uncertainty, common, by_lens) in enumerate(places_of(found, shared)):
        mine = np.flatnonzero((seen.dot == dot) & counted)
        limit = np.flatnonzero((seen.dot == dot) & (near_edge | near_dark))
        views.append(
            DotViews(
                dot=dot,
                views=len(mine),
                views_uncertain=len(limit),
                indices=lattice.indices[seen.lens[mine]],
                centres_px=centres[mine],
                centre_uncertainty_px=sure[mine],
                position_mm=position,
                uncertainty_mm=uncertainty,
                common_mm=common,
                lenses=lattice.indices[stand.lenses],
                by_lens_mm=by_lens,
                at_limit_px=found.chief_px[limit],
                misfit=misfit,
                freedom=stand.freedom,
                saturated=int(found.spots.saturated[seen.dot == dot].sum()),
                scale=scale,
            )
        )
    return tuple(views)


def _finite(picture: npt.NDArray[np.generic], camera: Camera, kind: str) -> npt.NDArray[Any]:
    """The picture as it is.

    Raises:
        MeasurementError: wrong shape, or not finite.
    """
    require_shape(picture, camera, kind)
    values = np.ascontiguousarray(picture)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise MeasurementError(f"{kind} picture: every pixel must be a finite number")
    return values


def _light(found: Found, lattice: Lattice, shape: tuple[int, ...]) -> tuple[Array, Array, float]:
    """Light of each spot over what is expected there, its standard uncertainty, and how far it
    scatters beyond noise.

    A spot that cannot be measured alone is taken for whole where there is light at all.
    """
    spots, expected = found.spots, found.stand.shown.light
    there = lattice.centres_px[found.seen.lens]
    x, y = ((there - (np.array([shape[1], shape[0]]) - 1) / 2) * 2 / max(shape)).T
    level = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) @ lattice.light
    due = np.maximum(expected * level, 1e-12)
    lit = found.seen.counted & (expected > WELL_LIT)
    lit = lit if lit.any() else found.seen.counted
    full = due * float(np.median((spots.light / due)[lit]))
    share, noise = spots.light / full, np.sqrt(spots.light_variance) / full
    scatter = 1.4826 * float(np.median(np.abs(share[lit] - 1))) if lit.sum() > 2 else 0.0
    misfit = math.sqrt(max(scatter**2 - float(np.median(noise[lit] ** 2)), 0.0))
    half_there = ~spots.whole & (share > HALF / 2)
    share = np.where(half_there, 1.0, share)
    return share, np.where(half_there, 0.0, np.hypot(noise, misfit)), misfit


def _margins(found: Found, lattice: Lattice, camera: Camera) -> tuple[Array, Array]:
    """How far each centre lies inside its micro-image's useful region, px (negative: outside), and
    how sure that is.
    """
    centres, own = found.chief_px, lattice.centres_px[found.seen.lens]
    useful, stand, pixel = camera.useful, found.stand, camera.sensor.pixel
    least = useful.minimum_illumination
    middle = (lattice.inside_radius_px + lattice.outside_radius_px) / 2
    limit = min(_radius_of(lattice, least), middle)
    blocked = _radius_of(lattice, useful.maximum_crosstalk)
    low, high = np.full(2, -0.5), np.array(camera.sensor.resolution) - 0.5
    margin = np.minimum(limit - np.hypot(*(centres - own).T), (centres - low).min(axis=1))
    margin = np.minimum(margin, (high - centres).min(axis=1))
    margin = np.where(np.all((own >= low) & (own <= high), axis=1), margin, -np.inf)
    for i, j in itertools.product(range(-2, 3), repeat=2):
        step = lattice.vectors_px @ np.array([i, j], dtype=np.float64)
        if (i, j) != (0, 0) and np.hypot(*step) < limit + blocked + 1:
            margin = np.minimum(margin, np.hypot(*(centres - own - step).T) - blocked)
    by = stand.chief_slopes.reshape(len(own), 2, -1)
    place = np.einsum("nij,jk,nik->ni", by, stand.covariance, by).max(axis=1)
    rim = math.hypot(lattice.inside_uncertainty_px, lattice.outside_uncertainty_px)
    lens_to_lens = lattice.radii_apart_px * (2 * max(least, HALF) - 1)
    return margin, np.sqrt((place + found.seen.place**2) / pixel**2 + rim**2 + lens_to_lens**2)


def _radius_of(lattice: Lattice, share: float) -> float:
    """Radius at which the illumination, two discs in common, falls to ``share``."""
    inside, outside = lattice.inside_radius_px, lattice.outside_radius_px
    large, small = (outside + inside) / 2, (outside - inside) / 2
    r = np.linspace(outside, inside, 4001)
    return float(np.interp(share, common_area(large, small, r) / (math.pi * small**2), r))

"""In which micro-images each dot of a four-dot target is seen, where exactly, and where that puts
the dot in space.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.dots.find import Found, find_dots
from flflab.measurement.dots.places import CAUSES, Place, places_of, root
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import SMALLEST_PX, profile_table
from flflab.measurement.lattice.registration import require_shape
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
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
        lag_px: how the centres move with a standard uncertainty of what the fit left open, focus
            and depth, which all views share; part of the above, shape (n, 2, m).
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
    """

    dot: int
    views: int
    views_uncertain: int
    indices: Whole
    centres_px: Array
    centre_uncertainty_px: Array
    lag_px: Array
    position_mm: Array
    uncertainty_mm: Array
    common_mm: Array
    lenses: Whole = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    by_lens_mm: Array = field(default_factory=lambda: np.zeros((3, 0, 3)))
    at_limit_px: Array = field(default_factory=lambda: np.zeros((0, 2)))
    misfit: float = 0.0
    freedom: float = 0.0
    saturated: int = 0

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
    values = finite(picture, camera, target.kind)
    found = find_dots(values, lattice, camera, target, distance, noise)
    share, doubt, misfit = _light(found, lattice, values.shape)
    placed = places_of(found, lattice, camera)
    margin, edge = _margins(found, lattice, camera)
    counted = (margin >= 0) & (share >= HALF)
    near_edge = (np.abs(margin) < 2 * edge) & (share > HALF - 2 * doubt)
    near_dark = (np.abs(share - HALF) < 2 * doubt) & (margin > -2 * edge)
    unsure = near_edge | near_dark
    return tuple(
        _views(dot, found, place, counted, unsure, misfit, lattice, camera.sensor.pixel)
        for dot, place in enumerate(placed)
    )


def finite(picture: npt.NDArray[np.generic], camera: Camera, kind: str) -> npt.NDArray[Any]:
    """The picture as it is.

    Raises:
        MeasurementError: wrong shape, or not finite.
    """
    require_shape(picture, camera, kind)
    values = np.ascontiguousarray(picture)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise MeasurementError(f"{kind} picture: every pixel must be a finite number")
    return values


def _views(
    dot: int,
    found: Found,
    place: Place,
    counted: Flags,
    unsure: Flags,
    misfit: float,
    lattice: Lattice,
    pixel: float,
) -> DotViews:
    own = found.candidates.dot == dot
    mine, limit = np.flatnonzero(own & counted), np.flatnonzero(own & unsure)
    measured = found.seen.counted[mine]
    centres = found.chief_px[mine]
    stand = found.stand
    rest = (found.seen.centroids - stand.shown.centroid)[mine] / pixel
    centres = np.where(measured[:, None], centres + rest, centres)
    lag = (stand.lags @ root(stand.covariance)).reshape(len(own), 2, -1)[mine] / pixel
    doubts = np.sqrt(stand.excess * (stand.spread[mine] / pixel) ** 2 + (lag**2).sum(axis=2))
    return DotViews(
        dot=dot,
        views=len(mine),
        views_uncertain=len(limit),
        indices=lattice.indices[found.candidates.lens[mine]],
        centres_px=centres,
        centre_uncertainty_px=np.where(measured[:, None], doubts, found.reach_px),
        lag_px=lag,
        position_mm=place.position_mm,
        uncertainty_mm=place.uncertainty_mm,
        common_mm=place.common_mm,
        lenses=lattice.indices[found.stand.lenses],
        by_lens_mm=place.by_lens_mm,
        at_limit_px=found.chief_px[limit],
        misfit=misfit,
        freedom=stand.freedom,
        saturated=int(found.spots.saturated[own].sum()),
    )


def _light(found: Found, lattice: Lattice, shape: tuple[int, ...]) -> tuple[Array, Array, float]:
    """Light of each spot over what is expected there, its standard uncertainty, and how far it
    scatters beyond noise.

    A spot that cannot be measured alone is taken for whole where there is light at all.
    """
    spots, expected = found.spots, found.stand.shown.light
    there = lattice.centres_px[found.candidates.lens]
    x, y = ((there - (np.array([shape[1], shape[0]]) - 1) / 2) * 2 / max(shape)).T
    level = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) @ lattice.light
    due = np.maximum(expected * level, 1e-12)
    share, noise = spots.light / due, np.sqrt(spots.light_variance) / due
    lit = found.seen.counted & (expected > WELL_LIT)
    if not lit.any():
        lit = found.seen.counted
    full = float(np.median(share[lit]))
    share, noise = share / full, noise / full
    scatter = 1.4826 * float(np.median(np.abs(share[lit] - 1))) if lit.sum() > 2 else 0.0
    misfit = math.sqrt(max(scatter**2 - float(np.median(noise[lit] ** 2)), 0.0))
    half_there = ~spots.whole & (share > HALF / 2)
    share = np.where(half_there, 1.0, share)
    return share, np.where(half_there, 0.0, np.hypot(noise, misfit)), misfit


def _margins(found: Found, lattice: Lattice, camera: Camera) -> tuple[Array, Array]:
    """How far each centre lies inside its micro-image's useful region, px (negative: outside), and
    how sure that is.
    """
    lens, centres = found.candidates.lens, found.chief_px
    own = lattice.centres_px[lens]
    away = np.hypot(*(centres - own).T)
    least = camera.useful.minimum_illumination
    limit = min(
        _radius_of(lattice, least),
        (lattice.inside_radius_px + lattice.outside_radius_px) / 2,
    )
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
    stand, pixel = found.stand, camera.sensor.pixel
    place = np.einsum("nk,km,nm->n", stand.slopes, stand.covariance, stand.slopes)
    place = place.reshape(-1, 2).max(axis=1) / pixel**2
    rim = math.hypot(lattice.inside_uncertainty_px, lattice.outside_uncertainty_px)
    lens_to_lens = lattice.radii_apart_px * (2 * max(least, HALF) - 1)
    sure = np.sqrt(place + (found.seen.place / pixel) ** 2 + rim**2 + lens_to_lens**2)
    return np.where(centre_inside, margin, -np.inf), sure


def _radius_of(lattice: Lattice, share: float) -> float:
    """Radius at which the measured illumination falls to ``share``."""
    if share <= 0:
        return lattice.outside_radius_px
    large = (lattice.outside_radius_px + lattice.inside_radius_px) / 2
    small = max(SMALLEST_PX, (lattice.outside_radius_px - lattice.inside_radius_px) / 2)
    table = profile_table(large, small)
    r = np.linspace(lattice.outside_radius_px, lattice.inside_radius_px, 4001)
    light = np.interp(r / table.step, np.arange(len(table.values)), table.values[:, 0])
    return float(np.interp(share, light, r))

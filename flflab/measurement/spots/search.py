"""The images of round dots in a picture of many micro-images: found, and fitted, by rays and where
edges show diffraction by waves.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import ProfileTable
from flflab.measurement.lattice.registration import (
    blur_px,
    require_shape,
    sensor_position,
    tilted_scales,
)
from flflab.measurement.lowest import lowest
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.spots.bent_light import CYCLES
from flflab.measurement.spots.clipping import FAR_PX, cut_spots, pupils_of, step_of_cut_spots
from flflab.measurement.spots.falloff import as_softened, evenly_blurred, steepness_of
from flflab.measurement.spots.fit import LIT, Lit, Spots, fit_spots, illumination_table, lit
from flflab.measurement.spots.focus import SHARPEST_PX, SOUND, Focus, nominal_focus
from flflab.measurement.spots.law import (
    Candidates,
    Square,
    candidates_near,
    law_places,
    register,
    regress,
)
from flflab.measurement.spots.profile import defocused_dot
from flflab.measurement.spots.start import where_to_look
from flflab.measurement.spots.waves import bent_px, light_of, step_of_diffracted_spots
from flflab.optics.camera import Camera
from flflab.optics.contrast import cone_half_angle
from flflab.optics.focus import microlens_limits
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Step = Callable[..., tuple[Spots, Focus, float]]

MOST_ROUNDS, SETTLED_PX = 12, 0.001  # a further round moves centres and radius by a tenth of that
# of the focus, a tenth of its uncertainty: it moves all cut spots alike, and depth with them
SETTLED_BLUR_PX = 0.001
# share of the blur, and px: as much more leaves the centres of whole spots in few micro-images
# alone
SOFTER, SOFTER_PX = (
    0.03,
    0.01,
)
# times what fall-off makes too much is taken out, by spots then known better: after the first depth
# is up to 0.005 mm off
TAKEN_OUT = 2
UNFITTED = (math.inf, math.inf)  # radius and blur of a frame of which no whole spot has been fitted
# mm: a camera sees no shorter light, so that edges softened by less are not softened by diffraction
SHORTEST = 300e-6
# of the misfit by rays: waves that leave more of it, and more than noise, are not what softens
# edges; Gaussians leave 0.4
EXPLAINED = 0.1
MOST_TABLES, NEAR_TABLE_PX = (
    8,
    0.03,
)  # of bent light; px of blur and softness from a table's within which it holds
# half width of a window, beyond which tables of bent light take hundreds of megabytes: larger dots
# are left to rays
LARGEST_PX = 60
# of the width of blurred dots: so far apart, what light they have of one another moves them by less
# than is stated
APART = 0.9
# standard uncertainty of a spot's place, beyond which it says nothing of the law: a dot may fill a
# micro-image
KNOWN_PX = 1.0
BESIDE_PX = 3.0  # of darkness beside a spot, in its window
NEAR_PX = 1.0  # of blur, up to which edges hardly tell the sides of the focus apart


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
        distance: main lens to target, mm: the nominal one, or where dots were not there, by their
            parallax.
    """

    spots: Spots
    candidates: Candidates
    law: Array
    radius: float
    spread: float
    focus: Focus
    table: ProfileTable
    distance: float


def find_spots(
    values: npt.NDArray[Any],
    lattice: Lattice,
    camera: Camera,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> SeenSpots:
    """Find the images of the dots round where the nominal camera puts them, to 30 px, and if they
    are not there, anywhere.

    Raises:
        MeasurementError: target at infinity, no dot found where the camera puts some, or dots
            blurred into one another.
    """
    table = illumination_table(lattice)
    law, distance = where_to_look(values, lattice, camera, target, distance, table, noise)
    spread = blur_px(camera, distance)
    start = law
    sizes = 1 / tilted_scales(lattice, central_smms(camera), distance)
    law, radius = register(values, lattice, camera, target, law, spread, sizes, table, noise)
    _require_apart(target, radius, spread)
    candidates = candidates_near(lattice, camera, target, law, radius + spread / 2 + BESIDE_PX)
    places, regressors = law_places(lattice, camera, target, law, candidates)
    own = lit(lattice, candidates.lens, (values.shape[0], values.shape[1]), sizes)
    pupils = pupils_of(lattice, candidates.lens, camera, distance)
    spots = fit_spots(
        values,
        places,
        _half_width(target, radius, spread),
        own,
        defocused_dot(radius, spread),
        noise,
    )
    reach = radius + spread / 2
    cut = cut_spots(places, own, lattice, reach, pupils)
    whole = np.setdiff1d(np.arange(len(places)), cut)
    spots = _started_by_law(spots, cut, places, own)
    limited = bool(microlens_limits(central_smms(camera), 1 / distance))
    focus = nominal_focus(0.0 if pupils is None else pupils.blur, known=not limited)

    by_rays = partial(step_of_cut_spots, cut=cut, own=own, pupils=pupils, noise=noise)

    def settled(
        values: npt.NDArray[Any],
        seen: SeenSpots,
        whole: Whole,
        step: Step,
        fitted: tuple[float, float],
        moved: float,
    ) -> SeenSpots:
        # spots and focus want the radius, the radius the law and the law the spots: a step of each,
        # until they agree
        spots, law, radius, spread, focus = (
            seen.spots,
            seen.law,
            seen.radius,
            seen.spread,
            seen.focus,
        )
        square = Square(radius, radius, np.zeros(places.shape))
        for _ in range(MOST_ROUNDS):
            before, last, focused, half = (
                spots.centres,
                radius,
                focus.blur_px,
                _half_width(target, radius, spread),
            )
            if limited and not _lit(spots, own)[cut].any():
                spread = _softness(values, spots, whole, half, own, radius, spread, noise)
            if len(whole) and (
                abs(radius - fitted[0]) > SETTLED_PX
                or abs(spread - fitted[1]) > max(SOFTER * spread, SOFTER_PX)
            ):
                again = fit_spots(
                    values,
                    before[whole],
                    half,
                    own.those(whole),
                    defocused_dot(radius, spread),
                    noise,
                )
                spots, fitted = spots.with_those(whole, again), (radius, spread)
            spots, focus, radius = step(
                values, spots, half=half, focus=focus, radius=radius, square=square, moved=moved
            )
            bright = _lit(spots, own)
            if limited and bright[cut].any():
                spread = focus.softness_px
            # the place of one that the sensor's border cuts depends on the radius, which must not
            # depend on it
            good = bright & np.all(
                (spots.centres > reach)
                & (spots.centres < np.asarray(camera.sensor.resolution) - 1 - reach),
                axis=1,
            )
            good &= np.einsum("nkk->n", spots.covariance[:, :2, :2]) < KNOWN_PX**2
            if not good.any():
                break
            offsets = sensor_position(camera.sensor, spots.centres) - sensor_position(
                camera.sensor, own.centres
            )
            law, by_offset, doubt = regress(
                law, start, regressors[good], offsets[good], camera.sensor.pixel
            )
            by_places = np.zeros((len(good), 2))
            by_places[good] = target.diameter / 2 * by_offset
            per_size = target.diameter / 2 / camera.sensor.pixel
            square = Square(per_size * float(np.hypot(*law[1])), per_size * doubt, by_places)
            far, moved = moved > FAR_PX, float(np.abs(spots.centres - before)[bright].max())
            if (
                max(moved, abs(radius - last)) < SETTLED_PX
                and abs(focus.blur_px - focused) < SETTLED_BLUR_PX
                and not far
            ):
                break
        return SeenSpots(spots, candidates, law, radius, spread, focus, table, distance)

    def misfit(seen: SeenSpots) -> float:
        lit_ones = seen.spots.chi2_per_pixel[cut][_lit(seen.spots, own)[cut]]
        return float(lit_ones.mean()) if len(lit_ones) else math.inf

    start_at = SeenSpots(spots, candidates, law, radius, spread, focus, table, distance)
    seen = settled(values, start_at, whole, by_rays, (radius, spread), math.inf)
    if limited and 3 * seen.focus.uncertainty_px < abs(seen.focus.blur_px) < NEAR_PX:
        # a blur on the wrong side of the focus is a lesser misfit than any near it
        turned = replace(seen, focus=replace(seen.focus, blur_px=-seen.focus.blur_px))
        other = settled(values, turned, whole, by_rays, (seen.radius, seen.spread), 0.0)
        seen = min(seen, other, key=misfit)
    if pupils is None:
        return seen
    steepness = steepness_of(lattice, candidates.lens, camera)

    def even(seen: SeenSpots) -> npt.NDArray[Any]:
        if steepness is None:
            return values
        half = _half_width(target, seen.radius, seen.spread)
        return evenly_blurred(
            values, seen.spots, half, own, pupils, seen.focus, seen.radius, steepness, noise
        )

    for _ in range(0 if steepness is None else TAKEN_OUT):
        seen = settled(even(seen), seen, whole, by_rays, UNFITTED, 0.0)
    shortest = (
        CYCLES
        * SHORTEST
        / camera.sensor.pixel
        / (2 * float(cone_half_angle(central_smms(camera), 1 / distance)))
    )
    told = (
        seen.focus.uncertainty_px > 0
        and _lit(seen.spots, own)[cut].any()
        and _half_width(target, seen.radius, seen.spread) <= LARGEST_PX
    )
    if not told or bent_px(seen.focus) < shortest:
        return seen
    # the edges of all spots, cut by the sensor's border too, are those of waves
    every, nowhere, bent = np.flatnonzero(seen.spots.seen), np.empty(0, dtype=np.int64), seen
    for _ in range(MOST_TABLES):
        last = bent.focus
        light = light_of(last, pupils, bent.radius, _half_width(target, bent.radius, bent.spread))
        by_waves = partial(
            step_of_diffracted_spots, which=every, own=own, pupils=pupils, noise=noise, light=light
        )
        softened = (
            values if steepness is None else as_softened(values, even(bent), bent_px(last), noise)
        )
        bent = settled(softened, bent, nowhere, by_waves, UNFITTED, 0.0)
        if (
            max(
                abs(bent.focus.blur_px - last.blur_px),
                abs(bent.focus.softness_px - last.softness_px),
            )
            < NEAR_TABLE_PX
        ):
            break
    # edges that something else softens are fitted by waves as well, to an end that says nothing of
    # the focus
    explained = misfit(bent) < min(misfit(seen), max(SOUND, EXPLAINED * misfit(seen)))
    return bent if explained and bent_px(bent.focus) > shortest else seen


def _require_apart(target: FourDot, radius: float, spread: float) -> None:
    apart, width = 2 * radius * target.spacing / target.diameter, 2 * radius + spread
    if apart < APART * width:
        raise MeasurementError(
            f"four-dot picture: the dots' images are {apart:.1f} px apart and, with {spread:.1f} px"
            f" of blur, {width:.1f} px wide; {APART * width:.1f} px apart are needed to separate"
            " them; take dots further apart, or move them towards the focus"
        )


def _lit(spots: Spots, own: Lit) -> npt.NDArray[np.bool_]:
    """Which spots are seen in enough light to say where dots are, and in which focus."""
    return (own.share_at(spots.centres) > LIT) & spots.seen


def _started_by_law(spots: Spots, cut: Whole, places: Array, own: Lit) -> Spots:
    """Cut spots where the law has them, as bright as spots are: fitted as if nothing cut them they
    are pixels aside, and dark.
    """
    bright = spots.brightness[_lit(spots, own)]
    level = np.full(len(cut), float(np.median(bright)) if len(bright) else 1.0)
    return spots.with_those(cut, replace(spots.those(cut), centres=places[cut], brightness=level))


def _softness(
    values: npt.NDArray[Any],
    spots: Spots,
    whole: Whole,
    half: int,
    own: Lit,
    radius: float,
    spread: float,
    noise: SensorNoise,
) -> float:
    """Diameter of the disc, px, through which whole spots fit best: where none is cut, nothing else
    tells it.
    """
    mine = own.those(whole)
    bright = _lit(spots, own)[whole]
    if not bright.any():
        return spread

    def misfit(square: float) -> float:
        fitted = fit_spots(
            values,
            spots.centres[whole],
            half,
            mine,
            defocused_dot(radius, math.sqrt(square)),
            noise,
        )
        return float(fitted.chi2_per_pixel[bright].sum()) * (2 * half + 1) ** 2

    squares = [max(spread, SHARPEST_PX) ** 2 + step for step in (0.0, 0.01, 0.04)]
    return math.sqrt(lowest(misfit, squares, SHARPEST_PX**2))


def _half_width(target: FourDot, radius: float, spread: float) -> int:
    """Of the windows that hold a spot, px: halfway to the next dot at most, which a micro-image may
    show too.
    """
    return min(
        math.ceil(radius + spread / 2 + BESIDE_PX),
        math.floor(radius * target.spacing / target.diameter),
    )


def usable_pixels(
    picture: npt.NDArray[np.generic],
    white: npt.NDArray[np.generic] | None,
    camera: Camera,
    kind: str,
    noise: SensorNoise,
) -> npt.NDArray[Any]:
    """The picture as it is, or, where the white one is saturated, a copy that is saturated there
    too.

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
            return np.where(
                np.asarray(white, dtype=np.float32) >= noise.full_scale_dn,
                noise.saturated_dn,
                values.astype(np.float32),
            )
    return values

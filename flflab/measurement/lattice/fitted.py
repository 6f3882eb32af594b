"""Every micro-image of a white picture by itself, beside the one profile that all show."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import RoughLattice, averaged
from flflab.measurement.lattice.index import FEWEST, Indexed, index_lattice, unlike_most
from flflab.measurement.lattice.kernel import GROUND, LIGHT, SLOPE_X, SOFTER, WIDER, X, Y
from flflab.measurement.lattice.mean_profile import Profile, measured_profile
from flflab.measurement.lattice.micro_images import (
    BLOB,
    DISC,
    Model,
    expected,
    fit,
)
from flflab.measurement.lattice.neighbours import neighbours_within
from flflab.measurement.lattice.pixels import Pixels, finer
from flflab.measurement.lattice.slopes import course_of_slopes
from flflab.measurement.lattice.spread import Spread, spread
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

START_MISFIT = 0.03  # share of the light by which pixels may depart from the first profile
LEAST_MISFIT = 2e-3  # the same of the last one
# of the light over a radius: by which slopes may depart from their course, or from none
LEAST_SLOPE, HELD_SLOPE = 0.003, 1e-5
CLOSE = 18  # pixels along a radius that are enough where its rim is wide
FAR = 0.75  # of the pitch: wider micro-images overlap so far that edges are hardly told apart
SPARSE = 5  # pixels along a radius that are enough to begin with
TURNS = (BLOB, 2), (SOFTER + 1, 2), (DISC, 2), (DISC, 2)  # what is fitted in how many steps
LOOK = 2  # the turn from which on all pixels are looked at, and which shows how light slopes


@dataclass(frozen=True)
class Fitted:
    """Micro-images fitted one by one, before a lattice is laid through them.

    Attributes:
        indices: of each, shape (n, 2).
        values: as ``kernel`` names them, shape (n, VALUES).
        found: which were seen.
        profile: the light across them.
        spread: how sure the values are.
        sloping: whether slopes of their light were told from shifts.
        misfit: rms of what is left of the light, as a share of it.
    """

    indices: Whole
    values: Array
    found: Flags
    profile: Profile
    spread: Spread
    sloping: bool
    misfit: float


def fitted_near(
    picture: npt.NDArray[np.float32], noise: SensorNoise, rough: RoughLattice
) -> Fitted:
    """Every micro-image by itself, beside the profile that all show.

    Args:
        picture: DN, [row, col].
        noise: of the sensor.
        rough: where they are, roughly.

    Raises:
        MeasurementError: fewer than six of them are whole.
    """
    # means over squares of pixels tell as much where rims are wide
    factor = max(1, int(min(rough.softness, rough.radius / CLOSE)))
    if factor == 1:
        return _fitted(picture, noise, rough)
    means = averaged(np.where(picture < noise.saturated_dn, picture, np.inf), factor)
    return _enlarged(_fitted(means, noise.of_mean(factor**2), rough.seen_in_means(factor)), factor)


def _fitted(picture: npt.NDArray[np.float32], noise: SensorNoise, rough: RoughLattice) -> Fitted:
    """The same; arguments and errors of ``fitted_near``."""
    pixels = Pixels(picture, noise, START_MISFIT, max(1, int(rough.radius / SPARSE)))
    indexed = index_lattice(pixels, rough)
    profile, shape = indexed.profile, picture.shape
    indices, values, found, lit = _begun(indexed, shape, profile.end)
    every = np.arange(len(values))
    neighbours = neighbours_within(values[:, :2], 2 * profile.end)
    slopes: Array | None = None
    doubt, misfit = None, START_MISFIT
    for turn, (size, rounds) in enumerate(TURNS):
        inner = found & inside(values, shape, border_of(values, found, shape, profile, rough.pitch))
        require_enough(inner)
        if doubt is not None:
            inner &= ~unlike_most(values, doubt, profile, inner)
        if turn == LOOK:
            pixels = finer(pixels, pixels.misfit, 1)
        grounded = indexed.ground is None
        profile, values = measured_profile(pixels, values, np.flatnonzero(inner), profile, grounded)
        mean, apart = expected(values, profile, rough.pitch, indexed.ground)
        if turn > LOOK:
            mean[:, SLOPE_X:] = 0.0 if slopes is None else slopes
            apart[:, SLOPE_X:] = HELD_SLOPE if slopes is None else LEAST_SLOPE
        model = Model(profile, neighbours, mean, apart, size)
        values = fit(pixels, values, lit, model, rounds)
        doubt = spread(pixels, values, every, model)
        inner &= ~unlike_most(values, doubt, profile, inner)
        if turn == LOOK:
            slopes = course_of_slopes(indices, values, doubt, inner, profile.radius)
            values[:, SLOPE_X:] = 0.0 if slopes is None else slopes
        misfit = float(np.median(doubt.misfit[inner]))
        pixels = finer(pixels, max(misfit, LEAST_MISFIT), pixels.every)
    assert doubt is not None  # noqa: S101 - there are turns
    return Fitted(indices, values, found, profile, doubt, slopes is not None, misfit)


def _enlarged(fitted: Fitted, factor: int) -> Fitted:
    """What was fitted to means over squares of pixels, in pixels of the picture itself."""
    values, profile, doubt = fitted.values.copy(), fitted.profile, fitted.spread
    values[:, [X, Y, WIDER]] *= factor
    values[:, [X, Y]] += (factor - 1) / 2
    by = np.ones(values.shape[1])
    by[[X, Y, WIDER]] = factor
    return replace(
        fitted,
        values=values,
        profile=Profile(
            profile.radius * factor,
            profile.step * factor,
            profile.table / [1.0, factor],
            factor,
        ),
        spread=replace(
            doubt,
            covariance=doubt.covariance * np.outer(by, by),
            by_slope=doubt.by_slope * factor,
        ),
    )


def border_of(
    values: Array, found: Flags, shape: tuple[int, ...], profile: Profile, pitch: float
) -> float:
    """How far from the border centres must lie to count, px: where few micro-images are whole,
    those whose centre is on the picture tell the lattice too, unless they overlap far.
    """
    enough = np.count_nonzero(found & inside(values, shape, profile.end)) >= FEWEST
    return profile.end if enough or profile.end > FAR * pitch else 0.0


def require_enough(whole: Flags) -> None:
    """Refuse fewer than six whole micro-images."""
    if np.count_nonzero(whole) < FEWEST:
        raise MeasurementError(
            "white picture: is it one, of an evenly lit target? It shows"
            f" {np.count_nonzero(whole)} whole micro-images, {FEWEST} are needed; else show more of"
            " the array"
        )


def _begun(
    indexed: Indexed, shape: tuple[int, ...], reach: float
) -> tuple[Whole, Array, Flags, Whole]:
    """Micro-images that reach the picture, to begin with.

    Of those not seen, what the border hides is as bright as the nearest that were; on the picture
    itself they have no light, else they would take that of their neighbours' halo.

    Args:
        indexed: micro-images with their indices.
        shape: of the picture, (rows, columns).
        reach: how far a micro-image reaches, px.

    Returns:
        Indices, values, which were seen, and the positions of those that may have light.
    """
    kept = _touching(indexed.values, shape, reach)
    values, found = indexed.values[kept], indexed.found[kept]
    _, nearest = KDTree(values[found, :2]).query(values[~found, :2])
    for one in (LIGHT, GROUND, WIDER):
        values[~found, one] = values[found][nearest, one]
    unlit = ~found & inside(values, shape, 0.0)
    values[unlit, LIGHT] = 0.0
    return indexed.indices[kept], values, found, np.flatnonzero(~unlit)


def _touching(values: Array, shape: tuple[int, ...], reach: float) -> Flags:
    """Which micro-images reach the picture."""
    top = np.array([shape[1], shape[0]]) - 0.5
    off = values[:, :2] - np.clip(values[:, :2], -0.5, top)
    return np.hypot(*off.T) < reach


def inside(values: Array, shape: tuple[int, ...], reach: float) -> Flags:
    """Which lie wholly on it."""
    top = np.array([shape[1], shape[0]]) - 0.5
    return np.all((values[:, :2] > reach - 0.5) & (values[:, :2] < top - reach), axis=1)

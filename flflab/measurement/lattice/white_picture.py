"""A white picture measured blind: every micro-image by itself, and the lattice through them."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.errors import MeasurementError
from flflab.measurement.lattice.find import RoughLattice, find_lattice
from flflab.measurement.lattice.fitted import (
    Fitted,
    border_of,
    fitted_near,
    inside,
    require_enough,
)
from flflab.measurement.lattice.grid import Grid, grid_through
from flflab.measurement.lattice.index import looks_right, unlike_most
from flflab.measurement.lattice.kernel import X, Y
from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.slopes import (
    BEHIND,
    BESIDE,
    Slopes,
    asides,
    definition_of_centres,
)
from flflab.measurement.lattice.spread import Spread
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

NEXT = 1.2  # pitches: neighbours
RIM = 0.05  # of the light: where a micro-image ends


@dataclass(frozen=True)
class WhitePicture:
    """A white picture as measured.

    Attributes:
        rough: what was found blind.
        indices: of every micro-image that any part of is seen, shape (n, 2).
        values: of each, as ``kernel`` names them, shape (n, VALUES).
        found: which were seen well enough to be measured.
        whole: which lie wholly on the picture.
        profile: the light across them.
        spread: how sure the values are.
        slopes: of their light, as they go over the picture.
        grid: the lattice through the whole ones.
        definition_px: standard uncertainty of each centre's coordinates by what counts as the
            centre of light that is not as the profile has it, alike among neighbours, shape (n,).
        misfit: rms of what is left of the light, as a share of it.
    """

    rough: RoughLattice
    indices: Whole
    values: Array
    found: Flags
    whole: Flags
    profile: Profile
    spread: Spread
    slopes: Slopes
    grid: Grid
    definition_px: Array
    misfit: float


def measure_white(picture: npt.NDArray[np.float32], noise: SensorNoise) -> WhitePicture:
    """Measure every micro-image of a white picture, of which nothing but the noise is known.

    Args:
        picture: DN, [row, col].
        noise: of the sensor.

    Raises:
        MeasurementError: no lattice of bright micro-images is in it, or fewer than six whole ones.
    """
    rough = find_lattice(picture)
    require_contrast(rough, noise)
    return with_grid(rough, fitted_near(picture, noise, rough), picture.shape)


def with_grid(rough: RoughLattice, fitted: Fitted, shape: tuple[int, ...]) -> WhitePicture:
    """The measured white picture: which micro-images are whole, and the lattice through them.

    Args:
        rough: what was found blind.
        fitted: the micro-images.
        shape: of the picture, (rows, columns).

    Raises:
        MeasurementError: fewer than six of them are whole.
    """
    indices, values, profile, doubt = fitted.indices, fitted.values, fitted.profile, fitted.spread
    border = border_of(values, fitted.found, shape, profile, rough.pitch)
    there = inside(values, shape, min(border, profile.reaches(RIM) + 0.5))
    found = fitted.found & looks_right(values, doubt, profile, rough.pitch)
    whole = found & there
    require_enough(whole)
    whole &= ~unlike_most(values, doubt, profile, whole)
    between = 0.0 if fitted.joint else _light_between(rough, profile)
    definition = definition_of_centres(doubt, fitted.slopes, profile, between)
    missing = ~found & inside(values, shape, 0.0)
    beside = _beside(indices, missing, rough.layout)
    behind = _beside(indices, beside & ~missing, rough.layout)
    aside = profile.softness * np.where(beside, BESIDE, BEHIND * behind)
    # round a whole array all that border on darkness lie aside alike
    together = math.sqrt(float(np.mean(aside[whole] ** 2)))
    ways = asides(indices, math.hypot(float(np.median(definition[whole])), together))
    definition = np.hypot(definition, aside)
    own = np.sqrt(doubt.covariance[:, [X, Y], [X, Y]])
    # a bent lattice is not followed into unlit surrounds
    near, _ = KDTree(values[whole, :2]).query(values[:, :2], 3)
    beyond, amid = near[:, 0] < NEXT * rough.pitch, near[:, 2] < NEXT * rough.pitch
    grid = grid_through(
        rough.layout,
        indices[whole],
        values[whole, :2],
        np.hypot(own, aside[:, None])[whole],
        [indices[whole | there & amid], indices[inside(values, shape, 0.0) & beyond]],
        [one[whole] for one in ways],
    )
    return WhitePicture(
        rough,
        indices,
        values,
        found,
        whole,
        profile,
        doubt,
        fitted.slopes,
        grid,
        definition,
        fitted.misfit,
    )


def require_contrast(rough: RoughLattice, noise: SensorNoise) -> None:
    """Refuse what repeats less than the noise of a pixel."""
    spread = math.sqrt(float(noise.variance(rough.light + rough.background)))
    if rough.light < spread:
        raise MeasurementError(
            f"white picture: it is even; what repeats in it is {rough.light / spread:.1g} standard"
            " deviations of one pixel's noise, and more than 1 is due; is the microlens array in"
            " the camera?"
        )


def _beside(indices: Whole, missing: Flags, layout: Layout) -> Flags:
    """Which have one of some others as their neighbour."""
    steps = [(1, 0), (0, 1)] + ([(1, -1)] if layout == "hexagonal" else [])
    gaps = [
        tuple(one)
        for step in steps
        for sign in (1, -1)
        for one in (indices[missing] + sign * np.array(step)).tolist()
    ]
    beside = set(gaps)
    return np.array([tuple(one) in beside for one in indices.tolist()], dtype=np.bool_)


def _light_between(rough: RoughLattice, profile: Profile) -> float:
    """Share of a micro-image's light in the middle between it and its neighbours."""
    middle = rough.pitch / math.sqrt(2 if rough.layout == "square" else 3)
    return float(profile.table[min(int(middle / profile.step), len(profile.table) - 1), 0])

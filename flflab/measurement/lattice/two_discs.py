"""The light across a micro-image as the camera's shape has it: two overlapping discs and natural
fall-off, as a profile to fit micro-images with, and what the fitted values say of the discs.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.measurement.lattice.mean_profile import KNOTS_PX, Profile
from flflab.measurement.lattice.profile import (
    FALLOFF,
    LOPSIDED,
    SMALLEST_PX,
    VALUE,
    Cone,
    profile_table,
)

Array = npt.NDArray[np.float64]

LIKELY_SHARE, LOOSE_SHARE = 0.5, 0.5  # of natural fall-off: mean and spread of what is expected
NUDGE = 0.01  # px by which a radius is moved for what it does to the light
SHOWN = 0.02  # of the light: what a rough profile shows of its end


@dataclass(frozen=True)
class TwoDiscs:
    """A profile of two discs, and how values of single micro-images beside it are read.

    Attributes:
        radii: larger and smaller disc, px, shape (2,).
        profile: the light across.
        by_values: how the radii move with ``WIDER`` and ``SOFTER``, shape (2, 2).
        shift_px: how far light that falls off along a micro-image's middle ray moves what is
            fitted as its centre, px per unit of that ray's slope.
        slope: what the same makes of the fitted slope of the light, per unit.
    """

    radii: Array
    profile: Profile
    by_values: Array
    shift_px: float
    slope: float


@dataclass(frozen=True)
class Shape:
    """What makes the light across a micro-image, but for its radii.

    Attributes:
        cone: how rays land.
        share: of natural fall-off that there is.
        dark: variance of pixels without light over what light adds to it in the brightest ones:
            these weights are those of the fit.
        pixel: side of the squares over which it is averaged, px.
    """

    cone: Cone
    share: float
    dark: float
    pixel: int


@dataclass(frozen=True)
class SeenDiscs:
    """Discs read off a profile.

    Attributes:
        radii: larger and smaller, px, shape (2,).
        share: of natural fall-off that there is.
        covariance: of the radii, by what the discs leave of the profile and by the share, px^2,
            shape (2, 2).
    """

    radii: Array
    share: float
    covariance: Array


def _weights(dark: float, r: Array, light: Array) -> Array:
    """Roots of the weights of rings of pixels, shape (n,)."""
    return np.sqrt(r / (dark + np.maximum(light, 0.0)))


def two_discs(radii: Array, shape: Shape) -> TwoDiscs:
    """The profile of two discs.

    What a value that is not fitted does is what least squares over the micro-image make of it.

    Args:
        radii: larger and smaller disc, px, shape (2,).
        shape: what else the light depends on.
    """
    radii = np.maximum(radii, SMALLEST_PX * shape.pixel)
    light, lopsided, step = _light(radii, shape)
    r = _entries(len(light), step)
    fall = np.asarray(np.gradient(light, step), dtype=np.float64)
    radius = _half(light) * step
    weights = _weights(shape.dark, r, light)[:, None]
    wider = [
        np.interp(r, _entries(len(there), further), there, right=0.0) - light
        for there, _, further in (_light(radii + NUDGE * one, shape) for one in np.eye(2))
    ]

    def fitted(by: list[Array], seen: list[Array]) -> Array:
        design, rest = np.stack(by, axis=1) * weights, np.stack(seen, axis=1) * weights
        return np.asarray(np.linalg.lstsq(design, rest, rcond=None)[0], dtype=np.float64)

    odd = fitted([-fall, r / radius * light], [lopsided])
    even = fitted([light, np.ones_like(r), -fall, -fall * (r - radius)], wider)
    return TwoDiscs(
        radii,
        Profile(radius, step, np.stack([light, fall], axis=1)),
        np.asarray(np.linalg.inv(even[2:] / NUDGE), dtype=np.float64),
        float(odd[0, 0]),
        float(odd[1, 0]),
    )


def _light(radii: Array, shape: Shape) -> tuple[Array, Array, float]:
    """Light across a micro-image, 1 in its middle, what a unit of slant adds to it along its
    direction, and the step between both's entries, px.
    """
    table = profile_table(float(radii[0]), float(radii[1]), shape.cone, shape.pixel)
    light = table.values[:, VALUE] + shape.share * table.values[:, FALLOFF]
    return light / light[0], table.values[:, LOPSIDED] / light[0], table.step


def _entries(count: int, step: float) -> Array:
    """Distances of a table's entries, px."""
    return np.arange(count, dtype=np.float64) * step


def _half(light: Array) -> float:
    """Where light falls to a half, in entries."""
    last = int(np.flatnonzero(light >= 0.5)[-1])
    return last + (light[last] - 0.5) / max(light[last] - light[last + 1], 1e-12)


def discs_in(profile: Profile, cone: Cone, dark: float, start: Array) -> SeenDiscs:
    """The two discs and the share of natural fall-off that are nearest to a measured profile.

    Args:
        profile: the light across, as it was seen.
        cone: how rays land.
        dark: see ``Shape``.
        start: radii to begin with.
    """
    r = _entries(len(profile.table), profile.step)
    light = profile.table[:, 0]
    root = _weights(dark, r, light) * (light > SHOWN)

    def left(free: Array) -> Array:
        table = profile_table(free[0], free[1], cone, profile.pixel)
        seen = table.values[:, VALUE] + free[3] * table.values[:, FALLOFF]
        there = np.interp(r, _entries(len(seen), table.step), seen, right=0.0)
        return root * (free[2] * there - light)

    most = 2 * max(profile.end, float(start[0]))
    low, high = np.array([[SMALLEST_PX, most], [SMALLEST_PX, most], [0.5, 2], [-1, 2]]).T
    begun = np.clip([*start, 1.0, LIKELY_SHARE], low + 1e-3, high - 1e-3)
    found = least_squares(left, begun, bounds=(low, high), diff_step=1e-3)
    # of so many places alone the profile tells
    size = 2 * found.cost / max(profile.end / KNOTS_PX - len(begun), 1.0)
    normal = found.jac.T @ found.jac / max(size, 1e-300)
    expected = np.zeros(len(begun))
    expected[3] = LOOSE_SHARE**-2
    covariance = np.linalg.pinv(normal + np.diag(expected), hermitian=True)
    best = found.x + covariance @ (expected * (LIKELY_SHARE - found.x))
    radii = np.sort(np.maximum(best[:2], SMALLEST_PX))[::-1]
    return SeenDiscs(radii, float(np.clip(best[3], 0.0, 1.0)), covariance[:2, :2])


def seen_beside(base: TwoDiscs, radii: Array, shape: Shape) -> Array:
    """``WIDER`` and ``SOFTER`` that a micro-image of other discs has beside a profile, shape (2,).

    Args:
        base: with which it is fitted.
        radii: of its own discs, px, shape (2,).
        shape: what else the light depends on.
    """
    light, _, step = _light(np.maximum(radii, SMALLEST_PX * shape.pixel), shape)
    r, radius = _entries(len(light), step), base.profile.radius
    place = _entries(len(base.profile.table), base.profile.step)
    root = _weights(shape.dark, r, light)

    def left(free: Array) -> Array:
        at = radius + (r - radius - free[0]) * np.exp(-free[1])
        there = np.interp(at, place, base.profile.table[:, 0], right=0.0)
        return root * (free[2] * there + free[3] - light)

    begun = np.array([_half(light) * step - radius, 0.0, 1.0, 0.0])
    return np.asarray(least_squares(left, begun, x_scale=[1.0, 0.1, 0.1, 0.1]).x[:2], np.float64)

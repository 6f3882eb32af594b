"""The light across a micro-image as the camera's shape has it: two overlapping discs and natural
fall-off, as a profile to fit micro-images with, and what the fitted values say of the discs.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.measurement.lattice.mean_profile import Profile
from flflab.measurement.lattice.profile import (
    BY_LARGE,
    BY_SMALL,
    FALLOFF,
    LOPSIDED,
    SMALLEST_PX,
    VALUE,
    Cone,
    profile_table,
)

Array = npt.NDArray[np.float64]

SHOWN = 0.02  # of the light: what a rough profile shows of its end
AROUND = 0.05, 2.0  # of the radius, and px: how far beyond the light the ground is looked at


@dataclass(frozen=True)
class TwoDiscs:
    """A profile of two discs, and how values of single micro-images beside it are read.

    Attributes:
        radii: larger and smaller disc, px, shape (2,).
        profile: the light across.
        by_values: how the radii move with ``WIDER`` and ``SOFTER``, shape (2, 2).
        by_share: how the radii move with the share of fall-off, shape (2,).
        shift_px: how far light that falls off along a micro-image's middle ray moves what is
            fitted as its centre, px per unit of that ray's slope.
        slope: what the same makes of the fitted slope of the light, per unit.
    """

    radii: Array
    profile: Profile
    by_values: Array
    by_share: Array
    shift_px: float
    slope: float


@dataclass(frozen=True)
class Shape:
    """What makes the light across a micro-image, but for its radii.

    Attributes:
        cone: how rays land.
        share: of natural fall-off that there is.
        share_spread: standard uncertainty of that.
        dark: variance of pixels without light over what light adds to it in the brightest ones:
            these weights are those of the fit.
    """

    cone: Cone
    share: float
    share_spread: float
    dark: float

    def weights(self, r: Array, light: Array) -> Array:
        """Roots of the weights of rings of pixels, shape (n,)."""
        return np.sqrt(r / (self.dark + np.maximum(light, 0.0)))


def two_discs(radii: Array, shape: Shape) -> TwoDiscs:
    """The profile of two discs.

    What a value that is not fitted does is what least squares over the micro-image make of it.

    Args:
        radii: larger and smaller disc, px, shape (2,).
        shape: what else the light depends on.
    """
    large, small = np.maximum(radii, SMALLEST_PX).tolist()
    table = profile_table(large, small, shape.cone, shape.share)
    values, r = table.values / table.values[0, VALUE], _entries(len(table.values), table.step)
    light = values[:, VALUE]
    fall = np.asarray(np.gradient(light, table.step), dtype=np.float64)
    radius = _half(light) * table.step
    weights = shape.weights(r, light)[:, None]

    def fitted(by: list[Array], seen: Array) -> Array:
        found = np.linalg.lstsq(np.stack(by, axis=1) * weights, seen * weights, rcond=None)[0]
        return np.asarray(found, dtype=np.float64)

    odd = fitted([-fall, r / radius * light], values[:, LOPSIDED, None])
    even = fitted(
        [light, np.ones_like(r), -fall, -fall * (r - radius)],
        values[:, [BY_LARGE, BY_SMALL, FALLOFF]],
    )
    by_values = np.asarray(np.linalg.inv(even[2:, :2]), dtype=np.float64)
    beyond = int(max(AROUND[0] * radius, AROUND[1]) / table.step)
    shown = np.zeros((len(r) + beyond, 2))
    shown[: len(r)] = np.stack([light, fall], axis=1)
    shown[len(r) - 2 :] = 0.0
    return TwoDiscs(
        np.array([large, small]),
        Profile(radius, table.step, shown),
        by_values,
        -by_values @ even[2:, 2],
        float(odd[0, 0]),
        float(odd[1, 0]),
    )


def _entries(count: int, step: float) -> Array:
    """Distances of a table's entries, px."""
    return np.arange(count, dtype=np.float64) * step


def _half(light: Array) -> float:
    """Where light falls to a half, in entries."""
    last = int(np.flatnonzero(light >= 0.5)[-1])
    return last + (light[last] - 0.5) / max(light[last] - light[last + 1], 1e-12)


def discs_in(profile: Profile, shape: Shape, start: Array) -> tuple[Array, float]:
    """Radii of the two discs that are nearest to a profile measured roughly, px, shape (2,), and
    what they leave of it.

    Args:
        profile: the light across, as it was seen.
        shape: what else the light depends on.
        start: radii to begin with.
    """
    r = _entries(len(profile.table), profile.step)
    light = profile.table[:, 0]
    root = shape.weights(r, light) * (light > SHOWN)

    def left(free: Array) -> Array:
        table = profile_table(free[0], free[1], shape.cone, shape.share)
        place = _entries(len(table.values), table.step)
        return root * (free[2] * np.interp(r, place, table.values[:, VALUE], right=0.0) - light)

    most = 2 * max(profile.end, float(start[0]))
    low = [SMALLEST_PX, SMALLEST_PX, 0.5]
    begun = np.clip([*start, 1.0], np.array(low) * 1.01, [0.99 * most, 0.99 * most, 1.9])
    found = least_squares(left, begun, bounds=(low, [most, most, 2.0]), diff_step=1e-3)
    return np.sort(found.x[:2])[::-1], float(found.cost)


def seen_beside(base: TwoDiscs, radii: Array, shape: Shape) -> Array:
    """``WIDER`` and ``SOFTER`` that a micro-image of other discs has beside a profile, shape (2,).

    Args:
        base: with which it is fitted.
        radii: of its own discs, px, shape (2,).
        shape: what else the light depends on.
    """
    own = two_discs(radii, shape).profile
    r = _entries(len(own.table), own.step)
    light, radius = own.table[:, 0], base.profile.radius
    place = _entries(len(base.profile.table), base.profile.step)
    root = shape.weights(r, light)

    def left(free: Array) -> Array:
        at = radius + (r - radius - free[0]) * np.exp(-free[1])
        there = np.interp(at, place, base.profile.table[:, 0], right=0.0)
        return root * (free[2] * there + free[3] - light)

    begun = np.array([own.radius - radius, 0.0, 1.0, 0.0])
    return np.asarray(least_squares(left, begun, x_scale=[1.0, 0.1, 0.1, 0.1]).x[:2], np.float64)

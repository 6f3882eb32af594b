"""What a measured light across micro-images says of a camera: the two discs that make it, the share
of natural fall-off, and how single micro-images beside it are read.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.measurement.lattice.disc_light import FALLOFF, LOPSIDED, VALUE, Cone, light_across
from flflab.measurement.lattice.mean_profile import KNOTS_PX, Profile

Array = npt.NDArray[np.float64]

SMALLEST_PX = 0.05  # radius of a disc: a smaller one cannot be told from it
LIKELY_SHARE, LOOSE_SHARE = 0.5, 0.5  # of natural fall-off: mean and spread of what is expected
NUDGE = 0.01  # px by which a radius is moved for what it does to the light
SHOWN = 0.02  # of the light: what a rough profile shows of its end


@dataclass(frozen=True)
class Shape:
    """What makes the light across a micro-image, but for its radii.

    Attributes:
        cone: how rays land.
        share: of natural fall-off that there is.
        dark: variance of pixels without light over what light adds to it in the brightest ones:
            these weights are those of the fit.
        pixel: side of the squares over which it is averaged, px.
        sloping: whether micro-images were fitted with slopes of their light.
    """

    cone: Cone
    share: float
    dark: float
    pixel: int
    sloping: bool

    def light(self, radii: Array) -> tuple[Array, Array, Array]:
        """Distances, px, the light there, 1 in the middle, and what a unit of slant adds."""
        large, small = np.maximum(radii, SMALLEST_PX * self.pixel)
        step, seen = light_across(float(large), float(small), self.cone, self.pixel)
        even = seen[:, VALUE] + self.share * seen[:, FALLOFF]
        return _places(step, seen), even / even[0], seen[:, LOPSIDED] / even[0]

    def weights(self, r: Array, light: Array) -> Array:
        """Roots of the weights of rings of pixels, shape (n,)."""
        return np.sqrt(r / (self.dark + np.maximum(light, 0.0)))


def _places(step: float, table: Array) -> Array:
    return step * np.arange(len(table), dtype=np.float64)


def discs_in(profile: Profile, shape: Shape, start: Array) -> tuple[Array, Array, float]:
    """The two discs and the share of natural fall-off that are nearest to a measured profile.

    Args:
        profile: the light across, as it was seen.
        shape: what else makes it; its share is not asked.
        start: radii to begin with.

    Returns:
        Radii, larger first, px, their covariance by what the discs leave of the profile and by the
        share, px^2, and the share.
    """
    r, light = profile.places, profile.table[:, 0]
    root = shape.weights(r, light) * (light > SHOWN)

    def left(free: Array) -> Array:
        step, seen = light_across(free[0], free[1], shape.cone, shape.pixel)
        there = np.interp(r, _places(step, seen), seen @ [1.0, free[3], 0.0], right=0.0)
        return root * (free[2] * there - light)

    most = 2 * max(profile.end, float(start[0]))
    low, high = np.array([[SMALLEST_PX, most], [SMALLEST_PX, most], [0.5, 2], [-1, 2]]).T
    begun = np.clip([*start, 1.0, LIKELY_SHARE], low + 1e-3, high - 1e-3)
    found = least_squares(left, begun, bounds=(low, high), diff_step=1e-3)
    # of so many places alone the profile tells
    size = 2 * found.cost / max(profile.end / KNOTS_PX - len(begun), 1.0)
    normal = found.jac.T @ found.jac / max(size, 1e-300)
    expected = np.array([0.0, 0.0, 0.0, LOOSE_SHARE**-2])
    covariance = np.linalg.pinv(normal + np.diag(expected), hermitian=True)
    best = found.x + covariance @ (expected * (LIKELY_SHARE - found.x))
    radii = np.sort(np.maximum(best[:2], SMALLEST_PX))[::-1]
    return radii, covariance[:2, :2], float(np.clip(best[3], 0.0, 1.0))


def discs_beside(profile: Profile, radii: Array, seen: Array, shape: Shape) -> Array:
    """Radii of the discs of kinds of microlens from the width and softness that each is seen with:
    the larger one, the main lens's shadow, is the same for all.

    Args:
        profile: that all share.
        radii: of its larger and smaller disc, px, shape (2,).
        seen: median ``WIDER`` and ``SOFTER`` of each kind, shape (kinds, 2).
        shape: what else the light depends on.

    Returns:
        Shape (kinds, 2), larger first.
    """
    r, common, radius = profile.places, profile.table[:, 0], profile.radius

    def beside(of: Array) -> Array:
        there, light, _ = shape.light(of)
        root = shape.weights(there, light)

        def left(free: Array) -> Array:
            at = radius + (there - radius - free[0]) * np.exp(-free[1])
            return root * (free[2] * np.interp(at, r, common, right=0.0) + free[3] - light)

        begun = [_half(there, light) - radius, 0.0, 1.0, 0.0]
        return np.asarray(least_squares(left, begun, x_scale=[1.0, 0.1, 0.1, 0.1]).x[:2])

    def off(free: Array) -> Array:
        each = [beside(np.array([free[0], small])) for small in free[1:]]
        return ((np.array(each) - seen) * [1.0, radius]).ravel()

    begun = np.concatenate([radii[:1], radii[1] * np.exp(seen[:, 1])])
    bounds = SMALLEST_PX * shape.pixel, np.inf
    begun = np.maximum(begun, 1.001 * bounds[0])
    found = least_squares(off, begun, bounds=bounds, diff_step=1e-3, max_nfev=15).x
    return np.stack([np.full(len(seen), found[0]), found[1:]], axis=1)


def reading(radii: Array, shape: Shape) -> tuple[Array, float]:
    """How micro-images of two discs are read: what a value that is not fitted does is what least
    squares over the micro-image make of it.

    Args:
        radii: larger and smaller disc, px, shape (2,).
        shape: what else the light depends on.

    Returns:
        How the radii move with ``WIDER`` and ``SOFTER``, shape (2, 2); and how far natural fall-off
        moves what is fitted as the centre, px per unit of the slope of the middle ray.
    """
    r, value, lopsided = shape.light(radii)
    fall = np.asarray(np.gradient(value, r[1]), dtype=np.float64)
    weights = shape.weights(r, value)[:, None]
    wider = [
        np.interp(r, *shape.light(radii + NUDGE * one)[:2], right=0.0) - value for one in np.eye(2)
    ]

    def fitted(by: list[Array], seen: list[Array]) -> Array:
        design, rest = np.stack(by, axis=1) * weights, np.stack(seen, axis=1) * weights
        return np.asarray(np.linalg.lstsq(design, rest, rcond=None)[0], dtype=np.float64)

    odd = fitted([-fall, r * value][: 2 if shape.sloping else 1], [lopsided])
    even = fitted([value, np.ones_like(r), -fall, -fall * (r - _half(r, value))], wider)
    return np.asarray(np.linalg.inv(even[2:] / NUDGE), dtype=np.float64), float(odd[0, 0])


def _half(r: Array, light: Array) -> float:
    """Where light falls to a half, px."""
    last = int(np.flatnonzero(light >= 0.5)[-1])
    beyond = (light[last] - 0.5) / max(light[last] - light[last + 1], 1e-12)
    return float(r[last] + beyond * r[1])

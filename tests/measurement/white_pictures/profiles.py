"""Shapes of a single micro-image: light against the distance from its centre, 1 on the plateau."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import erfc

Array = npt.NDArray[np.float64]

_NOTHING = 1e-7  # of the plateau: light below is not drawn
_PIXEL_ERROR = 8e-5  # of the plateau: what a pixel's mean may be wrong by at a straight rim


@dataclass(frozen=True)
class OverlappingDiscs:
    """Area that two discs share, as a share of the smaller: a lens's aperture seen through a pupil.

    Attributes:
        a: Radius of one disc, px.
        b: Radius of the other, px; light falls from 1 to 0 between ``|a - b|`` and ``a + b``.
    """

    a: float
    b: float

    def light(self, r: Array) -> Array:
        small, large = min(self.a, self.b), max(self.a, self.b)
        light = np.where(r <= large - small, 1.0, 0.0)
        rim = (r > large - small) & (r < large + small)
        x = r[rim]
        p = np.arccos(np.clip((x * x + small**2 - large**2) / (2 * x * small), -1, 1))
        q = np.arccos(np.clip((x * x + large**2 - small**2) / (2 * x * large), -1, 1))
        area = small**2 * (p - np.sin(2 * p) / 2) + large**2 * (q - np.sin(2 * q) / 2)
        light[rim] = area / (math.pi * small**2)
        return light

    @property
    def farthest(self) -> float:
        return self.a + self.b


@dataclass(frozen=True)
class SoftDisc:
    """A disc blurred across its rim: half of the error function's complement.

    Attributes:
        radius: Where light is half, px.
        softness: Standard deviation of the blur, px.
    """

    radius: float
    softness: float

    def light(self, r: Array) -> Array:
        rim = erfc((r - self.radius) / (math.sqrt(2) * self.softness))
        return np.asarray(rim / erfc(-self.radius / (math.sqrt(2) * self.softness)))

    @property
    def farthest(self) -> float:
        return self.radius + 6 * self.softness


@dataclass(frozen=True)
class Blob:
    """A spot ``2^-(r/radius)^exponent``; a Gaussian at exponent 2, flatter above.

    Attributes:
        radius: Where light is half, px.
        exponent: 2 to 8.
    """

    radius: float
    exponent: float = 2.0

    def light(self, r: Array) -> Array:
        return np.exp(-math.log(2) * (r / self.radius) ** self.exponent)

    @property
    def farthest(self) -> float:
        return self.radius * 24.0 ** (1 / self.exponent)


Profile = OverlappingDiscs | SoftDisc | Blob


@dataclass(frozen=True)
class ProfileTable:
    """A profile made ready for drawing.

    Attributes:
        light: Light at steps of the distance from ``inner`` on.
        step: px.
        inner: Light is 1 up to here, px.
        outer: Light is 0 from here on, px.
        half: Where light is half, px.
        rim_end: Where one hundredth of the light is left, px.
        nodes: Points of a pixel at which its mean is taken, along one side, px from its middle.
        weights: Their weights; they sum to 1.
    """

    light: Array
    step: float
    inner: float
    outer: float
    half: float
    rim_end: float
    nodes: Array
    weights: Array

    def at_light(self, share: float) -> float:
        """Distance at which the profile has fallen to this share, px."""
        return falls_to(self.light, self.inner, self.step, share)


def falls_to(light: Array, start: float, step: float, share: float) -> float:
    """Where a falling table crosses a share, interpolated."""
    last = int(np.flatnonzero(light > share)[-1])
    part = (light[last] - share) / (light[last] - light[last + 1])
    return start + step * (last + float(part))


def gauss(order: int) -> tuple[Array, Array]:
    """Gauss's nodes and weights for the mean over a pixel's side."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return nodes / 2, weights / 2


def tabulate(profile: Profile) -> ProfileTable:
    """Table of a profile.

    Raises:
        ValueError: the rim is so sharp that no order of at most 24 gives pixels' means to 8e-5.
    """
    coarse: Array = np.linspace(0, profile.farthest, 20001, dtype=np.float64)
    light = profile.light(coarse)
    flat = np.flatnonzero(light < 1 - _NOTHING)
    inner = float(coarse[max(0, int(flat[0]) - 1)])
    outer = float(coarse[min(20000, int(np.flatnonzero(light > _NOTHING)[-1]) + 1)])
    count = min(60000, max(4000, math.ceil((outer - inner) / 0.002)))
    step = (outer - inner) / count
    distances: Array = inner + step * np.arange(count + 1, dtype=np.float64)
    table = profile.light(distances)
    table[-1] = 0.0
    order = _order(profile, inner, outer)
    nodes, weights = gauss(order)
    return ProfileTable(
        table,
        step,
        inner,
        outer,
        falls_to(table, inner, step, 0.5),
        falls_to(table, inner, step, 0.01),
        nodes,
        weights,
    )


def _order(profile: Profile, inner: float, outer: float) -> int:
    """Order of Gauss's rule that suffices where the rim runs along the pixels' sides."""
    middles: Array = np.linspace(max(inner - 0.5, 0.5), outer + 0.5, 1500, dtype=np.float64)
    fine, fine_weights = gauss(60)
    exact = profile.light(middles[:, None] + fine) @ fine_weights
    for order in range(3, 25):
        nodes, weights = gauss(order)
        mean = profile.light(middles[:, None] + nodes) @ weights
        if np.abs(mean - exact).max() < _PIXEL_ERROR:
            return order
    raise ValueError(f"{profile}: its rim is too sharp for pixels' means to {_PIXEL_ERROR:g}")

"""Shapes of a single micro-image: light against the distance from its centre, 1 on the plateau."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import erfc

Array = npt.NDArray[np.float64]

NOTHING = 1e-7  # of the plateau: light below is not drawn
STEPS = 8000  # of a table across the rim


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
    """

    light: Array
    step: float
    inner: float
    outer: float

    def falls_to(self, share: float) -> float:
        """Distance at which the profile has fallen to this share, px."""
        last = int(np.flatnonzero(self.light > share)[-1])
        part = (self.light[last] - share) / (self.light[last] - self.light[last + 1])
        return self.inner + self.step * (last + float(part))


def tabulate(profile: Profile) -> ProfileTable:
    """Table of a profile across its rim."""
    coarse: Array = np.linspace(0, profile.farthest, 20001, dtype=np.float64)
    light = profile.light(coarse)
    inner = float(coarse[max(0, int(np.argmax(light < 1 - NOTHING)) - 1)])
    outer = float(coarse[min(20000, int(np.flatnonzero(light > NOTHING)[-1]) + 1)])
    table = profile.light(np.linspace(inner, outer, STEPS + 1, dtype=np.float64))
    table[-1] = 0.0
    return ProfileTable(table, (outer - inner) / STEPS, inner, outer)

"""Halo: a share of the light of every point lands in a wide spot round it (scatter in glass and
cover).
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from scipy.ndimage import gaussian_filter

from flflab.errors import InputError
from flflab.image.effects.effect import Array, Formed
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Halo:
    """``share`` of the light is spread as a Gaussian of the standard deviation ``radius``, mm on
    the sensor.
    """

    share: float
    radius: float
    name: ClassVar[str] = "halo"
    unit: ClassVar[str] = "of light"

    def __post_init__(self) -> None:
        """Refuse what is no halo.

        Raises:
            InputError: the share is not from 0 to 1, or the radius not above 0.
        """
        if not 0 <= self.share <= 1:
            raise InputError(f"halo: share is {self.share:g}; from 0 to 1 is allowed")
        if not (math.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"halo: radius is {self.radius:g} mm; a length above 0 is due")

    def size(self, regime: Regime) -> float:
        """Its share."""
        return self.share

    def bound(self, regime: Regime) -> float:
        """No pixel loses or gains more than this share of the brightest light."""
        return self.share * regime.brightest

    def cost(self, regime: Regime) -> float:
        """Two passes of a filter, 100 ns a pixel."""
        return 1e-4 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How far the light goes."""
        return f"{self.share:.3g} of all light lands {1e3 * self.radius:.3g} um aside"

    def apply(self, image: Array, formed: Formed) -> None:
        """Take the share, and add it where it is spread to."""
        radius = self.radius / formed.camera.sensor.pixel
        image += self.share * (gaussian_filter(image, radius, mode="constant") - image)

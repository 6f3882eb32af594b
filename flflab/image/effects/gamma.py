"""Gamma: the sensor's numbers rise as a power of the light."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flflab.image.effects.effect import Array, Formed, require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Gamma:
    """What is read is the light, of white, to the power ``exponent``; 1: in proportion."""

    exponent: float
    name: ClassVar[str] = "gamma"
    unit: ClassVar[str] = "from 1"

    def __post_init__(self) -> None:
        """The exponent lies between 0.3 and 3.

        Raises:
            InputError: it is not.
        """
        require(self.name, "exponent", self.exponent, 0.3, 3)

    def size(self, regime: Regime) -> float:
        """How far it is from 1."""
        return abs(self.exponent - 1)

    def bound(self, regime: Regime) -> float:
        """Largest |x^g - x| up to the brightest light: at x = g^(1 / (1 - g)) or at its end."""
        exponent, brightest = self.exponent, regime.brightest
        if exponent == 1:
            return 0.0
        steepest = min(exponent ** (1 / (1 - exponent)), brightest)
        return max(abs(x**exponent - x) for x in (steepest, brightest))

    def cost(self, regime: Regime) -> float:
        """One power a pixel, 20 ns."""
        return 2e-5 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How far half of white is off."""
        return f"half of white reads {math.pow(0.5, self.exponent):.3g}"

    def apply(self, image: Array, formed: Formed) -> None:
        """Raise every pixel to the power."""
        np.power(np.maximum(image, 0.0), self.exponent, out=image)

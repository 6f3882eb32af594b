"""Gamma: the sensor's numbers rise as a power of the light."""

import math
from dataclasses import dataclass

import numpy as np

from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Gamma(Finishing):
    """What is read is the light, of white, to the power ``exponent``; 1: in proportion."""

    exponent: float = parameter(least=0.3, most=3)
    name = "gamma"
    unit = "from 1"
    pixel_ns = 20  # one power a pixel

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

    def why(self, regime: Regime) -> str:
        """How far half of white is off."""
        return f"half of white reads {math.pow(0.5, self.exponent):.3g}"

    def apply(self, image: Array, formed: Formed) -> None:
        """Raise every pixel to the power."""
        np.power(np.maximum(image, 0.0), self.exponent, out=image)

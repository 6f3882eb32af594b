"""Gamma: the sensor's numbers rise as a power of the light."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Gamma:
    """What is read is the light, of white, to the power ``exponent``; 1: in proportion."""

    exponent: float
    name: ClassVar[str] = "gamma"
    unit: ClassVar[str] = "from 1"

    def __post_init__(self) -> None:
        """Refuse what is no gamma.

        Raises:
            InputError: it is not from 0.3 to 3.
        """
        if not 0.3 <= self.exponent <= 3:
            raise InputError(f"gamma: exponent is {self.exponent:g}; from 0.3 to 3 is allowed")

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

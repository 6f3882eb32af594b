"""Shot noise: electrons come at random."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime


@dataclass(frozen=True)
class ShotNoise(Effect):
    """The electrons of a pixel, those of the dark current too, are a Poisson number. It has no
    number of its own.
    """

    name = "shot-noise"
    unit = "of white"
    pixel_ns = 9  # a Poisson number a pixel

    def size(self, regime: Regime) -> float:
        """Standard deviation at the white level."""
        return 1 / math.sqrt(regime.electrons) if regime.electrons > 0 else math.inf

    def bound(self, regime: Regime) -> float:
        """Six standard deviations at the brightest light: one pixel in 10^9 is farther off."""
        return 6 * self.size(regime) * math.sqrt(regime.brightest)

    def why(self, regime: Regime) -> str:
        """How much light there is."""
        return f"white makes {regime.electrons:.0f} electrons in a pixel"

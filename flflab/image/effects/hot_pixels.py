"""Hot pixels: in some, far more electrons gather in the dark than in the others."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class HotPixels(Effect):
    """A ``share`` of the pixels, drawn once from the ``seed`` of a sensor, gathers further
    electrons during the exposure: exponentially distributed from pixel to pixel, ``electrons`` on
    average. They have shot noise like all electrons.
    """

    share: float = parameter(most=1)
    electrons: float = parameter(unit="electrons")
    seed: int = parameter(0)
    name = "hot-pixels"
    unit = "of the pixels"
    pixel_ns = 4  # a random number a pixel

    def bound(self, regime: Regime) -> float:
        """What one pixel in 10^9 exceeds: 20.7 times the mean."""
        return regime.of_white(math.log(1e9) * self.electrons) if self.share > 0 else 0.0

    def why(self, regime: Regime) -> str:
        """How many, and how hot."""
        return (
            f"about {self.share * regime.pixels:.3g} pixels gather {self.electrons:.3g} electrons"
            " more in the dark"
        )

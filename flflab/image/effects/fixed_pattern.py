"""Fixed pattern: every pixel has its own gain and its own offset, the same in every frame."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class FixedPattern(Effect):
    """Independent normal errors of every pixel, drawn once from the ``seed`` of a sensor.

    ``gain`` is the standard deviation of the response to light relative to its mean (PRNU),
    ``offset`` that of what a pixel reads in the dark, electrons (DSNU).
    """

    gain: float = parameter(0.0, most=0.1, unit="of the mean gain")
    offset: float = parameter(0.0, unit="electrons")
    seed: int = parameter(0)
    name = "fixed-pattern"
    unit = "of white"
    pixel_ns = 8  # two normal numbers a pixel

    def size(self, regime: Regime) -> float:
        """Standard deviation at the white level."""
        return math.hypot(self.gain, regime.of_white(self.offset))

    def bound(self, regime: Regime) -> float:
        """Six standard deviations at the brightest light: one pixel in 10^9 is farther off."""
        return 6 * math.hypot(self.gain * regime.brightest, regime.of_white(self.offset))

    def why(self, regime: Regime) -> str:
        """Both parts."""
        return f"gains differ by {100 * self.gain:.2g} %, offsets by {self.offset:.3g} electrons"

"""Read noise: reading a pixel adds a normal number of electrons."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class ReadNoise(Effect):
    """Independent normal errors of every reading, ``electrons`` their standard deviation."""

    electrons: float = parameter(3.0, unit="electrons")
    name = "read-noise"
    unit = "of white"
    pixel_ns = 5  # a normal number a pixel

    def size(self, regime: Regime) -> float:
        """Standard deviation."""
        return regime.of_white(self.electrons)

    def bound(self, regime: Regime) -> float:
        """Six standard deviations: one pixel in 10^9 is farther off."""
        return 6 * self.size(regime)

    def why(self, regime: Regime) -> str:
        """How much of how much."""
        return f"{self.electrons:.3g} electrons of {regime.electrons:.0f} at white"

"""Read noise: reading a pixel adds a normal number of electrons."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class ReadNoise:
    """Independent normal errors of every reading, ``electrons`` their standard deviation."""

    electrons: float = 3.0
    name: ClassVar[str] = "read-noise"
    unit: ClassVar[str] = "of white"

    def __post_init__(self) -> None:
        """The noise is 0 or more.

        Raises:
            InputError: it is not.
        """
        require(self.name, "electrons", self.electrons)

    def size(self, regime: Regime) -> float:
        """Standard deviation."""
        return self.electrons / regime.electrons if regime.electrons > 0 else math.inf

    def bound(self, regime: Regime) -> float:
        """Six standard deviations: one pixel in 10^9 is farther off."""
        return 6 * self.size(regime)

    def cost(self, regime: Regime) -> float:
        """A normal number a pixel."""
        return 5e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How much of how much."""
        return f"{self.electrons:.3g} electrons of {regime.electrons:.0f} at white"

"""Dark current: electrons gather in the dark too."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class DarkCurrent(Effect):
    """``electrons_per_second`` gather in every pixel over the ``exposure`` (s), on average; they
    have shot noise like all electrons.
    """

    electrons_per_second: float = parameter(unit="electrons/s")
    exposure: float = parameter(unit="s")
    name = "dark-current"
    unit = "electrons"
    pixel_ns = 0.2  # one sum a pixel

    @property
    def electrons(self) -> float:
        """Mean electrons of one exposure."""
        return self.electrons_per_second * self.exposure

    def size(self, regime: Regime) -> float:
        """Mean electrons that gather in the dark."""
        return self.electrons

    def bound(self, regime: Regime) -> float:
        """The mean, and six standard deviations of what comes by chance."""
        return regime.of_white(self.electrons + 6 * math.sqrt(self.electrons))

    def why(self, regime: Regime) -> str:
        """How long."""
        return f"{self.electrons_per_second:.3g} electrons/s over {self.exposure:.3g} s"

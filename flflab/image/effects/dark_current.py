"""Dark current: electrons gather in the dark too."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class DarkCurrent:
    """``electrons_per_second`` gather in every pixel over the ``exposure`` (s), on average; they
    have shot noise like all electrons.
    """

    electrons_per_second: float
    exposure: float
    name: ClassVar[str] = "dark-current"
    unit: ClassVar[str] = "electrons"

    def __post_init__(self) -> None:
        """Both numbers are 0 or more.

        Raises:
            InputError: it is not.
        """
        require(self.name, "electrons_per_second", self.electrons_per_second, of=" electrons/s")
        require(self.name, "exposure", self.exposure, of=" s")

    @property
    def electrons(self) -> float:
        """Mean electrons of one exposure."""
        return self.electrons_per_second * self.exposure

    def size(self, regime: Regime) -> float:
        """Mean electrons that gather in the dark."""
        return self.electrons

    def bound(self, regime: Regime) -> float:
        """The mean, and six standard deviations of what comes by chance."""
        return (
            (self.electrons + 6 * math.sqrt(self.electrons)) / regime.electrons
            if regime.electrons > 0
            else math.inf
        )

    def cost(self, regime: Regime) -> float:
        """One sum a pixel."""
        return 2e-7 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How long."""
        return f"{self.electrons_per_second:.3g} electrons/s over {self.exposure:.3g} s"

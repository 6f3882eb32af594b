"""Saturation: a pixel holds no more electrons than its full well."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Saturation:
    """``full_well`` is the number of electrons a pixel can hold; more are lost."""

    full_well: float = 10000.0
    name: ClassVar[str] = "saturation"
    unit: ClassVar[str] = "of white"

    def __post_init__(self) -> None:
        """The well holds 1 electron or more.

        Raises:
            InputError: it is not.
        """
        require(self.name, "full_well", self.full_well, 1, of=" electrons")

    def size(self, regime: Regime) -> float:
        """The light that fills a pixel."""
        return self.full_well / regime.electrons if regime.electrons > 0 else math.inf

    def bound(self, regime: Regime) -> float:
        """What is cut off the brightest light."""
        return max(0.0, regime.brightest - self.size(regime))

    def cost(self, regime: Regime) -> float:
        """One comparison a pixel."""
        return 2e-7 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How full a pixel is."""
        return (
            f"the brightest light makes {regime.brightest * regime.electrons:.0f} electrons of"
            f" {self.full_well:.0f}"
        )

"""Dark current: electrons gather in the dark too."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
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
        """Refuse what is no current.

        Raises:
            InputError: a number is negative or not finite.
        """
        for name, value, unit in (
            ("electrons_per_second", self.electrons_per_second, "electrons/s"),
            ("exposure", self.exposure, "s"),
        ):
            if not (math.isfinite(value) and value >= 0):
                raise InputError(
                    f"dark current: {name} is {value:g} {unit}; a finite number from 0 up is due"
                )

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

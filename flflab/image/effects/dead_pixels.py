"""Dead pixels: some read the same whatever falls on them."""

from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class DeadPixels:
    """A ``share`` of the pixels, drawn once from the ``seed`` of a sensor, is stuck: half of them
    at 0, half at full scale.
    """

    share: float
    seed: int = 0
    name: ClassVar[str] = "dead-pixels"
    unit: ClassVar[str] = "of the pixels"

    def __post_init__(self) -> None:
        """The share lies between 0 and 1.

        Raises:
            InputError: it is not.
        """
        require(self.name, "share", self.share, most=1)

    def size(self, regime: Regime) -> float:
        """Their share."""
        return self.share

    def bound(self, regime: Regime) -> float:
        """A stuck pixel may read anything."""
        return max(1.0, regime.brightest) if self.share > 0 else 0.0

    def cost(self, regime: Regime) -> float:
        """A random number a pixel."""
        return 4e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How many."""
        return f"about {self.share * regime.pixels:.3g} of {regime.pixels:.3g} pixels are stuck"

"""Hot pixels: in some, far more electrons gather in the dark than in the others."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class HotPixels:
    """A ``share`` of the pixels, drawn once from the ``seed`` of a sensor, gathers further
    electrons during the exposure: exponentially distributed from pixel to pixel, ``electrons`` on
    average. They have shot noise like all electrons.
    """

    share: float
    electrons: float
    seed: int = 0
    name: ClassVar[str] = "hot-pixels"
    unit: ClassVar[str] = "of the pixels"

    def __post_init__(self) -> None:
        """The share lies between 0 and 1, electrons are 0 or more.

        Raises:
            InputError: it is not.
        """
        require(self.name, "share", self.share, most=1)
        require(self.name, "electrons", self.electrons)

    def size(self, regime: Regime) -> float:
        """Their share."""
        return self.share

    def bound(self, regime: Regime) -> float:
        """What one pixel in 10^9 exceeds: 20.7 times the mean."""
        if self.share == 0 or self.electrons == 0:
            return 0.0
        most = math.log(1e9) * self.electrons
        return most / regime.electrons if regime.electrons > 0 else math.inf

    def cost(self, regime: Regime) -> float:
        """A random number a pixel."""
        return 4e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How many, and how hot."""
        return (
            f"about {self.share * regime.pixels:.3g} pixels gather {self.electrons:.3g} electrons"
            " more in the dark"
        )

"""Fixed pattern: every pixel has its own gain and its own offset, the same in every frame."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class FixedPattern:
    """Independent normal errors of every pixel, drawn once from the ``seed`` of a sensor.

    ``gain`` is the standard deviation of the response to light relative to its mean (PRNU),
    ``offset`` that of what a pixel reads in the dark, electrons (DSNU).
    """

    gain: float = 0.0
    offset: float = 0.0
    seed: int = 0
    name: ClassVar[str] = "fixed-pattern"
    unit: ClassVar[str] = "of white"

    def __post_init__(self) -> None:
        """No gain is negative, and offsets are 0 or more.

        Raises:
            InputError: it is not.
        """
        require(self.name, "gain", self.gain, most=0.1, of=" of the mean gain")
        require(self.name, "offset", self.offset, of=" electrons")

    def size(self, regime: Regime) -> float:
        """Standard deviation at the white level."""
        return math.hypot(self.gain, self._offset(regime))

    def bound(self, regime: Regime) -> float:
        """Six standard deviations at the brightest light: one pixel in 10^9 is farther off."""
        return 6 * math.hypot(self.gain * regime.brightest, self._offset(regime))

    def cost(self, regime: Regime) -> float:
        """Two normal numbers a pixel."""
        return 8e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """Both parts."""
        return f"gains differ by {100 * self.gain:.2g} %, offsets by {self.offset:.3g} electrons"

    def _offset(self, regime: Regime) -> float:
        if self.offset == 0:
            return 0.0
        return self.offset / regime.electrons if regime.electrons > 0 else math.inf

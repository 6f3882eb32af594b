"""Columns and taps: the sensor reads each column, and each block of columns, with a gain of its
own.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from flflab.image.effects.effect import Array, Formed, require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Columns:
    """Independent normal errors of the gains, drawn once from the ``seed`` of a sensor.

    ``column`` is the standard deviation from column to column, ``tap`` that from one to the next of
    ``taps`` equal blocks that lie side by side, both relative to the mean gain.
    """

    column: float = 0.0
    tap: float = 0.0
    taps: int = 2
    seed: int = 0
    name: ClassVar[str] = "columns"
    unit: ClassVar[str] = "of light"

    def __post_init__(self) -> None:
        """No gain is negative, and there are 1 to 64 taps.

        Raises:
            InputError: it is not.
        """
        require(self.name, "column", self.column, most=0.1, of=" of the mean gain")
        require(self.name, "tap", self.tap, most=0.1, of=" of the mean gain")
        require(self.name, "taps", self.taps, 1, 64)
        require(self.name, "seed", self.seed)

    def gains(self, count: int) -> Array:
        """Gains of so many columns, 1 on average."""
        rng = np.random.Generator(np.random.Philox(key=self.seed))
        taps = 1 + self.tap * rng.standard_normal(self.taps)
        block = np.arange(count) * self.taps // max(count, 1)
        return taps[block] * (1 + self.column * rng.standard_normal(count))

    def size(self, regime: Regime) -> float:
        """Standard deviation of both."""
        return math.hypot(self.column, self.tap)

    def bound(self, regime: Regime) -> float:
        """Six standard deviations at the brightest light: one column in 10^9 is farther off."""
        return 6 * self.size(regime) * regime.brightest

    def cost(self, regime: Regime) -> float:
        """One product a pixel."""
        return 2e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """Both parts."""
        return (
            f"gains of columns differ by {100 * self.column:.2g} %, of {self.taps} taps by"
            f" {100 * self.tap:.2g} %"
        )

    def apply(self, image: Array, formed: Formed) -> None:
        """Multiply every column by its gain."""
        image *= self.gains(image.shape[1])

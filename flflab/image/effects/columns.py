"""Columns and taps: the sensor reads each column, and each block of columns, with a gain of its
own.
"""

import math
from dataclasses import dataclass

import numpy as np

from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Columns(Finishing):
    """Independent normal errors of the gains, drawn once from the ``seed`` of a sensor.

    ``column`` is the standard deviation from column to column, ``tap`` that from one to the next of
    ``taps`` equal blocks that lie side by side, both relative to the mean gain.
    """

    column: float = parameter(0.0, most=0.1, unit="of the mean gain")
    tap: float = parameter(0.0, most=0.1, unit="of the mean gain")
    taps: int = parameter(2, least=1, most=64)
    seed: int = parameter(0)
    name = "columns"
    unit = "of light"
    pixel_ns = 2  # one product a pixel

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

    def why(self, regime: Regime) -> str:
        """Both parts."""
        return (
            f"gains of columns differ by {100 * self.column:.2g} %, of {self.taps} taps by"
            f" {100 * self.tap:.2g} %"
        )

    def apply(self, image: Array, formed: Formed) -> None:
        """Multiply every column by its gain."""
        image *= self.gains(image.shape[1])

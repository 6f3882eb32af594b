"""Dead pixels: some read the same whatever falls on them."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class DeadPixels(Effect):
    """A ``share`` of the pixels, drawn once from the ``seed`` of a sensor, is stuck: half of them
    at 0, half at full scale.
    """

    share: float = parameter(most=1)
    seed: int = parameter(0)
    name = "dead-pixels"
    unit = "of the pixels"
    pixel_ns = 4  # a random number a pixel

    def bound(self, regime: Regime) -> float:
        """A stuck pixel may read anything."""
        return max(1.0, regime.brightest) if self.share > 0 else 0.0

    def why(self, regime: Regime) -> str:
        """How many."""
        return f"about {self.share * regime.pixels:.3g} of {regime.pixels:.3g} pixels are stuck"

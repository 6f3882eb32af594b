"""Saturation: a pixel holds no more electrons than its full well."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Saturation(Effect):
    """``full_well`` is the number of electrons a pixel can hold; more are lost."""

    full_well: float = parameter(10000.0, unit="electrons", least=1)
    name = "saturation"
    unit = "of white"
    pixel_ns = 0.2  # one comparison a pixel

    def size(self, regime: Regime) -> float:
        """The light that fills a pixel."""
        return regime.of_white(self.full_well)

    def bound(self, regime: Regime) -> float:
        """What is cut off the brightest light."""
        return max(0.0, regime.brightest - self.size(regime))

    def why(self, regime: Regime) -> str:
        """How full a pixel is."""
        return (
            f"the brightest light makes {regime.brightest * regime.electrons:.0f} electrons of"
            f" {self.full_well:.0f}"
        )

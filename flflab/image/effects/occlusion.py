"""Occlusion: a card hides what is behind it."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Occlusion(Effect):
    """Its numbers stand in the planes; left out, the light of all planes adds up."""

    name = "occlusion"
    unit = "planes"
    lit_ns = 350  # rays, once more

    def size(self, regime: Regime) -> float:
        """How many planes stand before another."""
        return float(len(regime.planes) - 1)

    def bound(self, regime: Regime) -> float:
        """All light of the planes behind."""
        return (len(regime.planes) - 1) * regime.brightest

    def why(self, regime: Regime) -> str:
        """How many planes."""
        return f"{len(regime.planes)} targets stand behind each other"

"""Overlap: the light of neighbouring microlenses adds up where their micro-images overlap."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Overlap(Effect):
    """Left out, a pixel gets the light of the micro-image whose centre is nearest alone. It has no
    number of its own.
    """

    name = "overlap"
    unit = "px"

    def size(self, regime: Regime) -> float:
        """How far neighbouring micro-images reach into each other; negative for a gap between
        them.
        """
        return -regime.gap

    def bound(self, regime: Regime) -> float:
        """All light that neighbours can bring to a pixel."""
        return min(regime.crosstalk, regime.brightest)

    def cost(self, regime: Regime) -> float:
        """Light of a neighbour is formed like a pixel's own, 5 ns."""
        return 5e-6 * regime.pixels * max(0.0, regime.light - 1)

    def why(self, regime: Regime) -> str:
        """Whether neighbours overlap."""
        return "neighbours overlap" if regime.gap < 0 else "neighbours do not touch"

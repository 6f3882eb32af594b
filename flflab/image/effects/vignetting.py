"""Vignetting by two apertures: towards its rim a micro-image is lit by less and less of the
pupil.
"""

from dataclasses import dataclass
from typing import ClassVar

from flflab.image.regime import Regime

MEAN_REACH = 0.4244  # mean of |x| over the unit disc, 4 / (3 pi)


@dataclass(frozen=True)
class Vignetting:
    """Left out, a micro-image is evenly bright and ends at once, in the middle of its rim. It has
    no number of its own.
    """

    name: ClassVar[str] = "vignetting"
    unit: ClassVar[str] = "px"

    def size(self, regime: Regime) -> float:
        """Width of the widest rim."""
        return regime.rim

    def bound(self, regime: Regime) -> float:
        """The rim that each point of the pupil casts is off by that point's distance from the
        middle, and a pixel limits it.
        """
        return min(regime.brightest, regime.reaching * 2 * MEAN_REACH * regime.rim / 2)

    def cost(self, regime: Regime) -> float:
        """A look into a table, 3 ns."""
        return 3e-6 * regime.pixels * regime.lit

    def why(self, regime: Regime) -> str:
        """How wide."""
        return "both apertures clip: light falls off across the rim"

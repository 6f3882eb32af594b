"""Vignetting by two apertures: towards its rim a micro-image is lit by less and less of the
pupil.
"""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime

MEAN_REACH = 0.4244  # mean of |x| over the unit disc, 4 / (3 pi)


@dataclass(frozen=True)
class Vignetting(Effect):
    """Left out, a micro-image is evenly bright and ends at once, in the middle of its rim. It has
    no number of its own.
    """

    name = "vignetting"
    unit = "px"
    lit_ns = 3  # a look into a table

    def size(self, regime: Regime) -> float:
        """Width of the widest rim."""
        return regime.rim

    def bound(self, regime: Regime) -> float:
        """The rim that each point of the pupil casts is off by that point's distance from the
        middle, and a pixel limits it.
        """
        return min(regime.brightest, regime.reaching * 2 * MEAN_REACH * regime.rim / 2)

    def why(self, regime: Regime) -> str:
        """How wide."""
        return "both apertures clip: light falls off across the rim"

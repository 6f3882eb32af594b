"""Defocus: the rays of a pixel go through all of the pupil and meet the target apart from each
other.
"""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime

MEAN_REACH = 0.4244  # mean of |x| over the unit disc, 4 / (3 pi)
SHARP = 1e-3  # px of blur: less is in focus


@dataclass(frozen=True)
class Defocus(Effect):
    """Left out, a pixel sees the target through the middle of the pupil alone. It has no number of
    its own.
    """

    name = "defocus"
    unit = "px"

    def size(self, regime: Regime) -> float:
        """Diameter of the blur of a point."""
        return regime.blur

    def bound(self, regime: Regime) -> float:
        """A ray is off its place by the mean distance in the blur, along x and along y; the pixel
        alone limits what that changes.
        """
        axes = [1 if plane.plain else 2 for plane in regime.planes]
        moved = [
            regime.light * MEAN_REACH * count * plane.blur / 2
            for count, plane in zip(axes, regime.planes, strict=True)
        ]
        return sum(
            min(plane.contrast, change) for plane, change in zip(regime.planes, moved, strict=True)
        )

    def cost(self, regime: Regime) -> float:
        """Half a nanosecond a strip, of which wide blurs take more."""
        strips = 10 * math.sqrt(min(regime.blur, 1.0) * (1 + regime.blur / 18))
        return 5e-7 * regime.pixels * regime.lit * min(strips, 1e3)

    def why(self, regime: Regime) -> str:
        """What a blur below half a pixel does, or that the target is out of focus."""
        if regime.blur < SHARP:
            return "the target is in focus"
        return (
            f"a blur of {regime.blur:.2g} pixels softens edges"
            if regime.blur < 0.5
            else "the target is out of focus"
        )

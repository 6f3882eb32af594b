"""Pixel area: a pixel gathers the light of its whole square."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime

MEAN_DISTANCE = 0.3826  # of the points of a unit square from its middle


@dataclass(frozen=True)
class Pixel(Effect):
    """Left out, a pixel holds what falls on its centre. It has no number of its own."""

    name = "pixel"
    unit = "px"

    def size(self, regime: Regime) -> float:
        """Its side."""
        return 1.0

    def bound(self, regime: Regime) -> float:
        """Light moves by the mean distance in a pixel, of the target and of the rims; only their
        blurs limit what that changes.
        """
        light = (
            regime.reaching * MEAN_DISTANCE * 1.2733
        )  # a disc moved by a part of its diameter: 4 / pi of it changes
        target = sum(
            min(
                plane.contrast, light / plane.least_blur if plane.least_blur > 0 else plane.contrast
            )
            for plane in regime.planes
        )
        rims = light / regime.least_rim if regime.least_rim > 0 else regime.brightest
        return min(regime.brightest, target + rims)

    def why(self, regime: Regime) -> str:
        """Always."""
        return "light varies within a pixel"

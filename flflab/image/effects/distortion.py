"""Distortion of the main lens: what is seen under a paraxial slope lies under another one."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import PlaneRegime, Regime


@dataclass(frozen=True)
class Distortion(Effect):
    """A ray whose paraxial object point is o (mm, at distance D) comes from o (1 + coefficient |o /
    D|^2).

    A positive ``coefficient`` (1/rad^2) is a barrel: the border of the picture sees more than it
    should.
    """

    coefficient: float = parameter(unit="1/rad^2", least=-math.inf)
    name = "distortion"
    unit = "px"
    lit_ns = 350  # rays, where no map of a micro-image holds

    def _shift(self, plane: PlaneRegime) -> float:
        """How far the outermost ray moves, rad."""
        return abs(self.coefficient) * plane.field**3

    def size(self, regime: Regime) -> float:
        """How far the outermost place moves."""
        return max(plane.pixels(self._shift(plane)) for plane in regime.planes)

    def bound(self, regime: Regime) -> float:
        """Rays move by c a^3 at the angle a, and by 3 c a^2 of their angle apart from each
        other.
        """
        apart = [
            3 * abs(self.coefficient) * plane.field**2 * plane.bundle for plane in regime.planes
        ]
        return sum(
            plane.moved(self._shift(plane), stretch)
            for plane, stretch in zip(regime.planes, apart, strict=True)
        )

    def why(self, regime: Regime) -> str:
        """Up to which angle."""
        return f"the main lens distorts up to {math.degrees(regime.field):.3g} degrees off the axis"

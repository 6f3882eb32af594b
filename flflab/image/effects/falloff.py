"""Natural fall-off: a ray that meets the sensor at an angle theta from the normal brings
cos^4(theta) of its paraxial light.
"""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Falloff(Effect):
    """It has no number of its own: the angles follow from the camera."""

    name = "falloff"
    unit = "of light"
    lit_ns = 4  # five strips or more, 0.7 ns each, and what they add to others

    def size(self, regime: Regime) -> float:
        """What the ray of the largest slope s loses: 1 - cos^4 = 1 - 1 / (1 + s^2)^2."""
        return 1 - (1 + regime.slope**2) ** -2

    def why(self, regime: Regime) -> str:
        """The steepest ray."""
        return f"rays land up to {math.degrees(math.atan(regime.slope)):.3g} degrees off the normal"

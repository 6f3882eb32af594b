"""Motion during the exposure: the target moves evenly, or trembles, while light is gathered."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import PlaneRegime, Regime


@dataclass(frozen=True)
class Motion(Effect):
    """What every target does during the exposure, across the axis, mm.

    ``drift`` (x, y) is the whole even way, half of it before the middle of the exposure;
    ``vibration`` (x, y) is the amplitude of a sine of many periods.
    """

    drift: tuple[float, float] = parameter((0.0, 0.0), unit="mm", least=-math.inf)
    vibration: tuple[float, float] = parameter((0.0, 0.0), unit="mm", least=-math.inf)
    name = "motion"
    unit = "px"
    lit_ns = 350  # rays, where a target moves by more than an edge's width

    def _way(self, plane: PlaneRegime, drift: float, vibration: float) -> float:
        """So many times the drift and the amplitude, rad."""
        if math.isinf(plane.distance):
            return 0.0
        return (
            drift * math.hypot(*self.drift) + vibration * math.hypot(*self.vibration)
        ) / plane.distance

    def size(self, regime: Regime) -> float:
        """From end to end."""
        return max(plane.pixels(self._way(plane, 1.0, 2.0)) for plane in regime.planes)

    def bound(self, regime: Regime) -> float:
        """A target is off its place by a quarter of the drift and 2 / pi of the amplitude, in the
        mean over the exposure.
        """
        return sum(plane.moved(self._way(plane, 0.25, 2 / math.pi)) for plane in regime.planes)

    def why(self, regime: Regime) -> str:
        """What moves."""
        return (
            f"drift of {math.hypot(*self.drift):.3g} mm, vibration of"
            f" {math.hypot(*self.vibration):.3g} mm"
        )

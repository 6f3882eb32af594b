"""Motion during the exposure: the target moves evenly, or trembles, while light is gathered."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
from flflab.image.regime import PlaneRegime, Regime


@dataclass(frozen=True)
class Motion:
    """What every target does during the exposure, across the axis, mm.

    ``drift`` (x, y) is the whole even way, half of it before the middle of the exposure;
    ``vibration`` (x, y) is the amplitude of a sine of many periods.
    """

    drift: tuple[float, float] = (0.0, 0.0)
    vibration: tuple[float, float] = (0.0, 0.0)
    name: ClassVar[str] = "motion"
    unit: ClassVar[str] = "px"

    def __post_init__(self) -> None:
        """Refuse what is no motion.

        Raises:
            InputError: a length is not finite.
        """
        if not all(math.isfinite(length) for length in (*self.drift, *self.vibration)):
            raise InputError(
                f"motion: drift is {self.drift} mm and vibration {self.vibration} mm; finite"
                " lengths are due"
            )

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

    def cost(self, regime: Regime) -> float:
        """Where a target moves by more than an edge's width, rays: 350 ns a lit pixel."""
        return 3.5e-4 * regime.pixels * regime.lit

    def why(self, regime: Regime) -> str:
        """What moves."""
        return (
            f"drift of {math.hypot(*self.drift):.3g} mm, vibration of"
            f" {math.hypot(*self.vibration):.3g} mm"
        )

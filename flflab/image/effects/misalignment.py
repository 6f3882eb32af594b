"""Misalignment: offset, roll and tilt of the array, offset of the sensor, roll and tilt of a
target.
"""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Misalignment(Effect):
    """Its numbers stand in the camera and in the planes; left out, all of them are 0.

    ``turned`` holds for each plane its roll (rad) and the size of its tilt, ``aperture`` is the
    main lens's (mm).
    """

    turned: tuple[tuple[float, float], ...]
    aperture: float
    name = "misalignment"
    unit = "px"
    lit_ns = 350  # rays, where no map of a micro-image holds

    def _shifts(self, regime: Regime) -> list[float]:
        """How far the rays of each plane move on it, rad.

        A place at r from the target's centre moves by 2 sin(roll / 2) r, comes nearer by tilt r,
        which a ray of slope a + A / (2 D) sees as a step to the side of so many times that, and is
        foreshortened by tilt^2 / 2.
        """
        shifts: list[float] = []
        for plane, (roll, tilt) in zip(regime.planes, self.turned, strict=True):
            slope = plane.field + (
                self.aperture / (2 * plane.distance) if math.isfinite(plane.distance) else 0.0
            )
            nearer = tilt * slope / max(1 - tilt * slope, 1e-3)
            shifts.append(plane.from_centre * (2 * abs(math.sin(roll / 2)) + nearer + tilt**2 / 2))
        return shifts

    def size(self, regime: Regime) -> float:
        """Largest step of the image, of micro-images or of the target within them."""
        steps = [
            plane.pixels(shift)
            for plane, shift in zip(regime.planes, self._shifts(regime), strict=True)
        ]
        return max(regime.misaligned.rim, *steps)

    def bound(self, regime: Regime) -> float:
        """What the steps of rims and rays change; a tilted target's rays move apart as well."""
        planes = zip(regime.planes, self._shifts(regime), strict=True)
        moved = sum(
            plane.moved(shift, min(shift, 3 * plane.bundle * shift / max(plane.field, 1e-12)))
            for plane, shift in planes
        )
        return min(regime.light, regime.changed(regime.misaligned) + moved)

    def why(self, regime: Regime) -> str:
        """What is out of line."""
        camera = regime.misaligned.rim > 0 or regime.misaligned.shift > 0
        parts = ["array or sensor"] * camera + ["target"] * any(map(any, self.turned))
        return f"offset, roll or tilt of {' and '.join(parts)}"

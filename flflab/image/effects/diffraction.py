"""Diffraction: light of one wavelength bends round the edges of the clipped pupil."""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Diffraction(Effect):
    """Light of one ``wavelength``, mm."""

    wavelength: float = parameter(550e-6, unit="mm", above=0)
    name = "diffraction"
    unit = "px"
    lit_ns = 60  # four looks into a table of images a pixel

    def size(self, regime: Regime) -> float:
        """Radius of the Airy disc."""
        return self.wavelength * regime.airy

    def bound(self, regime: Regime) -> float:
        """Half the absolute difference of the two point images, both averaged over the pixel, at
        the radius a of the Airy disc.

        Measured over a from 0.01 to 3 and blurs up to 30 pixels by Hopkins's transfer function: at
        most 0.43 a where all varies along one direction, 0.36 a / sqrt(blur) where it is blurred;
        0.75 a else, 0.45 a from a blur of one pixel on.
        """
        radius = self.size(regime)
        changes: list[float] = []
        for plane in regime.planes:
            root = math.sqrt(max(plane.least_blur, 1e-12))
            most = (
                min(0.43, 0.36 / root) if plane.plain else (0.75 if plane.least_blur < 1 else 0.45)
            )
            changes.append(min(plane.contrast, regime.reaching * most * radius))
        return sum(changes)

    def why(self, regime: Regime) -> str:
        """Against the blur."""
        return f"light of {1e6 * self.wavelength:.0f} nm against a blur of {regime.blur:.3g} px"

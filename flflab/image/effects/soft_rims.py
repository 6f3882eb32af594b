"""Soft rims: the edges of micro-images fade over some pixels, as behind a relay or a coating whose
edge is not sharp; what is seen inside them stays sharp.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime

LEAST = 0.1  # of the brightest: where less light was, what its surroundings see is seen
MEAN_AWAY = math.sqrt(2 / math.pi)  # of a Gaussian's values from its middle, standard deviations


@dataclass(frozen=True)
class SoftRims(Finishing):
    """The rims are blurred by a Gaussian of the standard deviation ``radius``, mm on the sensor."""

    radius: float = parameter(unit="mm")
    name = "soft-rims"
    unit = "px"
    pixel_ns = 220  # a white picture, and two filters of two passes

    def size(self, regime: Regime) -> float:
        """Standard deviation of the blur."""
        return self.radius / regime.pixel

    def bound(self, regime: Regime) -> float:
        """Rims that move by the mean way of the blur, at most all light."""
        return min(regime.brightest, MEAN_AWAY * self.size(regime) * regime.rim_steepness)

    def why(self, regime: Regime) -> str:
        """Against the width that two apertures give them."""
        return f"a blur of {self.size(regime):.3g} px against rims of {regime.rim:.3g} px"

    def apply(self, image: Array, formed: Formed) -> None:
        """What is seen is the picture over the white one; it is dimmed by the blurred white one."""
        edges, radius = formed.white(), self.radius / formed.camera.sensor.pixel
        soft = gaussian_filter(edges, radius, mode="nearest")
        seen = gaussian_filter(image, radius, mode="nearest")
        np.divide(seen, soft, out=seen, where=soft > 0)
        np.divide(image, edges, out=seen, where=edges > LEAST * float(edges.max(initial=0.0)))
        np.multiply(seen, soft, out=image)

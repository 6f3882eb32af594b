"""Shading: the main lens brings less light towards the corners of the sensor."""

from dataclasses import dataclass

import numpy as np

from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Shading(Finishing):
    """Light falls by ``corner``, a share, from the sensor's middle to its corner, with the square
    of the distance.
    """

    corner: float = parameter(most=1)
    name = "shading"
    unit = "of light"
    pixel_ns = 2  # one product a pixel

    def why(self, regime: Regime) -> str:
        """Where the light is lost."""
        return f"the sensor's corners get {100 * self.corner:.3g} % less light"

    def apply(self, image: Array, formed: Formed) -> None:
        """1 - corner (r / R)^2, R the distance from the sensor's middle to the middle of its corner
        pixel.
        """
        rows, columns = (np.arange(count) - (count - 1) / 2 for count in image.shape)
        farthest = max(float(rows[-1] ** 2 + columns[-1] ** 2), 1e-300)
        image *= 1 - self.corner * (rows[:, None] ** 2 + columns[None] ** 2) / farthest

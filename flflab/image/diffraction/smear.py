"""What a target's motion during the exposure leaves of its frequencies, as seen on the sensor: a
transfer function in closed form.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import j0

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Smear:
    """A motion on the sensor, pixels: the whole even ``drift`` and the amplitude of the ``sway``, a
    sine of many periods; (2,) each.
    """

    drift: Array
    sway: Array

    @property
    def extent(self) -> float:
        """How far a place moves from its middle at most, pixels."""
        return float(np.hypot(*self.drift)) / 2 + float(np.hypot(*self.sway))

    def transfer(self, frequency: Array) -> Array:
        """What is left of frequencies (cycles/pixel on the sensor, shape (..., 2)): sinc(f . drift)
        J0(2 pi f . sway).
        """
        return np.sinc(frequency @ self.drift) * j0(2 * np.pi * (frequency @ self.sway))

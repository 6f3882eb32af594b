"""How noisy one pixel of a picture is."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor that counts electrons and adds read noise.

    Attributes:
        dn_per_electron: digital numbers one electron makes (gain), DN.
        read_noise_dn: standard deviation of a dark pixel before quantisation, DN.
        offset_dn: what a pixel without light reads, DN.
        full_scale_dn: the largest value a pixel can read, DN; pixels at or above it count as saturated.
    """

    dn_per_electron: float
    read_noise_dn: float
    offset_dn: float
    full_scale_dn: float

    def __post_init__(self) -> None:
        """Refuse what no sensor has.

        Raises:
            InputError: a number is not finite, gain not above 0, noise below 0, or full scale not above the offset.
        """
        if not all(math.isfinite(value) for value in (self.dn_per_electron, self.read_noise_dn, self.offset_dn, self.full_scale_dn)):
            raise InputError(f"sensor noise: every number must be finite, not {self}")
        if self.dn_per_electron <= 0 or self.read_noise_dn < 0:
            raise InputError(f"sensor noise: dn_per_electron above 0 and read_noise_dn from 0 up are due, not {self}")
        if self.full_scale_dn <= self.offset_dn:
            raise InputError(f"sensor noise: full_scale_dn {self.full_scale_dn:g} must lie above offset_dn {self.offset_dn:g}")

    @property
    def dark_variance(self) -> float:
        """Variance of a dark pixel, DN^2: read noise and the 1/12 of rounding to whole numbers."""
        return self.read_noise_dn**2 + 1 / 12

    def variance(self, dn: npt.ArrayLike) -> Array:
        """Variance in DN^2 of pixels that read ``dn`` on average: shot, read and quantisation noise."""
        light = np.maximum(np.asarray(dn, dtype=np.float64) - self.offset_dn, 0.0)
        return self.dark_variance + light * self.dn_per_electron

    def saturated(self, dn: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which pixels read full scale."""
        return np.greater_equal(np.asarray(dn, dtype=np.float64), self.full_scale_dn)

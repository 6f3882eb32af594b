"""From light to numbers: shot noise, read noise, offset, quantisation and saturation of a sensor."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Array = npt.NDArray[np.float64]

BLOCK_ROWS = 128  # a block of rows stays in the cache from light to numbers


@dataclass(frozen=True)
class SensorResponse:
    """What a sensor makes of electrons.

    Attributes:
        full_well_e: electrons a pixel can hold.
        read_noise_e: standard deviation of the noise of reading, electrons.
        bits: bits of the numbers; the largest is 2^bits - 1.
        dn_per_electron: numbers per electron.
        offset_dn: number of a dark pixel.
    """

    full_well_e: float = 10000.0
    read_noise_e: float = 3.0
    bits: int = 12
    dn_per_electron: float = 0.4
    offset_dn: float = 64.0

    def __post_init__(self) -> None:
        """Refuse what is no sensor.

        Raises:
            InputError: a number is not finite or outside what is allowed.
        """
        for name, value, least in (
            ("full_well_e", self.full_well_e, 1.0),
            ("read_noise_e", self.read_noise_e, 0.0),
            ("offset_dn", self.offset_dn, 0.0),
        ):
            if not (math.isfinite(value) and value >= least):
                raise InputError(f"sensor response: {name} is {value:g}; a finite number from {least:g} up is allowed")
        if not (math.isfinite(self.dn_per_electron) and self.dn_per_electron > 0):
            raise InputError(f"sensor response: dn_per_electron is {self.dn_per_electron:g}; a finite number above 0 is due")
        if not 1 <= self.bits <= 16:
            raise InputError(f"sensor response: bits is {self.bits}; from 1 to 16 are allowed")
        if self.offset_dn >= self.full_scale:
            raise InputError(f"sensor response: offset_dn is {self.offset_dn:g}; below {self.full_scale}, the largest number, is allowed")

    @property
    def full_scale(self) -> int:
        """The largest number."""
        return 2**self.bits - 1

    @property
    def saturation_e(self) -> float:
        """Electrons at which a pixel saturates: the full well or the largest number, whichever comes first."""
        return min(self.full_well_e, (self.full_scale - self.offset_dn) / self.dn_per_electron)


def digitise(
    image: Array,
    electrons_at_white: float,
    response: SensorResponse,
    rng: np.random.Generator,
    *,
    shot_noise: bool = True,
    read_noise: bool = True,
) -> npt.NDArray[np.uint16]:
    """What the sensor reads of an image.

    Args:
        image: irradiance in units of the white level, [row, column].
        electrons_at_white: mean electrons in a pixel at the white level.
        response: the sensor.
        rng: where the noise comes from; the same generator gives the same picture.
        shot_noise: whether electrons come at random (Poisson).
        read_noise: whether reading adds noise (Gaussian).

    Returns:
        Numbers from 0 to ``response.full_scale``, the shape of the image.

    Raises:
        InputError: the image or the exposure is negative or not finite.
    """
    if not (math.isfinite(electrons_at_white) and electrons_at_white >= 0):
        raise InputError(f"digitise: electrons_at_white is {electrons_at_white:g}; a finite number from 0 up is allowed")
    numbers = np.empty(image.shape, dtype=np.uint16)
    for first in range(0, image.shape[0], BLOCK_ROWS):
        rows = slice(first, first + BLOCK_ROWS)
        electrons = image[rows] * electrons_at_white
        if not (electrons.size == 0 or (electrons.min() >= 0 and electrons.max() < 1e15)):
            raise InputError("digitise: the image is negative, not finite, or beyond 1e15 electrons somewhere; light from 0 up is allowed")
        if shot_noise:
            lit = electrons > 0
            electrons[lit] = rng.poisson(electrons[lit])
        np.minimum(electrons, response.full_well_e, out=electrons)
        read = electrons.astype(np.float32)
        if read_noise and response.read_noise_e > 0:
            read += np.float32(response.read_noise_e) * rng.standard_normal(read.shape, dtype=np.float32)
        read *= np.float32(response.dn_per_electron)
        read += np.float32(response.offset_dn)
        np.rint(read, out=read)
        numbers[rows] = np.clip(read, 0, response.full_scale)
    return numbers

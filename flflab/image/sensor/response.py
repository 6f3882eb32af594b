"""From light to numbers: what a sensor reads of an image, with noise row by row and the sensor's
own faults.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.bands import in_bands
from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.fixed_pattern import FixedPattern
from flflab.image.effects.hot_pixels import HotPixels
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.shot_noise import ShotNoise
from flflab.image.sensor.random_numbers import generator, noise_key

Array = npt.NDArray[np.float64]
Numbers = TypeVar("Numbers", np.uint16, np.float64)

MOST_ELECTRONS = 1e12


@dataclass(frozen=True)
class SensorResponse:
    """What a sensor makes of electrons; what is None is ideal.

    Attributes:
        quantisation: the numbers.
        saturation: the full well.
        shot_noise: whether electrons come at random.
        read_noise: the noise of reading.
        dark_current: electrons without light.
        fixed_pattern: gain and offset of every pixel.
        hot_pixels: pixels that gather more electrons in the dark.
        dead_pixels: pixels that are stuck.
    """

    quantisation: Quantisation = field(default_factory=Quantisation)
    saturation: Saturation | None = field(default_factory=Saturation)
    shot_noise: ShotNoise | None = field(default_factory=ShotNoise)
    read_noise: ReadNoise | None = field(default_factory=ReadNoise)
    dark_current: DarkCurrent | None = None
    fixed_pattern: FixedPattern | None = None
    hot_pixels: HotPixels | None = None
    dead_pixels: DeadPixels | None = None

    @property
    def saturation_e(self) -> float:
        """Electrons at which a pixel saturates: the full well or the largest number, whichever
        comes first.
        """
        numbers = self.quantisation
        largest = (numbers.full_scale - numbers.offset_dn) / numbers.dn_per_electron
        return min(self.saturation.full_well, largest) if self.saturation else largest


def digitise(
    image: Array, electrons_at_white: float, response: SensorResponse, key: int
) -> npt.NDArray[np.uint16]:
    """What the sensor reads of an image.

    Args:
        image: irradiance in units of the white level, [row, column].
        electrons_at_white: mean electrons in a pixel at the white level.
        response: the sensor.
        key: names the frame (``noise_key``); the noise of a row depends on it and on the row's
            place and light, and on nothing else.

    Returns:
        Numbers from 0 to full scale, the shape of the image.

    Raises:
        InputError: image or exposure is negative or not finite, or beyond what can be counted.
    """
    return _read_rows(image, electrons_at_white, response, key, np.empty(image.shape, np.uint16))


def read_out(image: Array, electrons_at_white: float, response: SensorResponse, key: int) -> Array:
    """What ``digitise`` makes numbers of: DN before they are rounded and limited to the range of
    the numbers; see there.
    """
    return _read_rows(image, electrons_at_white, response, key, np.empty(image.shape))


def _read_rows(
    image: Array,
    electrons_at_white: float,
    response: SensorResponse,
    key: int,
    out: npt.NDArray[Numbers],
) -> npt.NDArray[Numbers]:
    if not (math.isfinite(electrons_at_white) and electrons_at_white >= 0):
        raise InputError(
            f"digitise: electrons_at_white is {electrons_at_white:g}; a finite number from 0 up is"
            " allowed"
        )
    most = response.quantisation.full_scale

    def read(first: int, last: int) -> Iterator[None]:
        for row in range(first, last):
            signal = _signal(image[row] * electrons_at_white, response, key, row)
            if out.dtype == np.uint16:
                np.clip(np.rint(signal, out=signal), 0, most, out=signal)
            out[row] = signal
            yield

    in_bands(read, len(image))
    return out


def _signal(means: Array, response: SensorResponse, key: int, row: int) -> Array:
    """DN of a row of pixels before rounding, from what light makes of electrons on average."""
    count, offset, hot = len(means), np.zeros(1), response.hot_pixels
    if (pattern := response.fixed_pattern) is not None:
        own = generator(noise_key(pattern.name, pattern.seed), row)
        means = means * (1 + pattern.gain * own.standard_normal(count))
        offset = pattern.offset * own.standard_normal(count)
    if response.dark_current is not None:
        means = means + response.dark_current.electrons
    if hot is not None:
        own = generator(noise_key(hot.name, hot.seed), row)
        means = means + (own.random(count) < hot.share) * own.exponential(hot.electrons, count)
    if count and not (means.min() >= 0 and means.max() < MOST_ELECTRONS):
        raise InputError(
            f"digitise: the image is negative, not finite, or beyond {MOST_ELECTRONS:g} electrons"
            " somewhere; light from 0 up is allowed"
        )
    electrons = means
    if response.shot_noise is not None:
        electrons = generator(key, row).poisson(means).astype(np.float64)
    if response.saturation is not None:
        electrons = np.minimum(electrons, response.saturation.full_well)
    if response.read_noise is not None:
        read = generator(key, row, stream=1).standard_normal(count)
        electrons = electrons + response.read_noise.electrons * read
    numbers = response.quantisation
    signal = (electrons + offset) * numbers.dn_per_electron + numbers.offset_dn
    if (dead := response.dead_pixels) is not None:
        own = generator(noise_key(dead.name, dead.seed), row)
        stuck, full = own.random(count) < dead.share, own.random(count) < 0.5
        signal[stuck] = np.where(full[stuck], numbers.full_scale, 0)
    return signal

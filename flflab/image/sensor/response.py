"""From light to numbers: what a sensor reads of an image, with noise by counter and the sensor's
own faults.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

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
from flflab.image.sensor.draws import draw
from flflab.image.sensor.random_numbers import LONGEST, Key, noise_key

Array = npt.NDArray[np.float64]

BAND_ROWS = 8  # rows worked through together lie in the cache from light to numbers
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
    image: Array,
    electrons_at_white: float,
    response: SensorResponse,
    key: Key,
    *,
    corner: tuple[int, int] = (0, 0),
) -> npt.NDArray[np.uint16]:
    """What the sensor reads of an image.

    Args:
        image: irradiance in units of the white level, [row, column].
        electrons_at_white: mean electrons in a pixel at the white level.
        response: the sensor.
        key: names the frame (``noise_key``); the noise of a pixel depends on it and on the pixel's
            place and mean, and on nothing else.
        corner: (row, column) on the sensor of the image's pixel [0, 0]: a part of a frame reads as
            in the whole frame.

    Returns:
        Numbers from 0 to full scale, the shape of the image.

    Raises:
        InputError: image, exposure or corner is negative or not finite, or beyond what can be
            counted.
    """
    _check(image.shape, electrons_at_white, corner)
    numbers = np.empty(image.shape, dtype=np.uint16)
    most = response.quantisation.full_scale

    def read(first: int, last: int) -> Iterator[None]:
        for rows in _few(first, last):
            signal = _signal(
                image[rows], electrons_at_white, response, key, (corner[0] + rows.start, corner[1])
            )
            numbers[rows] = np.clip(np.rint(signal, out=signal), 0, most, out=signal)
            yield

    in_bands(read, len(image))
    return numbers


def read_out(
    image: Array,
    electrons_at_white: float,
    response: SensorResponse,
    key: Key,
    *,
    corner: tuple[int, int] = (0, 0),
) -> Array:
    """What ``digitise`` makes numbers of: DN before they are rounded and limited to the range of
    the numbers; see there.
    """
    _check(image.shape, electrons_at_white, corner)
    signal = np.empty(image.shape)

    def read(first: int, last: int) -> Iterator[None]:
        for rows in _few(first, last):
            signal[rows] = _signal(
                image[rows], electrons_at_white, response, key, (corner[0] + rows.start, corner[1])
            )
            yield

    in_bands(read, len(image))
    return signal


def _check(shape: tuple[int, ...], electrons_at_white: float, corner: tuple[int, int]) -> None:
    if not (math.isfinite(electrons_at_white) and electrons_at_white >= 0):
        raise InputError(
            f"digitise: electrons_at_white is {electrons_at_white:g}; a finite number from 0 up is"
            " allowed"
        )
    end = (corner[0] + shape[0], corner[1] + shape[1])
    if min(corner) < 0 or max(end) > LONGEST:
        raise InputError(
            f"digitise: rows and columns from {corner} to {end}; 0 to {LONGEST} are allowed"
        )


def _few(first: int, last: int) -> Iterator[slice]:
    """Rows worked through together."""
    for start in range(first, last, BAND_ROWS):
        yield slice(start, min(start + BAND_ROWS, last))


def _signal(
    light: Array,
    electrons_at_white: float,
    response: SensorResponse,
    key: Key,
    corner: tuple[int, int],
) -> Array:
    """DN of some pixels before rounding."""
    means = light * electrons_at_white
    offset = np.zeros(1)
    pattern, dead = response.fixed_pattern, response.dead_pixels
    if pattern is not None and (pattern.gain > 0 or pattern.offset > 0):
        own = draw(light.shape, corner, noise_key(pattern.name, pattern.seed))
        means *= 1 + pattern.gain * own.normal(0)
        offset = pattern.offset * own.normal(1)
    if response.dark_current is not None:
        means += response.dark_current.electrons
    if response.hot_pixels is not None and response.hot_pixels.share > 0:
        hot = response.hot_pixels
        own = draw(light.shape, corner, noise_key(hot.name, hot.seed))
        means += hot.electrons * own.chosen(hot.share) * own.exponential()
    if means.size and not (means.min() >= 0 and means.max() < MOST_ELECTRONS):
        raise InputError(
            f"digitise: the image is negative, not finite, or beyond {MOST_ELECTRONS:g} electrons"
            " somewhere; light from 0 up is allowed"
        )
    drawn = draw(light.shape, corner, key) if response.shot_noise or response.read_noise else None
    electrons = drawn.poisson(means) if drawn is not None and response.shot_noise else means
    if response.saturation is not None:
        np.minimum(electrons, response.saturation.full_well, out=electrons)
    if drawn is not None and response.read_noise:
        electrons += response.read_noise.electrons * drawn.normal(1)
    electrons += offset
    electrons *= response.quantisation.dn_per_electron
    electrons += response.quantisation.offset_dn
    if dead is not None and dead.share > 0:
        own = draw(light.shape, corner, noise_key(dead.name, dead.seed))
        stuck = own.chosen(dead.share)
        electrons[stuck] = np.where(own.coin[stuck], response.quantisation.full_scale, 0)
    return electrons

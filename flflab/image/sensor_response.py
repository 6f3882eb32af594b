"""From light to numbers: what a sensor reads of an image, with noise by counter and the sensor's own faults."""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.effects.dark_current import DarkCurrent
from flflab.image.effects.dead_pixels import DeadPixels
from flflab.image.effects.fixed_pattern import FixedPattern
from flflab.image.effects.quantisation import Quantisation
from flflab.image.effects.read_noise import ReadNoise
from flflab.image.effects.saturation import Saturation
from flflab.image.effects.shot_noise import ShotNoise
from flflab.image.noise_kernel import LONGEST_ROW, MOST_ELECTRONS, read_rows
from flflab.image.random_numbers import Key, noise_key

Array = npt.NDArray[np.float64]

BAND_ROWS = 32


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
        dead_pixels: pixels that are stuck.
    """

    quantisation: Quantisation = field(default_factory=Quantisation)
    saturation: Saturation | None = field(default_factory=Saturation)
    shot_noise: ShotNoise | None = field(default_factory=ShotNoise)
    read_noise: ReadNoise | None = field(default_factory=ReadNoise)
    dark_current: DarkCurrent | None = None
    fixed_pattern: FixedPattern | None = None
    dead_pixels: DeadPixels | None = None

    @property
    def saturation_e(self) -> float:
        """Electrons at which a pixel saturates: the full well or the largest number, whichever comes first."""
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
        key: names the frame (``noise_key``); the noise of a pixel depends on it and on the pixel's place and mean, and on nothing else.
        corner: (row, column) on the sensor of the image's pixel [0, 0]: a part of a frame reads as in the whole frame.

    Returns:
        Numbers from 0 to full scale, the shape of the image.

    Raises:
        InputError: image, exposure or corner is negative or not finite, or beyond what can be counted.
    """
    numbers = np.empty(image.shape, dtype=np.uint16)
    _read(image, electrons_at_white, response, key, corner, numbers, float(response.quantisation.full_scale))
    return numbers


def read_out(
    image: Array,
    electrons_at_white: float,
    response: SensorResponse,
    key: Key,
    *,
    corner: tuple[int, int] = (0, 0),
) -> Array:
    """What ``digitise`` makes numbers of: DN before they are rounded and limited to the range of the numbers; see there."""
    signal = np.empty(image.shape)
    _read(image, electrons_at_white, response, key, corner, signal, 0.0)
    return signal


def _read(
    image: Array,
    electrons_at_white: float,
    response: SensorResponse,
    key: Key,
    corner: tuple[int, int],
    out: npt.NDArray[np.uint16] | Array,
    limit: float,
) -> None:
    if not (math.isfinite(electrons_at_white) and electrons_at_white >= 0):
        raise InputError(f"digitise: electrons_at_white is {electrons_at_white:g}; a finite number from 0 up is allowed")
    rows, columns = image.shape
    if min(corner) < 0 or max(corner[0] + rows, corner[1] + columns) > LONGEST_ROW:
        raise InputError(f"digitise: pixels {corner} to {(corner[0] + rows, corner[1] + columns)}; from 0 to {LONGEST_ROW} are allowed")
    pattern, dead = response.fixed_pattern or FixedPattern(), response.dead_pixels or DeadPixels(0.0)
    numbers = response.quantisation
    keys = key, noise_key(pattern.name, pattern.seed), noise_key(dead.name, dead.seed)

    def read(first: int) -> bool:
        band = np.empty((min(BAND_ROWS, rows - first), columns))
        counted = read_rows(
            image,
            first,
            corner,
            keys,
            electrons_at_white,
            response.dark_current.electrons if response.dark_current else 0.0,
            response.shot_noise is not None,
            (pattern.gain, pattern.offset),
            response.saturation.full_well if response.saturation else math.inf,
            response.read_noise.electrons if response.read_noise else 0.0,
            (numbers.dn_per_electron, numbers.offset_dn, float(numbers.full_scale)),
            dead.share,
            limit,
            band,
        )
        if counted:
            out[first : first + BAND_ROWS] = band
        return counted

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        if not all(list(pool.map(read, range(0, rows, BAND_ROWS)))):
            most = f"{MOST_ELECTRONS:g}"
            raise InputError(
                f"digitise: the image is negative, not finite, or beyond {most} electrons somewhere; light from 0 up is allowed"
            )

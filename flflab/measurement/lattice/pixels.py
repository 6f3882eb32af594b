"""The pixels that micro-images are fitted to, in bands on all cores."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Pixels:
    """The picture that micro-images are fitted to.

    Attributes:
        picture: DN, [row, col].
        noise: of the sensor.
        misfit: share of a micro-image's light by which pixels depart from the profile.
        every: of how many rows and columns one is looked at.
    """

    picture: npt.NDArray[np.float32]
    noise: SensorNoise
    misfit: float
    every: int

    @property
    def numbers(self) -> Array:
        """As the kernels take them."""
        one = self.noise
        full = float(one.saturated_dn)
        return np.array([one.dark_variance, one.dn_per_electron, full, one.offset_dn, self.misfit])


def in_bands(work: Callable[..., Any], members: Whole) -> list[Any]:
    """Results of the bands of the members, in their order, on all cores."""
    threads = numba.get_num_threads()
    bands = [band for band in np.array_split(members, 4 * threads) if len(band)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, bands))


def finer(pixels: Pixels, misfit: float, every: int) -> Pixels:
    """The same picture looked at more closely."""
    return replace(pixels, misfit=misfit, every=every)

"""At which number a picture is saturated where nothing says so: pixels pile up at the top number.

Light above full scale reads one number in all pixels of a patch, where noise would scatter them.
Patches of one number say nothing in a picture without noise, and where the noise is below the
rounding.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

FEWEST = 20  # pixels at the top number
HOT = 1e-3  # of the pixels: those above the top number of all others
# of the pixels at the top number, those whose right or lower neighbour is there too: of the tail of
# noise it is a few in a thousand, half where all light is above full scale
TOGETHER = 0.1
LEAST_NOISE = 0.6  # steps: with less, many pixels of one brightness read the same number
CUBIC = np.array([1.0, -3.0, 3.0, -1.0])
LEAST_SHARE = 5e-4  # of the light: no sensor has less noise in a single picture


def saturation_level(picture: npt.NDArray[np.generic]) -> float | None:
    """The number that saturated pixels read; None where none are, or it cannot be told.

    Args:
        picture: numbers as stored, of one filter where there are several, shape (rows, columns).
    """
    values = np.asarray(picture)
    if min(values.shape) < 4 or (level := _top_number(values)) is None:
        return None
    full = values == level
    count = int(np.count_nonzero(full))
    if count == values.size:
        return None
    right = np.count_nonzero(full[:, 1:] & full[:, :-1])
    below = np.count_nonzero(full[1:] & full[:-1])
    if (right + below) / 2 < TOGETHER * count:
        return None
    return float(level) if _noisy(np.minimum(values, level)) else None


def _top_number(values: npt.NDArray[Any]) -> Any:
    """The largest number that many pixels read, hot pixels above it left out; None where none
    does.
    """
    tail = np.sort(values[values >= np.quantile(values, 1 - HOT, method="lower")])
    numbers, counts = np.unique(tail, return_counts=True)
    above = counts.sum() - np.cumsum(counts)
    piled = numbers[(counts >= FEWEST) & (above <= HOT * values.size)]
    return piled[-1] if len(piled) else None


def common_step(values: npt.NDArray[np.generic]) -> int:
    """The largest whole number of which all numbers of a picture of whole ones are multiples."""
    few = int(np.gcd.reduce(values[::7, ::7].ravel().astype(np.int64)))
    return few if few == 1 else int(np.gcd.reduce(values.ravel().astype(np.int64))) or 1


def _noisy(values: npt.NDArray[np.generic]) -> bool:
    """Whether pixels of one brightness below the top would read different numbers.

    Third differences along rows and columns together leave next to nothing of rims that hold the
    four by four pixels they are taken over; sharper rims hold none.
    """
    numbers = values.astype(np.float64)
    if values.dtype.kind in "ui":
        numbers /= common_step(values)
    largest = numbers.max()
    windows = np.lib.stride_tricks.sliding_window_view(numbers, (4, 4))[::2, ::2]
    below = windows.max(axis=(2, 3)) < largest
    rough = np.abs(np.einsum("ijkl,k,l->ij", windows, CUBIC, CUBIC))
    light = largest - float(np.quantile(numbers, 0.01))
    lit = below & (windows.mean(axis=(2, 3)) > largest - light / 2)
    if np.count_nonzero(lit) < FEWEST:
        return False
    sigma = float(np.median(rough[lit])) / (float(ndtri(0.75)) * float(CUBIC @ CUBIC))
    whole = values.dtype.kind in "ui"
    return sigma**2 >= (LEAST_SHARE * light) ** 2 + (LEAST_NOISE**2 + 1 / 12) * whole

"""A picture divided by its white picture, smoothed, with the variance that the noise of both leaves
in each pixel.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation, gaussian_filter, laplace

from flflab.depth_map.geometry import SMOOTHING_PX
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.float32]

LEFT_OF_NOISE = 0.17  # share of a pixel's variance that the smoothing leaves
EVENED_PX = 1.5
TINY = 1e-12  # variance of a picture without noise
LEAST_LIGHT = 0.1  # of the white picture's bright level


@dataclass(frozen=True)
class Normalised:
    """The target's radiance as every pixel sees it, in units of the white target's.

    Attributes:
        value: smoothed, shape (rows, columns).
        curvature: its second derivatives along x and y together, a px^2.
        weight: inverse variance of ``value``; 0 where a pixel is not used.
    """

    value: Pixels
    curvature: Pixels
    weight: Pixels


def normalise(
    raw: Array, raw_noise: SensorNoise, white: Array, white_noise: SensorNoise
) -> Normalised:
    """Divide by the white picture.

    The variance of N = raw/white is (var(raw) + N^2 var(white))/white^2. Saturated and dark pixels
    are not used, nor are their neighbours.

    Args:
        raw: DN, [row, col].
        raw_noise: of its pixels; also says what a pixel without light reads.
        white: DN, the same shape.
        white_noise: of its pixels.
    """
    lit = white - white_noise.offset_dn
    bright = float(np.quantile(lit, 0.98))
    good = (lit > LEAST_LIGHT * bright) & ~white_noise.saturated(white) & ~raw_noise.saturated(raw)
    safe = np.where(good, lit, 1.0)
    value = np.where(good, (raw - raw_noise.offset_dn) / safe, 0.0)
    variance = (raw_noise.variance(raw) + value**2 * white_noise.variance(white)) / safe**2
    share = gaussian_filter(good.astype(np.float32), SMOOTHING_PX)
    smooth = gaussian_filter(value.astype(np.float32), SMOOTHING_PX)
    used = ~np.asarray(binary_dilation(~good, np.ones((3, 3))), dtype=np.bool_)
    even = _mean_of(np.where(good, variance, 0.0), good)
    weight = np.where(used, 1 / (LEFT_OF_NOISE * even), 0.0)
    even_value = np.asarray(smooth / np.maximum(share, 1e-3), dtype=np.float32)
    return Normalised(
        even_value, np.asarray(laplace(even_value), dtype=np.float32), weight.astype(np.float32)
    )


def _mean_of(values: Array, good: npt.NDArray[np.bool_]) -> Array:
    """Mean of the good pixels round each: a pixel's own variance would weigh dark noise more."""
    share = gaussian_filter(good.astype(np.float64), EVENED_PX)
    return gaussian_filter(values, EVENED_PX) / np.maximum(share, 1e-3) + TINY

"""How noisy frames are, from two of the same scene: fixed pattern, shading and detail leave their
difference alone (EMVA 1288, temporal noise).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]

FEWEST = 1000  # pixels that tell a variance to 4 %


@dataclass(frozen=True)
class NoiseRatio:
    """Standard deviation of a pixel from frame to frame over what the camera states.

    Attributes:
        ratio: 1 where the camera is as noisy as stated.
        uncertainty: standard, from the number of pixels.
    """

    ratio: float
    uncertainty: float


def noise_of_pair(first: Array, second: Array, noise: SensorNoise) -> NoiseRatio | None:
    """The noise of two frames of the same scene, each in its own light.

    Saturated pixels and those cut at zero are left out.

    Args:
        first: DN, [row, col].
        second: the same scene, taken after it.
        noise: of one frame, as stated.

    Returns:
        None where fewer than ``FEWEST`` pixels tell it.
    """
    seen = ~(noise.saturated(first) | noise.saturated(second)) & (first > 0) & (second > 0)
    if np.count_nonzero(seen) < FEWEST:
        return None
    one, other = first[seen] - noise.offset_dn, second[seen] - noise.offset_dn
    lamp = float(other.mean() / one.mean()) if one.mean() > noise.read_noise_dn else 1.0
    light = (one + other) / (1 + lamp)
    stated = (1 + lamp**2) * noise.dark_variance
    stated = stated + (lamp + lamp**2) * noise.dn_per_electron * light
    # sums, to which the noise of ``light`` adds nothing on average
    total = float(np.sum(stated))
    ratio = math.sqrt(float(np.sum((other - lamp * one) ** 2)) / total)
    share = math.sqrt(2 * float(np.sum(stated**2))) / total
    return NoiseRatio(ratio, ratio * share / 2)

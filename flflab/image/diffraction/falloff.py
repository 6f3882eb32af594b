"""Natural fall-off behind a clipped pupil: the mean of cos^4 of the slopes of its rays at the
sensor, from the pupil's moments.

Diffracted light is weighted by this mean, and looks towards the middle of the weighted pupil: with
a blur, light that is weaker on one side of the pupil comes from farther to the other. What the
weight changes of the pattern's shape is left out; ``shading`` tells where that matters.
"""

import math
from functools import lru_cache

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.table import rim_radii
from flflab.image.geometry.setup import Setup

Array = npt.NDArray[np.float64]

ROWS = 2000


def slant_rows(setup: Setup, kind: Kind) -> Array:
    """Slope at the centre (x, y), its change per pixel on the sensor and per unit of pupil along e;
    zeros without fall-off; (N, 4).
    """
    pupils, pixel = setup.pupils, setup.sensor.pixel
    turned = np.where(pupils.slope < 0, -pupils.slant_spread, pupils.slant_spread)
    rows = np.column_stack([pupils.slant_x, pupils.slant_y, pupils.slant_scale * pixel, turned])[
        kind.entries
    ]
    return rows if setup.falloff else np.zeros_like(rows)


@lru_cache(maxsize=256)
def pupil_moments(slope: float, reach: float, count: int) -> Array:
    """Means of t, t^2 and u^2 over pupils clipped at so many ``rim_radii``, or over a whole one; t
    along e, u across; shape (R, 3).
    """
    inner = max(0.0, reach - slope)
    distances = rim_radii(slope, reach, count) if count > 1 else np.zeros(1)
    low = np.full(len(distances), -1.0)
    clipped = distances > inner
    low[clipped] = np.clip((distances[clipped] - reach) / slope, -1.0, 1.0)
    t = low[:, None] + (1 - low[:, None]) * (np.arange(ROWS) + 0.5) / ROWS
    squared = 1 - t**2  # half the chord at t
    beside = (reach**2 - (t[clipped] * slope - distances[clipped, None]) ** 2) / max(
        slope, 1e-300
    ) ** 2
    squared[clipped] = np.clip(np.minimum(squared[clipped], beside), 0.0, None)
    half = np.sqrt(squared)
    area = np.maximum(half.sum(axis=1), 1e-300)
    first, second, across = (
        (half * t).sum(axis=1),
        (half * t**2).sum(axis=1),
        (half * squared).sum(axis=1) / 3,
    )
    return np.stack([first, second, across], axis=1) / area[:, None]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_falloff(
    x: float, y: float, rim: Array, slant: Array, moments: Array
) -> tuple[float, float, float]:
    """Mean of cos^4 = (1 + slope^2)^-2 over the pupil of a sensor point (x, y), pixels from the
    micro-image's centre.

    With q the squared slope: (1 + mean q)^-2 + 3 (1 + mean q)^-4 variance of q, exact to the third
    power of q's spread. The middle of the pupil so weighted lies aside by the variance of t times
    the gradient of the weight's logarithm, -4 spread slope / (1 + mean q).

    Args:
        x: sensor point.
        y: the same.
        rim: inner edge, slope, reach and outer edge of a micro-image, pixels.
        slant: one of ``slant_rows``.
        moments: see ``pupil_moments``, at nodes as a cosine from inner to outer edge.

    Returns:
        The mean; how far aside along x and y the pupil's middle lies, of its radius.
    """
    distance = math.sqrt(x * x + y * y)
    first, second, across = moments[0, 0], moments[0, 1], moments[0, 2]
    if distance > rim[0] and moments.shape[0] > 1:
        radial = (
            math.acos(min(max(1.0 - (distance - rim[0]) / rim[1], -1.0), 1.0))
            / math.pi
            * (moments.shape[0] - 1)
        )
        base = min(int(radial), moments.shape[0] - 2)
        part = radial - base
        first = (1.0 - part) * moments[base, 0] + part * moments[base + 1, 0]
        second = (1.0 - part) * moments[base, 1] + part * moments[base + 1, 1]
        across = (1.0 - part) * moments[base, 2] + part * moments[base + 1, 2]
    slope_x, slope_y = slant[0] + slant[2] * x, slant[1] + slant[2] * y
    cos, sin = (x / distance, y / distance) if distance > 1e-9 else (1.0, 0.0)
    along, aside = slope_x * cos + slope_y * sin, slope_y * cos - slope_x * sin
    spread = slant[3]
    mean = (
        slope_x * slope_x
        + slope_y * slope_y
        + 2.0 * spread * along * first
        + spread * spread * (second + across)
    )
    variance = (
        4.0 * spread * spread * (along * along * (second - first * first) + aside * aside * across)
        + spread**4 / 12.0
    )
    weaker = -4.0 * spread / (1.0 + mean)
    ahead, beside = (
        weaker * (along + spread * first) * (second - first * first),
        weaker * aside * across,
    )
    return (
        (1.0 + mean) ** -2 + 3.0 * (1.0 + mean) ** -4 * variance,
        ahead * cos - beside * sin,
        ahead * sin + beside * cos,
    )

"""Natural fall-off where blur does not matter: the mean of cos^4 of the slopes of a sensor point's rays, as a table."""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.clipping import clip, lens_span
from flflab.optics.discs import lens_chord

Array = npt.NDArray[np.float64]

GAUSS = ((-math.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (math.sqrt(0.6), 5 / 18))  # on a chord from -1 to 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_weight(
    x: float,
    y: float,
    radius: float,
    low: float,
    high: float,
    strips: Array,
    count: int,
    slant: tuple[float, float, float],
) -> float:
    """Mean of cos^4 of the slope at the sensor over the pupil from ``low`` to ``high`` inside the disc at (x, y).

    ``slant`` is the slope of the ray through the pupil's centre along the strips and across them, and its change over the radius.
    """
    light, area = 0.0, 0.0
    for strip in range(count):
        at = 0.5 * (low + high) + 0.5 * (high - low) * strips[0, strip]
        start, end = lens_chord(x, y, radius, at)
        if end <= start:
            continue
        weight = strips[1, strip] * (end - start)
        across = slant[1] + slant[2] * at
        area += weight
        for node, share in GAUSS:
            along = slant[0] + 0.5 * slant[2] * ((end + start) + (end - start) * node)
            light += weight * share / (1.0 + along * along + across * across) ** 2
    return light / area if area > 0.0 else 1.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_weights(
    left: float,
    bottom: float,
    step: float,
    weights: Array,
    slope: float,
    reach: float,
    slants: Array,
    strips: Array,
    count: int,
) -> None:
    """The same at sensor points ``step`` mm apart from (left, bottom) on, into ``weights`` [row, column]."""
    radius = reach / abs(slope) if slope != 0.0 else 2.0
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            ex, ey = left + column * step, bottom + row * step
            x, y = clip(ex, ey, 1.0, 0.0, slope, reach)
            low, high = lens_span(x, y, radius)
            slant = (slants[0] + slants[2] * ex, slants[1] + slants[2] * ey, slants[3])
            weights[row, column] = mean_weight(x, y, radius, low, high, strips, count, slant)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_between(column: float, row: float, weights: Array) -> float:
    """A table [row, column] between its places."""
    i, j = int(column), int(row)
    u, v = column - i, row - j
    low = (1.0 - u) * weights[j, i] + u * weights[j, i + 1]
    return (1.0 - v) * low + v * ((1.0 - u) * weights[j + 1, i] + u * weights[j + 1, i + 1])

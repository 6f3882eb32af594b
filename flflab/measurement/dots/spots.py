"""The light of each spot: its centroid and sum within a window, the background beside it taken off.

No shape is fitted and nothing is divided by the white picture: the model says where the centroid of
a cut, defocused or shaded spot lies.
"""

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

BESIDE_PX = 3.0  # of darkness in the window, beside a spot
RING_PX = 4.0  # width of the ring round the window that shows the background
FEWEST = 12  # of its pixels
CLEAR = 5.0  # standard deviations of noise, by which a spot's light stands out
# of a spot's pixels: up to so many are taken for as bright as those beside them; where there are
# more, the spot is clipped, and its centroid less sure by a share of its blur, and px
MOST_SATURATED, CLIPPED, CLIPPED_PX = 0.1, 0.2, 0.02
MOST_BESIDE = 12  # of 25 pixels, not saturated, that do not stand for a saturated one
MOST_SHARED = 0.05  # of a spot's area, that others may reach into


@dataclass(frozen=True)
class Spots:
    """Spots as they were measured, one entry each.

    Attributes:
        centroids: of their light, px, shape (n, 2).
        light: sum of their light, DN.
        variance: of the centroid's x and y by noise, px^2, shape (n, 2).
        light_variance: of the light by noise, DN^2.
        saturated: pixels that were saturated.
        whole: the spot lies on the sensor and is not shared with another, and its light stands out
            of the noise.
    """

    centroids: Array
    light: Array
    variance: Array
    light_variance: Array
    saturated: Whole
    whole: Flags


def measure_spots(
    values: npt.NDArray[Any],
    places: Array,
    centres: Array,
    radii: tuple[float, float, float],
    blur: float,
    noise: SensorNoise,
) -> Spots:
    """Measure spots round where they are due.

    Args:
        values: DN, [row, col].
        places: where each is due, px, shape (n, 2).
        centres: of their micro-images, px, shape (n, 2).
        radii: of micro-images, of spots with their blur, and of the light that counts, px.
        blur: diameter of a spot's blur, px.
        noise: of the sensor.
    """
    far = radii[2]
    pairs = KDTree(places).query_pairs(2 * far + RING_PX, output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    first = np.searchsorted(pairs[:, 0], np.arange(len(places) + 1))
    others = np.ascontiguousarray(pairs[:, 1])
    spots, squares = np.concatenate([places, centres], axis=1), np.square(radii)
    full = noise.full_scale_dn
    pixels, sums = _summed(values, full, spots, squares, first, others)
    area, alone, saturated, beside, ring = pixels.T
    dark = ring / np.maximum(beside, 1)
    enough = beside >= FEWEST
    dark = np.where(enough, dark, np.median(dark[enough]) if enough.any() else noise.offset_dn)
    gain, floor = noise.dn_per_electron, noise.variance(dark)
    of_dark = floor / np.maximum(beside, FEWEST)
    light = sums[:, 1] - dark[:, None] * sums[:, 0]
    count, total = sums[:, 0, 0], light[:, 0]
    some = np.where(total > 0, total, np.inf)
    shift = light[:, 1:3] / some[:, None]

    def about(moments: Array) -> Array:
        """Second moments about the centroid."""
        return moments[:, 3:] - 2 * shift * moments[:, 1:3] + shift**2 * moments[:, :1]

    variance = gain * np.maximum(about(light), 0) + floor[:, None] * about(sums[:, 0])
    variance += of_dark[:, None] * (sums[:, 0, 1:3] - shift * count[:, None]) ** 2
    variance /= (some**2)[:, None]
    variance[saturated > MOST_SATURATED * area] += (CLIPPED * blur + CLIPPED_PX) ** 2
    light_variance = gain * np.maximum(total, 0) + floor * count + of_dark * count**2
    whole = alone >= (1 - MOST_SHARED) * np.maximum(area, 1)
    whole &= total > CLEAR * np.sqrt(light_variance)
    return Spots(places + shift, total, variance, light_variance, saturated.astype(int), whole)


@numba.njit(cache=True, error_model="numpy")
def _summed(
    values: npt.NDArray[Any],
    full: float,
    spots: Array,
    squares: Array,
    first: Whole,
    others: Whole,
) -> tuple[Array, Array]:
    """Sums over the pixels of each spot; a pixel that two claim is the nearer one's.

    Args:
        values: DN, [row, col].
        full: what a saturated pixel reads, DN.
        spots: place and centre of the micro-image of each, px, shape (n, 4).
        squares: of the radii of micro-images, of spots, and of the light that counts, px^2.
        first: where the neighbours of each begin in ``others``, shape (n + 1,).
        others: their numbers.

    Returns:
        Pixels of the spot, those it covers alone, saturated ones, those of the ring and their sum,
        DN, shape (n, 5); over the pixels that count, of 1 and of light: sum, first moments along x
        and y from the place, and second ones, shape (n, 2, 5).
    """
    pixels, sums = np.zeros((len(spots), 5)), np.zeros((len(spots), 2, 5))
    rim, reach, far = squares
    ring = (math.sqrt(far) + RING_PX) ** 2
    half = math.ceil(math.sqrt(ring))
    rows, columns = values.shape
    for n in range(len(spots)):
        x, y, centre_x, centre_y = spots[n]
        for row in range(round(y) - half, round(y) + half + 1):
            for column in range(round(x) - half, round(x) + half + 1):
                d_x, d_y = column - x, row - y
                near = d_x * d_x + d_y * d_y
                lit = (column - centre_x) ** 2 + (row - centre_y) ** 2 <= rim
                if near > ring or (near <= far and not lit):
                    continue
                pixels[n, 0] += near <= reach
                if row < 0 or column < 0 or row >= rows or column >= columns:
                    continue
                theirs = np.inf
                for m in range(first[n], first[n + 1]):
                    at_x, at_y, in_x, in_y = spots[others[m]]
                    if (column - in_x) ** 2 + (row - in_y) ** 2 <= rim:
                        theirs = min(theirs, (column - at_x) ** 2 + (row - at_y) ** 2)
                light = float(values[row, column])
                saturated = light >= full
                if saturated:
                    light = _beside(values, row, column, full)
                if near <= far:
                    pixels[n, 1] += near <= reach and theirs > reach
                    if theirs > far or near <= theirs:
                        pixels[n, 2] += saturated
                        for k, term in enumerate((1.0, d_x, d_y, d_x * d_x, d_y * d_y)):
                            sums[n, 0, k] += term
                            sums[n, 1, k] += light * term
                elif theirs > far:
                    pixels[n, 3] += 1
                    pixels[n, 4] += light
    return pixels, sums


@numba.njit(cache=True, error_model="numpy")
def _beside(values: npt.NDArray[Any], row: int, column: int, full: float) -> float:
    """Mean of those of 5 x 5 pixels that are not saturated; full scale where most are."""
    count, total = 0, 0.0
    for i in range(max(row - 2, 0), min(row + 3, values.shape[0])):
        for j in range(max(column - 2, 0), min(column + 3, values.shape[1])):
            if values[i, j] < full:
                count += 1
                total += values[i, j]
    return total / count if count > MOST_BESIDE else full

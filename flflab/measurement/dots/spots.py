"""The light of each spot: its centroid and sum within a window, the background beside it taken off.

No shape is fitted and nothing is divided by the white picture: the model says where the centroid of
a cut, defocused or shaded spot lies.
"""

import math
from dataclasses import dataclass
from typing import Any

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
# of a spot's pixels: up to so many are taken for as bright as those beside them; where there are
# more, the spot is clipped, and its centroid less sure by a share of its blur, and px
MOST_SATURATED, CLIPPED, CLIPPED_PX = 0.1, 0.2, 0.02
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
    reach: float,
    blur: float,
    centres: Array,
    rim: float,
    search: float,
    noise: SensorNoise,
) -> Spots:
    """Measure spots round where they are due.

    Args:
        values: DN, [row, col].
        places: where they are due, px, shape (n, 2).
        reach: radius of each with its blur, px.
        blur: its diameter, px.
        centres: of their micro-images, px, shape (n, 2).
        rim: radius of these, px.
        search: px, by which they may lie elsewhere.
        noise: of the sensor.
    """
    if len(places) == 0:
        none = np.zeros(0)
        return Spots(places, none, places, none, none.astype(np.int64), none.astype(np.bool_))
    far = reach + search + BESIDE_PX
    half = math.ceil(far + RING_PX)
    window = np.arange(-half, half + 1)
    middle = np.rint(places).astype(np.int64)
    rows, columns = middle[:, 1, None] + window, middle[:, 0, None] + window
    seen = _within(rows, values.shape[0])[:, :, None] & _within(columns, values.shape[1])[:, None]
    at = (
        np.clip(rows, 0, values.shape[0] - 1)[:, :, None],
        np.clip(columns, 0, values.shape[1] - 1)[:, None],
    )
    light = values[at].astype(np.float32)
    x, y = columns.astype(np.float32)[:, None], rows.astype(np.float32)[:, :, None]

    def within(points: Array, radius: float) -> Flags:
        at_x, at_y = points.T.astype(np.float32)[:, :, None, None]
        return (x - at_x) ** 2 + (y - at_y) ** 2 <= np.float32(radius * radius)

    lit = within(centres, rim)
    own, spot = within(places, far), within(places, reach) & lit
    ring = ~own & within(places, far + RING_PX) & seen
    own &= lit
    area, alone = spot.sum(axis=(1, 2)), spot & seen
    pairs = np.array(sorted(KDTree(places).query_pairs(2 * far + RING_PX)), dtype=np.int64)
    for n, k in [*pairs, *pairs[:, ::-1]] if len(pairs) else []:
        dx, dy = x[n] - places[k, 0], y[n] - places[k, 1]
        away = dx * dx + dy * dy
        theirs = (away <= far * far) & (
            (x[n] - centres[k, 0]) ** 2 + (y[n] - centres[k, 1]) ** 2 <= rim * rim
        )
        ring[n] &= ~theirs
        alone[n] &= ~theirs | (away > reach * reach)
        nearer = (x[n] - places[n, 0]) ** 2 + (y[n] - places[n, 1]) ** 2 <= away
        own[n] &= ~theirs | nearer
    own &= seen
    full = own & (light >= noise.full_scale_dn)
    ring &= light < noise.full_scale_dn
    beside = ring.sum(axis=(1, 2))
    dark = np.where(ring, light, np.float32(0)).sum(axis=(1, 2), dtype=np.float64)
    dark /= np.maximum(beside, 1)
    enough = beside >= FEWEST
    dark = np.where(enough, dark, np.median(dark[enough]) if enough.any() else noise.offset_dn)
    spread = np.where(own, noise.variance(light).astype(np.float32), np.float32(0))
    saturated = full.sum(axis=(1, 2))
    clipped = saturated > MOST_SATURATED * area
    for n in np.flatnonzero((saturated > 0) & ~clipped):
        light[n] = _filled(light[n], full[n], spot[n])
    light = np.where(own, light - dark[:, None, None].astype(np.float32), np.float32(0))
    total = light.sum(axis=(1, 2), dtype=np.float64)
    some = np.where(total > 0, total, np.inf)
    dark_variance = noise.variance(dark) / np.maximum(beside, FEWEST)
    centroids, variance = places.copy(), np.zeros_like(places)
    for axis, place in enumerate((x, y)):
        away = place - places[:, axis, None, None].astype(np.float32)
        shift = (light * away).sum(axis=(1, 2), dtype=np.float64) / some
        lever = np.where(own, away - shift[:, None, None].astype(np.float32), 0)
        centroids[:, axis] += shift
        variance[:, axis] = (spread * lever * lever).sum(axis=(1, 2))
        variance[:, axis] += dark_variance * lever.sum(axis=(1, 2), dtype=np.float64) ** 2
    variance /= (some**2)[:, None]
    variance[clipped] += (CLIPPED * blur + CLIPPED_PX) ** 2
    light_variance = spread.sum(axis=(1, 2)) + dark_variance * own.sum(axis=(1, 2)) ** 2.0
    whole = alone.sum(axis=(1, 2)) >= (1 - MOST_SHARED) * np.maximum(area, 1)
    whole &= total > 5 * np.sqrt(light_variance)
    return Spots(centroids, total, variance, light_variance, saturated, whole)


def _within(places: Whole, size: int) -> Flags:
    return (places >= 0) & (places < size)


def _filled(light: npt.NDArray[np.float32], full: Flags, spot: Flags) -> npt.NDArray[np.float32]:
    """A window with its saturated pixels as bright as those near them in the spot, or beside it."""
    filled = light.copy()
    good = ~full
    for row, column in np.argwhere(full):
        near = np.s_[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        alike = good[near] & (spot[near] == spot[row, column])
        if alike.any():
            filled[row, column] = np.median(light[near][alike])
    return filled

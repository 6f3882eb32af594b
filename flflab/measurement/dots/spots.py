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
CLEAR = 5.0  # standard deviations of noise, by which a spot's light stands out
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


@dataclass(frozen=True)
class Due:
    """Where spots are due, px.

    Attributes:
        places: of each, shape (n, 2).
        centres: of their micro-images, shape (n, 2).
        rim: radius of these.
        reach: radius of a spot with its blur.
        blur: its diameter.
        search: by how much spots may lie elsewhere.
    """

    places: Array
    centres: Array
    rim: float
    reach: float
    blur: float
    search: float

    @property
    def far(self) -> float:
        """Radius of the light that counts."""
        return self.reach + self.search + BESIDE_PX


@dataclass(frozen=True)
class _Windows:
    """Pixels round each spot, shape (n, size, size): their light and places, which count, which the
    spot covers, which it covers alone, and which are background.
    """

    light: npt.NDArray[np.float32]
    x: npt.NDArray[np.float32]
    y: npt.NDArray[np.float32]
    own: Flags
    spot: Flags
    alone: Flags
    ring: Flags


def measure_spots(values: npt.NDArray[Any], due: Due, noise: SensorNoise) -> Spots:
    """Measure spots round where they are due.

    Args:
        values: DN, [row, col].
        due: the spots.
        noise: of the sensor.
    """
    if len(due.places) == 0:
        none = np.zeros(0)
        no = none.astype(np.bool_)
        return Spots(due.places, none, due.places, none, none.astype(np.int64), no)
    seen = _windows(values, due)
    own, area = seen.own, seen.spot.sum(axis=(1, 2))
    full = own & (seen.light >= noise.full_scale_dn)
    saturated = full.sum(axis=(1, 2))
    clipped = saturated > MOST_SATURATED * area
    dark, dark_variance = _background(seen, noise)
    spread = np.where(own, noise.variance(seen.light).astype(np.float32), np.float32(0))
    read = seen.light.copy()
    for n in np.flatnonzero((saturated > 0) & ~clipped):
        read[n] = _filled(read[n], full[n], seen.spot[n])
    light = np.where(own, read - dark[:, None, None].astype(np.float32), np.float32(0))
    total = light.sum(axis=(1, 2), dtype=np.float64)
    some = np.where(total > 0, total, np.inf)
    centroids, variance = due.places.copy(), np.zeros_like(due.places)
    for axis, place in enumerate((seen.x, seen.y)):
        away = place - due.places[:, axis, None, None].astype(np.float32)
        shift = (light * away).sum(axis=(1, 2), dtype=np.float64) / some
        lever = np.where(own, away - shift[:, None, None].astype(np.float32), 0)
        centroids[:, axis] += shift
        variance[:, axis] = (spread * lever * lever).sum(axis=(1, 2))
        variance[:, axis] += dark_variance * lever.sum(axis=(1, 2), dtype=np.float64) ** 2
    variance /= (some**2)[:, None]
    variance[clipped] += (CLIPPED * due.blur + CLIPPED_PX) ** 2
    light_variance = spread.sum(axis=(1, 2)) + dark_variance * own.sum(axis=(1, 2)) ** 2.0
    whole = seen.alone.sum(axis=(1, 2)) >= (1 - MOST_SHARED) * np.maximum(area, 1)
    whole &= total > CLEAR * np.sqrt(light_variance)
    return Spots(centroids, total, variance, light_variance, saturated, whole)


def _windows(values: npt.NDArray[Any], due: Due) -> _Windows:
    """What is read round each spot; a pixel that two claim is the nearer one's."""
    places, centres, far = due.places, due.centres, due.far
    half = math.ceil(far + RING_PX)
    window = np.arange(-half, half + 1)
    middle = np.rint(places).astype(np.int64)
    rows, columns = middle[:, 1, None] + window, middle[:, 0, None] + window
    seen = _within(rows, values.shape[0])[:, :, None] & _within(columns, values.shape[1])[:, None]
    at = (
        np.clip(rows, 0, values.shape[0] - 1)[:, :, None],
        np.clip(columns, 0, values.shape[1] - 1)[:, None],
    )
    x, y = columns.astype(np.float32)[:, None], rows.astype(np.float32)[:, :, None]

    def away(points: Array, which: slice | int = slice(None)) -> npt.NDArray[np.float32]:
        at_x, at_y = np.moveaxis(points.astype(np.float32)[..., None, None], -3, 0)
        return (x[which] - at_x) ** 2 + (y[which] - at_y) ** 2

    lit, near = away(centres) <= due.rim**2, away(places)
    spot, own = (near <= due.reach**2) & lit, (near <= far**2) & lit & seen
    ring = (near > far**2) & (near <= (far + RING_PX) ** 2) & seen
    alone = spot & seen
    pairs = np.array(sorted(KDTree(places).query_pairs(2 * far + RING_PX)), dtype=np.int64)
    for n, k in [*pairs, *pairs[:, ::-1]] if len(pairs) else []:
        from_it = away(places[k], n)
        theirs = (from_it <= far**2) & (away(centres[k], n) <= due.rim**2)
        ring[n] &= ~theirs
        alone[n] &= ~theirs | (from_it > due.reach**2)
        own[n] &= ~theirs | (near[n] <= from_it)
    return _Windows(values[at].astype(np.float32), x, y, own, spot, alone, ring)


def _background(seen: _Windows, noise: SensorNoise) -> tuple[Array, Array]:
    """Mean of each ring, DN, and its variance; that of all where a ring has too few pixels."""
    ring = seen.ring & (seen.light < noise.full_scale_dn)
    beside = ring.sum(axis=(1, 2))
    dark = np.where(ring, seen.light, np.float32(0)).sum(axis=(1, 2), dtype=np.float64)
    dark /= np.maximum(beside, 1)
    enough = beside >= FEWEST
    dark = np.where(enough, dark, np.median(dark[enough]) if enough.any() else noise.offset_dn)
    return dark, noise.variance(dark) / np.maximum(beside, FEWEST)


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

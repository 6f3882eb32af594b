"""A target's pose from the spots of its picture alone: no matter where it stands, how far off and
how it is turned.

Seen from its micro-image's centre c, dot o lies at s - c = shift + A o + P c (complex: x + i y). P,
the parallax, and the size of A are those of some distance of the target. At the true one all views
of a dot have one s - c - P c, and those of the four dots make a square.
"""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.measurement.dots.pose import Pose
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import scales_of, sensor_position
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

FAINT = 6.0  # standard deviations of a dark pixel: what is fainter is no spot
MOST = 80  # spots looked at, the largest
WHOLE = 0.5  # of the usual area: smaller ones are cut, their middle is elsewhere
NEAREST, FARTHEST, STEPS = 0.25, 4.0, 4000  # of the nominal distance
CLOSE_PX = 3.0  # of a spot to where a pose puts it
EXPLAINED = 0.5  # of all spots, by the square


def blind_pose(
    spots: Array, lattice: Lattice, camera: Camera, target: FourDot, distance: float
) -> Pose | None:
    """Find four dots that make a square in all micro-images together.

    The square is the same after a quarter of a turn: dots are numbered as if it were turned by less
    than 45 degrees.

    Args:
        spots: centres (x, y), px, as ``spots_in`` finds them, shape (n, 2).
        lattice: the micro-images.
        camera: nominal.
        target: the dots.
        distance: nominal, mm; the target is sought from a quarter of it to four times as far.

    Returns:
        None where less than half of the spots lie in such a square.
    """
    if len(spots) < 4:
        return None
    centres = lattice.centres_px[KDTree(lattice.centres_px).query(spots)[1]]
    away = (spots - centres) @ [1, 1j] * camera.sensor.pixel
    centre = sensor_position(camera.sensor, centres) @ [1, 1j]
    best, close = None, CLOSE_PX * camera.sensor.pixel
    distances = distance / np.linspace(1 / FARTHEST, 1 / NEAREST, STEPS)
    smms = central_smms(camera)
    scales = np.array([scales_of(smms, one) for one in distances])
    scales, distances = scales[scales[:, 0] != 0], distances[scales[:, 0] != 0]
    dots, parallaxes = 1 / scales[:, 0], -scales[:, 1] / scales[:, 0]
    scores = _agreement(away, centre, np.abs(dots) * target.spacing, parallaxes, close)
    most = 0.0
    for n in _peaks(scores):
        explained, shift, turn = _square(
            away - parallaxes[n] * centre, float(dots[n]) * target.spacing, close
        )
        if explained > most:
            most, best = explained, Pose(float(distances[n]), turn, shift)
    return best if most >= EXPLAINED else None


def spots_in(values: npt.NDArray[Any], radius: float, noise: SensorNoise) -> Array:
    """Centres (x, y), px, of what is bright and not cut, the largest ``MOST``; shape (n, 2).

    Args:
        values: DN, [row, col].
        radius: of a spot, px, roughly: of larger ones fewer pixels will do.
        noise: of the sensor.
    """
    side = int(np.clip(radius / 2, 1, 4))
    rows, columns = values.shape[0] // side, values.shape[1] // side
    whole = values[: side * rows, : side * columns]
    whole = whole if whole.dtype == np.uint16 else np.asarray(whole, dtype=np.float32)
    picture = np.asarray(
        cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32
    )
    dark = darkness_of(picture)
    seen = picture[picture > dark + FAINT / side * math.sqrt(noise.dark_variance)]
    if len(seen) == 0:
        return np.zeros((0, 2))
    bright = dark + (float(np.quantile(seen[:: max(1, len(seen) // 10_000)], 0.9)) - dark) / 2
    _, _, stats, middles = cv2.connectedComponentsWithStats((picture > bright).view(np.uint8))
    areas, middles = stats[1:, cv2.CC_STAT_AREA], side * middles[1:] + (side - 1) / 2
    largest = np.argsort(areas, kind="stable")[::-1][:MOST]
    lit = np.cumsum(areas[largest])
    if len(largest):  # half of all that is bright is as large: hot pixels are many, but small
        usual = areas[largest][np.searchsorted(lit, lit[-1] / 2)]
        largest = largest[areas[largest] >= WHOLE * usual]
    return np.asarray(middles[largest], dtype=np.float64)


def darkness_of(picture: npt.NDArray[Any]) -> float:
    """DN of most of a picture of few bright places: the median of some 300 x 300 pixels."""
    rows, columns = picture.shape
    return float(np.median(picture[:: max(1, rows // 300), :: max(1, columns // 300)]))


def _agreement(
    away: Complex, centre: Complex, sides: Array, parallaxes: Array, close: float
) -> Array:
    """How many pairs of spots are 0, a side or a diagonal of the square apart, for each distance
    tried; shape as ``sides``.
    """
    i, j = np.triu_indices(len(away), 1)
    steps, bases = away[i] - away[j], centre[i] - centre[j]
    scores = np.zeros(len(sides))
    for n, (side, parallax) in enumerate(zip(sides, parallaxes, strict=True)):
        apart = np.abs(steps - parallax * bases)
        off = np.minimum(np.abs(apart - side), np.abs(apart - math.sqrt(2) * side))
        scores[n] = (
            np.exp(-0.5 * (np.minimum(off, apart) / close) ** 2).sum() if side > 3 * close else 0.0
        )
    return scores


def _peaks(scores: Array) -> npt.NDArray[np.int64]:
    """The eight highest local maxima."""
    inner = (scores >= np.roll(scores, 1)) & (scores >= np.roll(scores, -1)) & (scores > 0)
    tops = np.flatnonzero(inner)
    return tops[np.argsort(scores[tops])[::-1][:8]]


def _square(points: Complex, side: float, close: float) -> tuple[float, complex, complex]:
    """The square with most points near its corners: their share, its middle and its turn (of
    absolute value 1).
    """
    i, j = np.triu_indices(len(points), 1)
    steps = points[i] - points[j]
    along = np.exp(-0.5 * ((np.abs(steps) - abs(side)) / close) ** 2)
    fourth = complex((along * (steps / np.maximum(np.abs(steps), 1e-12)) ** 4).sum())
    turn = complex(np.exp(0.25j * np.angle(fourth)))
    corners = np.array([-1 - 1j, 1 - 1j, -1 + 1j, 1 + 1j]) / 2 * side * turn
    best, most = 0j, 0
    for middle in (points[:, None] - corners).ravel():
        off = np.abs((points - middle)[:, None] - corners)
        near, nearest = off.min(axis=1) < close, off.argmin(axis=1)
        if near.sum() > most and len(np.unique(nearest[near])) >= 3:
            most = int(near.sum())
            best = complex(middle + (points - middle - corners[nearest])[near].mean())
    return most / len(points), best, turn

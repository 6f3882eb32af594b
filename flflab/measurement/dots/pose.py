"""Where a target of four dots stands, roughly, from the bright spots of its picture alone: the
nominal distance first, else whichever makes a square of them, wherever it stands and however it is
turned.

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

from flflab.errors import MeasurementError
from flflab.measurement.dots.model import Microlenses, shown_pairs
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    blur_px,
    scales_of,
    sensor_pixel,
    sensor_position,
    target_scales,
)
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
CLOSE_PX = 3.0  # of a spot to where a square puts it
NEAR_PX = 8.0  # the same, where the nominal distance is a little off
THERE = 0.9  # of light and spots: with less agreement dots are looked for everywhere
LEAST = 0.5  # the same: less is none
LIT = 0.8  # of a dot's light: so well lit a place says whether a dot is there


def pose_of(
    values: npt.NDArray[Any],
    lattice: Lattice,
    every: Microlenses,
    target: FourDot,
    distance: float,
    noise: SensorNoise,
) -> Array:
    """Where the dots of a picture stand: (x, y) of each times its vergence, rad, and that, 1/mm,
    which all share; shape (4, 3).

    The square is the same after a quarter of a turn: dots are numbered as if it were turned by less
    than 45 degrees.

    Args:
        values: DN, [row, col].
        lattice: the micro-images.
        every: the microlens behind each of them.
        target: the dots.
        distance: nominal, mm; the target is sought from a quarter of it to four times as far.
        noise: of the sensor.

    Raises:
        MeasurementError: target at infinity, or light and spots agree with no place of the dots.
    """
    camera = every.camera
    across, along = target_scales(camera, distance)
    spots = spots_in(values, target.diameter / 2 / abs(across) / camera.sensor.pixel, noise)
    if len(spots) == 0:
        raise _none(0.0, target)
    centres = lattice.centres_px[KDTree(lattice.centres_px).query(spots)[1]]
    away = (spots - centres) @ [1, 1j] * camera.sensor.pixel
    centre = sensor_position(camera.sensor, centres) @ [1, 1j]
    corners = target.centres @ [1, 1j] / across
    near = (NEAR_PX + blur_px(camera, distance) / 2) * camera.sensor.pixel
    shift = _common_shift(away + along / across * centre, corners, near)
    found = [_posed(target, camera, distance, 1.0, shift)]
    agreed = [_agreement(found[0], spots, lattice, every, target)]
    if agreed[0] < THERE:
        found += blind_poses(away, centre, camera, target, distance)
        agreed += [_agreement(one, spots, lattice, every, target) for one in found[1:]]
    best = int(np.argmax(agreed))
    if agreed[best] < LEAST:
        raise _none(agreed[best], target)
    return found[best]


def blind_poses(
    away: Complex, centre: Complex, camera: Camera, target: FourDot, distance: float
) -> list[Array]:
    """Places of the target whose four dots make a square of spots.

    Args:
        away: spots from their micro-image's centre, mm.
        centre: of the micro-image of each, mm.
        camera: nominal.
        target: the dots.
        distance: nominal, mm.
    """
    close, smms = CLOSE_PX * camera.sensor.pixel, central_smms(camera)
    distances = distance / np.linspace(1 / FARTHEST, 1 / NEAREST, STEPS)
    scales = np.array([scales_of(smms, one) for one in distances])
    distances, scales = distances[scales[:, 0] != 0], scales[scales[:, 0] != 0]
    parallaxes = -scales[:, 1] / scales[:, 0]
    sides = target.spacing / np.abs(scales[:, 0])
    i, j = np.triu_indices(len(away), 1)
    steps, bases = away[i] - away[j], centre[i] - centre[j]
    scores = np.zeros(len(sides))
    for n in np.flatnonzero(sides > 3 * close):  # pairs 0, a side or a diagonal apart
        apart = np.abs(steps - parallaxes[n] * bases)
        off = np.minimum(np.abs(apart - sides[n]), np.abs(apart - math.sqrt(2) * sides[n]))
        scores[n] = np.exp(-0.5 * (np.minimum(off, apart) / close) ** 2).sum()
    tops = (scores >= np.roll(scores, 1)) & (scores >= np.roll(scores, -1)) & (scores > 0)
    found: list[Array] = []
    for n in np.flatnonzero(tops)[np.argsort(-scores[tops])[:8]]:
        points = away - parallaxes[n] * centre
        apart = points[i] - points[j]
        along = np.exp(-0.5 * ((np.abs(apart) - sides[n]) / close) ** 2)
        fourth = complex((along * (apart / np.maximum(np.abs(apart), 1e-12)) ** 4).sum())
        turn = complex(np.exp(0.25j * np.angle(fourth)))
        corners = turn * (target.centres @ [1, 1j]) / scales[n, 0]
        shift = _common_shift(points, corners, close)
        off = np.abs(points[:, None] - shift - corners)
        explained = off.min(axis=1) < close
        if explained.mean() >= LEAST and len(np.unique(off.argmin(axis=1)[explained])) >= 3:
            found.append(_posed(target, camera, float(distances[n]), turn, shift))
    return found


def _common_shift(points: Complex, corners: Complex, close: float) -> complex:
    """The shift that puts corners on most points, of equals the smallest."""
    shifts = (points[:, None] - corners).ravel()
    places = np.stack([shifts.real, shifts.imag], axis=1)
    near = KDTree(places).query_ball_point(places, close)
    best = max(range(len(shifts)), key=lambda n: (len(near[n]), -abs(shifts[n])))
    return complex(np.median(shifts[near[best]].real) + 1j * np.median(shifts[near[best]].imag))


def _posed(
    target: FourDot, camera: Camera, distance: float, turn: complex, shift: complex
) -> Array:
    across, _ = target_scales(camera, distance)
    dots = turn * (target.centres @ [1, 1j]) + shift * across
    stands = np.stack([dots.real, dots.imag, np.ones(len(dots))], axis=1) / distance
    return np.asarray(stands, dtype=np.float64)


def _agreement(
    pose: Array, spots: Array, lattice: Lattice, every: Microlenses, target: FourDot
) -> float:
    """The lesser of the shares of well lit places of dots that show a spot, and of the spots that
    are at the place of one.
    """
    sensor, vergence = every.camera.sensor, float(pose[0, 2])
    near = NEAR_PX + blur_px(every.camera, 1 / vergence) / 2
    pairs, expected = shown_pairs(every, pose, target.diameter * vergence, LIT / 10)
    due = sensor_pixel(sensor, every.centres[pairs[1]] + expected.centroid)
    if len(due) == 0:
        return 0.0
    inside = np.all((due > near) & (due < np.array(sensor.resolution) - near), axis=1)
    expected_there = inside & (expected.light > LIT)
    explained = KDTree(due).query(spots)[0] < near
    shown = KDTree(spots).query(due[expected_there])[0] < near
    some = len(shown) > 0 and len(spots) < MOST
    return float(min(explained.mean(), shown.mean() if some else 1.0))


def _none(agreed: float, target: FourDot) -> MeasurementError:
    return MeasurementError(
        f"four-dot picture: no pattern of dots {target.spacing:g} mm apart found:"
        f" {100 * agreed:.0f} % of the expected light is there ({100 * LEAST:.0f} % needed);"
        " check exposure, distance, and the target's spacing"
    )


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
    some = max(1, rows // 300), max(1, columns // 300)
    dark = float(np.median(picture[:: some[0], :: some[1]]))
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

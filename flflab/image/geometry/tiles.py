"""Parts of micro-images: rectangles of pixels, cut so finely that rays end where one linear map per
part says.
"""

import math

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from flflab.image.effects.distortion import Distortion
from flflab.image.geometry.pupil import Pupils
from flflab.image.geometry.rays import land, linearised
from flflab.image.scene import Plane
from flflab.optics.camera import Sensor, pixel_positions

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SPOKES = 2 * np.pi * np.arange(8) / 8
RIM = np.stack([np.cos(SPOKES), np.sin(SPOKES)], axis=1)  # points on the pupil's rim
BLURRED = 0.5  # what a wrong end of the rays through the pupil's rim counts against one of all rays
BENT = 0.25  # the same where opposite points of the rim are wrong alike


def windows_of(sensor: Sensor, pupils: Pupils, whole: bool) -> Whole:
    """The pixels that each micro-image can light: first column, column after the last, first row,
    row after the last; (N, 4).

    Args:
        sensor: the sensor.
        pupils: the microlenses.
        whole: whether a micro-image reaches as far as its light; else it ends half-way to its
            nearest neighbour, along columns and rows.
    """
    half = pupils.outside + sensor.pixel
    if not whole and len(half) > 1:
        centres = np.stack([pupils.centre_x, pupils.centre_y], axis=1)
        half = np.minimum(half, KDTree(centres).query(centres, k=2)[0][:, 1] / 2)
    limits: list[Array] = []
    for centre, positions in zip(
        (pupils.centre_x, pupils.centre_y), pixel_positions(sensor), strict=True
    ):
        place = (np.stack([centre - half, centre + half]) - positions[0]) / sensor.pixel
        limits += list(np.clip([np.ceil(place[0]), np.floor(place[1]) + 1], 0, len(positions)))
    return np.stack(limits, axis=1).astype(np.int64)


def middles(sensor: Sensor, pupils: Pupils, windows: Whole) -> tuple[Array, Array]:
    """Middle of each window from its micro-image's centre, and half its sides, to the centres of
    the outer pixels; mm, (N, 2) both.
    """
    first = np.array([positions[0] for positions in pixel_positions(sensor)])
    low, high = windows[:, ::2], windows[:, 1::2] - 1
    middle = first + (low + high) / 2 * sensor.pixel
    return middle - np.stack([pupils.centre_x, pupils.centre_y], axis=1), (
        high - low
    ) / 2 * sensor.pixel


def cut(windows: Whole, counts: Whole) -> tuple[Whole, Whole]:
    """Cut windows (N, 4) into counts (N, 2) columns and rows of parts: which window each part is
    of, and its pixels; no empty ones.
    """
    number = counts.prod(axis=1)
    entries = np.repeat(np.arange(len(windows)), number)
    index = np.arange(len(entries)) - np.repeat(np.cumsum(number) - number, number)
    parts = np.empty((len(entries), 4), dtype=np.int64)
    for axis, place in enumerate((index % counts[entries, 0], index // counts[entries, 0])):
        low, high, count = (
            windows[entries, 2 * axis],
            windows[entries, 2 * axis + 1],
            counts[entries, axis],
        )
        parts[:, 2 * axis] = low + (high - low) * place // count
        parts[:, 2 * axis + 1] = low + (high - low) * (place + 1) // count
    lit = (parts[:, 0] < parts[:, 1]) & (parts[:, 2] < parts[:, 3])
    return entries[lit], parts[lit]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shrink(
    wanted: npt.NDArray[np.bool_], start: int, end: int, first: int, last: int
) -> tuple[int, int, int, int]:
    """The smallest part of a window of columns and rows that holds all its wanted pixels; an empty
    one where there are none.
    """
    if start >= end or first >= last:
        return start, start, first, first
    left, right, bottom, top = end, start, last, first
    for row in range(first, last):
        for column in range(start, end):
            if wanted[row, column]:
                left, right = min(left, column), max(right, column + 1)
                bottom, top = min(bottom, row), max(top, row + 1)
    return (left, right, bottom, top) if left < right else (start, start, first, first)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def holding(wanted: npt.NDArray[np.bool_], windows: Whole) -> npt.NDArray[np.bool_]:
    """Which windows (N, 4) hold wanted pixels, [row, column]."""
    found = np.zeros(len(windows), dtype=np.bool_)
    for entry in range(len(windows)):
        left, right, first, last = windows[entry]
        for row in range(first, last):
            if wanted[row, left:right].any():
                found[entry] = True
                break
    return found


def counts_needed(
    sensor: Sensor,
    pupils: Pupils,
    windows: Whole,
    plane: Plane,
    distortion: Distortion | None,
    allowed: float,
) -> tuple[Whole, npt.NDArray[np.bool_]]:
    """Into how many columns and rows each window must be cut so that linear maps leave no larger
    error (of white) than allowed.

    What is left of the map by second order falls with the square of a part's side along the sensor,
    with the side where pupil and sensor act together, and not at all within the pupil.

    No part is smaller than a pixel, in whose middle its map is right; what that leaves of the bend
    within the pixel is not counted.

    Returns:
        The counts (N, 2), and which windows no cutting helps, because rays through one sensor point
        end too crookedly.
    """
    middle, half = middles(sensor, pupils, windows)
    landing = linearised(pupils, plane, distortion, middle)

    def error(pupil: Array, sensor_place: Array) -> Array:
        truth = land(pupils, plane, distortion, pupil, sensor_place)
        return landing.error(landing.at(pupil, sensor_place), truth, sensor.pixel)

    still, spot = np.zeros((1, 1, 2)), middle[:, None]
    bent = error(RIM[None], spot)
    counts = np.ones((len(windows), 2))
    corner = error(
        still, spot + half[:, None] * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    )
    for axis in range(2):
        side = np.zeros((2, 2))
        side[:, axis] = (-1.0, 1.0)
        along = spot + half[:, None] * side
        alone = np.maximum(error(still, along), corner / 2)
        together = (
            np.maximum(error(RIM[None], along[:, :1]), error(RIM[None], along[:, 1:]))
            - bent
            - alone
        )
        counts[:, axis] = np.maximum(np.sqrt(alone / allowed), BLURRED * together / allowed)
    pixels = np.maximum(
        np.stack([windows[:, 1] - windows[:, 0], windows[:, 3] - windows[:, 2]], axis=1), 1
    )
    return np.clip(np.ceil(counts), 1, pixels).astype(np.int64), BENT * bent > allowed


def largest_stretch(matrix: Array) -> Array:
    """Largest singular value of matrices (N, 2, 2)."""
    squares = np.sum(matrix**2, axis=(1, 2))
    determinant = matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
    return np.sqrt((squares + np.sqrt(np.maximum(squares**2 - 4 * determinant**2, 0.0))) / 2)


def blur_of(by_pupil: Array, by_sensor: Array, pixel: float) -> Array:
    """Diameter on the sensor of the blur of a point, in pixels, from the maps (N, 2, 2); infinite
    where sensor points see one place.
    """
    determinant = by_sensor[:, 0, 0] * by_sensor[:, 1, 1] - by_sensor[:, 0, 1] * by_sensor[:, 1, 0]
    adjugate = np.stack(
        [by_sensor[:, 1, 1], -by_sensor[:, 0, 1], -by_sensor[:, 1, 0], by_sensor[:, 0, 0]], axis=1
    ).reshape(-1, 2, 2)
    stretch = 2 / pixel * largest_stretch(adjugate @ by_pupil)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(
            by_pupil.any(axis=(1, 2)),
            np.where(determinant == 0, math.inf, stretch / np.abs(determinant)),
            0.0,
        )

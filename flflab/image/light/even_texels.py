"""What sees texels of one radiance only needs no sums over the pupil."""

import math

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int32]


def count_borders(values: Array) -> Counts:
    """How many texels are unlike the one to their left, and how many unlike the one above them; the
    picture is black around.

    Args:
        values: the radiance [row, column].

    Returns:
        Shape (rows + 3, columns + 3, 2): of texels before row j - 1 and column i - 1 at [j, i].
    """
    padded = np.pad(values, 1)
    unlike = np.zeros((*padded.shape, 2), dtype=np.int32)
    unlike[:, 1:, 0] = padded[:, 1:] != padded[:, :-1]
    unlike[1:, :, 1] = padded[1:] != padded[:-1]
    return np.pad(
        unlike.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32),
        ((1, 0), (1, 0), (0, 0)),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def radiance_round(
    x: float, y: float, half_x: float, half_y: float, values: Array, borders: Counts
) -> float:
    """The radiance of all texels that a box round a place touches, texels from the picture's
    corner; -1 where they are unlike.

    Args:
        x: the place.
        y: the same along y'.
        half_x: half the box's width.
        half_y: half its height.
        values: the radiance of the picture [row, column].
        borders: see ``count_borders``.
    """
    high, wide = values.shape
    x, y = x + 1.0, y + 1.0  # a black texel is before the first
    left, right = (
        int(min(max(x - half_x, 0.0), wide + 1.0)),
        int(min(max(x + half_x, 0.0), wide + 1.0)) + 1,
    )
    low, up = (
        int(min(max(y - half_y, 0.0), high + 1.0)),
        int(min(max(y + half_y, 0.0), high + 1.0)) + 1,
    )
    beside = (
        borders[up, right, 0]
        - borders[low, right, 0]
        - borders[up, left + 1, 0]
        + borders[low, left + 1, 0]
    )
    above = (
        borders[up, right, 1]
        - borders[low + 1, right, 1]
        - borders[up, left, 1]
        + borders[low + 1, left, 1]
    )
    if beside + above > 0:
        return -1.0
    return values[low - 1, left - 1] if 0 < low <= high and 0 < left <= wide else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def even_radiance(
    at_x: float, at_y: float, frame: Array, side: float, values: Array, borders: Counts
) -> float:
    """The radiance of all texels that a part of a pixel sees through the whole pupil; -1 where they
    are unlike.

    Args:
        at_x: where its middle looks, texels from the first one of the tables.
        at_y: the same along y'.
        frame: see ``seen_texels``.
        side: of the part, mm.
        values: the radiance of the picture [row, column].
        borders: see ``count_borders``.
    """
    half_x = math.hypot(frame[2], frame[3]) + 0.5 * (abs(frame[6]) + abs(frame[7])) * side
    half_y = math.hypot(frame[4], frame[5]) + 0.5 * (abs(frame[8]) + abs(frame[9])) * side
    return radiance_round(at_x + frame[17], at_y + frame[18], half_x, half_y, values, borders)

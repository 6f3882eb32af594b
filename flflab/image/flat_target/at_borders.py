"""Which pixels see a border of a target that moves at one moment of the exposure or another: all
others see what stands still.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.setup import Setup
from flflab.image.light.even_texels import count_borders, radiance_round
from flflab.image.radiance.profile import Cropped
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, FourDot, Picture, Target

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]


def at_borders(shape: tuple[int, ...], setup: Setup, target: Target | Cropped) -> Chosen:
    """Which pixels see an end of bars, a dot's rim or a border between unlike texels at one moment
    or another, [row, column].

    What moves across the sides of bars or an edge smears their profile, so these don't count.
    """
    found, motion = np.zeros(shape, dtype=np.bool_), setup.motion
    if motion is None:
        return found
    moved = np.abs(setup.by_motion @ np.array(motion.drift)) / 2 + np.abs(
        setup.by_motion @ np.array(motion.vibration)
    )
    reach = (
        moved
        + np.linalg.norm(setup.by_pupil, axis=2)
        + np.abs(setup.by_sensor).sum(axis=2) * (0.5 * setup.sensor.pixel)
    )
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])
    maps = np.column_stack([setup.origin, setup.by_sensor.reshape(-1, 4)])
    places = (setup.window, centres, maps, reach, *pixel_positions(setup.sensor))
    match target:
        case Bars() | Cropped():
            _mark_ends(found, *places, target.height / 2)
        case FourDot():
            _mark_rims(found, *places, np.array(target.centres), target.diameter / 2)
        case Picture():
            values = np.asarray(target.values, dtype=np.float64)
            _mark_texels(found, *places, values, count_borders(values), target.texel)
        case _:
            pass
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mark_ends(
    found: Chosen,
    windows: Whole,
    centres: Array,
    maps: Array,
    reach: Array,
    xs: Array,
    ys: Array,
    half: float,
) -> None:
    """Mark the pixels that look at less than ``reach`` from y' = half or -half; ``maps`` are as in
    ``_looks``.
    """
    for entry in range(windows.shape[0]):
        for row in range(windows[entry, 2], windows[entry, 3]):
            for column in range(windows[entry, 0], windows[entry, 1]):
                _, y = _looks(
                    maps[entry], xs[column] - centres[entry, 0], ys[row] - centres[entry, 1]
                )
                if abs(abs(y) - half) < reach[entry, 1]:
                    found[row, column] = True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mark_rims(
    found: Chosen,
    windows: Whole,
    centres: Array,
    maps: Array,
    reach: Array,
    xs: Array,
    ys: Array,
    dots: Array,
    radius: float,
) -> None:
    """Mark the pixels that look at less than ``reach`` from the rim of a dot, at its centre (x',
    y').
    """
    for entry in range(windows.shape[0]):
        far = math.hypot(reach[entry, 0], reach[entry, 1])
        for row in range(windows[entry, 2], windows[entry, 3]):
            for column in range(windows[entry, 0], windows[entry, 1]):
                x, y = _looks(
                    maps[entry], xs[column] - centres[entry, 0], ys[row] - centres[entry, 1]
                )
                for dot in range(dots.shape[0]):
                    if abs(math.hypot(x - dots[dot, 0], y - dots[dot, 1]) - radius) < far:
                        found[row, column] = True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mark_texels(
    found: Chosen,
    windows: Whole,
    centres: Array,
    maps: Array,
    reach: Array,
    xs: Array,
    ys: Array,
    values: Array,
    borders: npt.NDArray[np.int32],
    texel: float,
) -> None:
    """Mark the pixels that look at unlike texels less than ``reach`` away; ``borders`` are those of
    ``count_borders``.
    """
    rows, columns = values.shape
    for entry in range(windows.shape[0]):
        half_x, half_y = reach[entry, 0] / texel, reach[entry, 1] / texel
        for row in range(windows[entry, 2], windows[entry, 3]):
            for column in range(windows[entry, 0], windows[entry, 1]):
                if not found[row, column]:
                    x, y = _looks(
                        maps[entry], xs[column] - centres[entry, 0], ys[row] - centres[entry, 1]
                    )
                    x, y = x / texel + 0.5 * columns, y / texel + 0.5 * rows
                    found[row, column] = radiance_round(x, y, half_x, half_y, values, borders) < 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _looks(to: Array, ex: float, ey: float) -> tuple[float, float]:
    """Where a sensor point e looks on the target: origin (0, 1) and the matrix (2 to 5) row by
    row.
    """
    return to[0] + to[2] * ex + to[3] * ey, to[1] + to[4] * ex + to[5] * ey

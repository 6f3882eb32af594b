"""The light of one flat target that moves during the exposure.

What moves along the lines of bars or of an edge changes nothing but at the bars' ends; what moves across them smears their profile, once
for all moments. Only pixels that see an end, and pictures and dots, are formed at one place after the other.
"""

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.form import add_plane
from flflab.image.moments import at_heights, at_moments, moment_count
from flflab.image.setup import Setup
from flflab.optics.camera import pixel_positions
from flflab.targets import Bars, Edge, Target

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]


def add_moving_plane(image: Array, setup: Setup, target: Target, wanted: Chosen | None = None) -> None:
    """Add the light of one flat target, not black, to an image [row, column] in units of the white level.

    Args:
        image: the image to add to.
        setup: what is formed.
        target: the target.
        wanted: which pixels to compute, [row, column]; the others stay as they are. None for all.
    """
    if not isinstance(target, Bars | Edge):
        for moment in at_moments(setup):
            add_plane(image, moment, target, wanted)
        return
    ends = _at_ends(image.shape, setup, target) if isinstance(target, Bars) and moment_count(setup, 1) > 1 else None
    if ends is None or not ends.any():
        add_plane(image, setup, target, wanted)
        return
    near, far = (ends, ~ends) if wanted is None else (wanted & ends, wanted & ~ends)
    away, close = setup.reaching(far), setup.reaching(near)
    if len(away.origin):
        add_plane(image, away, target, far)
    for part in at_heights(close) if len(close.origin) else ():
        add_plane(image, part, target, near)


def _at_ends(shape: tuple[int, ...], setup: Setup, bars: Bars) -> Chosen:
    """Which pixels see an end of the bars at one moment or another."""
    found, motion = np.zeros(shape, dtype=np.bool_), setup.motion
    if motion is None:
        return found
    aside = np.abs(setup.by_motion[:, 1] @ np.array(motion.drift)) / 2 + np.abs(setup.by_motion[:, 1] @ np.array(motion.vibration))
    seen = np.abs(setup.by_pupil[:, 1]).sum(axis=1) + np.abs(setup.by_sensor[:, 1]).sum(axis=1) * setup.sensor.pixel
    heights = np.column_stack([setup.origin[:, 1], setup.by_sensor[:, 1]])
    centres = np.column_stack([setup.pupils.centre_x, setup.pupils.centre_y])
    _mark_ends(found, setup.window, centres, heights, aside + seen, bars.height / 2, *pixel_positions(setup.sensor))
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mark_ends(found: Chosen, windows: Whole, centres: Array, heights: Array, reach: Array, half: float, xs: Array, ys: Array) -> None:
    """Mark the pixels that look at less than ``reach`` from y' = half or -half; heights: y' = (0) + (1, 2) sensor, target mm."""
    for entry in range(windows.shape[0]):
        origin, by_x, by_y = heights[entry]
        for row in range(windows[entry, 2], windows[entry, 3]):
            start = origin + by_y * (ys[row] - centres[entry, 1]) - by_x * centres[entry, 0]
            for column in range(windows[entry, 0], windows[entry, 1]):
                if abs(abs(start + by_x * xs[column]) - half) < reach[entry]:
                    found[row, column] = True

"""The finest tolerance that a time budget allows, from a short calibration on a few tiles of the picture."""

import time

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.chooser import choose
from flflab.image.render import LEAST_TOLERANCE, render
from flflab.image.scene import Scene

Flags = npt.NDArray[np.bool_]

COARSEST = 0.3
STEP = 3.0  # from one tolerance tried to the next
TILE = 16
TILES = 40
MARGIN = 1.3  # what is predicted may be short by this


def affordable_tolerance(scene: Scene, budget: float, effects: str = "auto") -> float:
    """The finest tolerance whose picture is expected to be ready within the budget.

    From coarse to fine, each tolerance is tried on a few tiles; what that takes counts against the budget.

    Args:
        scene: what is pictured.
        budget: s.
        effects: as for ``choose``.

    Raises:
        InputError: the budget is not a time above 0, or not even the coarsest picture fits it.
    """
    if not budget > 0:
        raise InputError(f"time budget: {budget:g} s; a time above 0 s is due")
    started = time.perf_counter()
    _seconds(scene, COARSEST, effects, _tiles(scene))  # the first call may compile
    warm = time.perf_counter()
    affordable, tolerance = 0.0, COARSEST
    while tolerance >= 2 * LEAST_TOLERANCE:
        predicted = MARGIN * _seconds(scene, tolerance, effects, _tiles(scene))
        left = budget - (time.perf_counter() - warm)
        if predicted > left:
            if affordable == 0.0:
                least = budget - left + predicted
                raise InputError(
                    f"time budget: {1e3 * budget:.3g} ms cannot be kept; the least that can is about {1e3 * least:.2g} ms, "
                    f"besides {1e3 * (warm - started):.2g} ms to get ready"
                )
            break
        affordable = tolerance
        tolerance /= STEP
    return affordable


def _tiles(scene: Scene) -> Flags:
    """Some tiles spread evenly over the sensor, by the additive sequence of the plastic number."""
    columns, rows = scene.camera.sensor.resolution
    wanted = np.zeros((rows, columns), dtype=np.bool_)
    for index in range(TILES):
        row = int((0.5 + index * 0.7548776662) % 1 * max(rows - TILE, 1))
        column = int((0.5 + index * 0.5698402910) % 1 * max(columns - TILE, 1))
        wanted[row : row + TILE, column : column + TILE] = True
    return wanted


def _seconds(scene: Scene, tolerance: float, effects: str, wanted: Flags) -> float:
    """Time expected for all pixels at this tolerance, from what none and a few of them take."""
    choice = choose(scene, tolerance, effects)
    marks = [time.perf_counter()]
    for mask in (np.zeros_like(wanted), wanted):
        render(scene, tolerance=choice.tolerance, effects=choice.formed, wanted=mask)
        marks.append(time.perf_counter())
    fixed, some = marks[1] - marks[0], marks[2] - marks[1]
    return fixed + max(some - fixed, 0.0) * wanted.size / max(int(wanted.sum()), 1)

"""The finest tolerance that a time budget allows, from a short calibration on a few tiles of the
picture.
"""

import math
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.image.chooser import choose
from flflab.image.estimate import estimate_error
from flflab.image.render import LEAST_TOLERANCE, render
from flflab.image.scene import Scene

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Clock = Callable[[], float]

COARSEST = 0.3
STEP = 3.0  # from one tolerance tried to the next
TILE = 4
TILES = 10000  # small ones: light of dots lies far between
TRIES = 3  # of which the shortest counts
BRIEF = 0.1  # s; what takes longer is tried once
MARGIN = 1.3  # what is predicted may be short by this


def affordable_tolerance(scene: Scene, budget: float, effects: str = "auto") -> float:
    """The finest tolerance whose picture is expected to be ready within the budget.

    From coarse to fine, each tolerance is tried on a few tiles; what that takes counts against the
    budget.

    Args:
        scene: what is pictured.
        budget: s.
        effects: as for ``choose``.

    Raises:
        InputError: the budget is not a time above 0, or not even the coarsest picture fits it.
    """
    tiles = tiles_tried(scene)

    def tried(tolerance: float) -> float:
        choice = choose(scene, tolerance, effects)
        return expected_seconds(
            lambda wanted: render(
                scene, tolerance=choice.tolerance, effects=choice.formed, wanted=wanted
            ),
            lambda image: estimate_error(scene, image, choice.tolerance, choice.effects),
            tiles,
            time.perf_counter,
        )

    return finest_within(budget, tried, time.perf_counter)


def finest_within(budget: float, tried: Callable[[float], float], clock: Clock) -> float:
    """The finest tolerance that a budget has time for, after trying coarser ones, which takes time
    of it, too.

    Args:
        budget: s.
        tried: tries a tolerance; returns how long its picture is expected to take, s.
        clock: tells the time, s.

    Raises:
        InputError: as ``affordable_tolerance``.
    """
    if not budget > 0:
        raise InputError(f"time budget: {budget:g} s; a time above 0 s is due")
    started = clock()
    tried(COARSEST)  # the first call may compile
    warm = clock()
    affordable, tolerance, before = 0.0, COARSEST, math.inf
    while tolerance >= 2 * LEAST_TOLERANCE:
        begun = clock()
        predicted = MARGIN * tried(tolerance)
        took, left = clock() - begun, budget - (clock() - warm)
        if predicted > left:
            if affordable == 0.0:
                raise InputError(
                    f"time budget: {_in_words(budget)} cannot be kept; the least that can is about"
                    f" {_in_words(budget - left + predicted)}, besides {_in_words(warm - started)}"
                    " to get ready"
                )
            break
        affordable = tolerance
        growth = min(max(took / before, 1.0), STEP)
        if (
            growth * (took + predicted) > left
        ):  # the next try would only take the time that this picture needs
            break
        before = took
        tolerance /= STEP
    return affordable


def _in_words(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def tiles_tried(scene: Scene) -> Flags:
    """Some tiles spread evenly over the sensor, by the additive sequence of the plastic number."""
    columns, rows = scene.camera.sensor.resolution
    wanted = np.zeros((rows, columns), dtype=np.bool_)
    for index in range(TILES):
        row = int((0.5 + index * 0.7548776662) % 1 * max(rows - TILE, 1))
        column = int((0.5 + index * 0.5698402910) % 1 * max(columns - TILE, 1))
        wanted[row : row + TILE, column : column + TILE] = True
    return wanted


def expected_seconds(
    form: Callable[[Flags], Array], estimate: Callable[[Array], object], wanted: Flags, clock: Clock
) -> float:
    """Time expected for all pixels, from what none and a few of them take, and for the estimate of
    the error, s.

    Args:
        form: forms the wanted pixels, [row, column].
        estimate: of the picture's error.
        wanted: the few.
        clock: tells the time, s.
    """
    started = clock()
    image = form(wanted)
    some = clock() - started
    estimating = _timed(lambda: estimate(image), clock)
    some = min(some, _shortest(lambda: form(wanted), clock)) if some < BRIEF else some
    if wanted.all():
        return estimating + some
    fixed = _shortest(lambda: form(np.zeros_like(wanted)), clock)
    return estimating + fixed + max(some - fixed, 0.0) * wanted.size / max(int(wanted.sum()), 1)


def _shortest(work: Callable[[], object], clock: Clock) -> float:
    """The shortest of some tries; of one where that is no matter of chance any more."""
    shortest = math.inf
    for _ in range(TRIES):
        shortest = min(shortest, _timed(work, clock))
        if shortest > BRIEF:
            break
    return shortest


def _timed(work: Callable[[], object], clock: Clock) -> float:
    started = clock()
    work()
    return clock() - started

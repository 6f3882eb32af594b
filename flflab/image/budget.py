"""The finest tolerance that a time budget allows, from trials on the middle of the picture."""

import math
import time
import timeit
from collections.abc import Callable
from dataclasses import replace

from flflab.errors import InputError
from flflab.image.accuracy import LEAST_TOLERANCE
from flflab.image.choose import choose
from flflab.image.render import render_light
from flflab.image.scene import Scene

Clock = Callable[[], float]

COARSEST = 0.3
STEP = 3.0  # from one tolerance tried to the next
PART = 4  # of either side of the sensor is tried
FEWEST = 64  # pixels a side
TRIES = 2  # of which the shortest counts
MARGIN = 1.3  # what is predicted may be short by this


def affordable_tolerance(scene: Scene, budget: float, effects: str = "auto") -> float:
    """The finest tolerance whose picture is expected to be ready within the budget.

    From coarse to fine, each tolerance is tried on the middle of the sensor; what that takes counts
    against the budget.

    Args:
        scene: what is pictured.
        budget: s.
        effects: as for ``choose``.

    Raises:
        InputError: the budget is not a time above 0, or not even the coarsest picture fits it.
    """
    middle, part = middle_of(scene)

    def tried(tolerance: float) -> float:
        choice = choose(middle, tolerance, effects)
        work = lambda: render_light(middle, choice.tolerance, choice.formed)  # noqa: E731
        return min(timeit.repeat(work, repeat=TRIES, number=1)) / part

    return finest_within(budget, tried, time.perf_counter)


def middle_of(scene: Scene) -> tuple[Scene, float]:
    """The scene on the middle of its sensor, and which part of the pixels that is."""
    sensor = scene.camera.sensor
    columns, rows = (max(size // PART, min(size, FEWEST)) for size in sensor.resolution)
    part = columns * rows / (sensor.resolution[0] * sensor.resolution[1])
    camera = replace(scene.camera, sensor=replace(sensor, resolution=(columns, rows)))
    return replace(scene, camera=camera), part


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
        if growth * (took + predicted) > left:  # the next try would take this picture's time
            break
        before = took
        tolerance /= STEP
    return affordable


def _in_words(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"

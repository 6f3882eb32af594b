"""Work against precision: what every method reaches on every problem at every setting, and what it
costs.

The design is that of the work-precision sets of the SciML benchmarks: problems with an independent
reference, methods with a list of settings, repeats; a table comes out.
"""

import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.scene import Scene

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SLOW = 1.0  # s; a run that takes longer is timed once
BRIEF = 0.02  # s; shorter runs are repeated within one timing until together they take as long


@dataclass(frozen=True)
class Problem:
    """A scene, the pixels it is judged by, and their values by a reference that shares no code with
    the methods.

    Attributes:
        name: for tables and plots.
        scene: what is pictured.
        pixels: (column, row) of each, shape (K, 2).
        values: of the reference, in units of the white level, shape (K,).
        uncertainty: standard uncertainty of each, shape (K,).
    """

    name: str
    scene: Scene
    pixels: Whole
    values: Array
    uncertainty: Array


@dataclass(frozen=True)
class Answer:
    """What a method finds: values at the problem's pixels, and how many pixels its time went
    into.
    """

    values: Array
    pixels: int


@dataclass(frozen=True)
class Method:
    """One way to form pictures.

    Attributes:
        name: for tables and plots.
        setting: what it takes: a ``tolerance``, or a count of work.
        settings: those to try.
        run: forms a picture at a setting; this is timed.
        estimate: what the method itself says of its rms error at a setting; not timed. None
            where it says nothing.
    """

    name: str
    setting: str
    settings: tuple[float, ...]
    run: Callable[[Problem, float], Answer]
    estimate: Callable[[Problem, float], float] | None = None


@dataclass(frozen=True)
class Row:
    """One method at one setting on one problem; errors in units of the white level.

    Attributes:
        scene: the problem's name.
        method: the method's name.
        requested: the tolerance asked for; None where the method takes none.
        work: the count of work asked for; None where the method takes a tolerance.
        largest_error: over the problem's pixels, against the reference.
        rms_error: the same, root mean square.
        estimate: the method's own, None where it has none.
        reference_uncertainty: root mean square of the reference's standard uncertainties.
        processor_s: of all cores, warm, median of the repeats.
        wall_s: the same on the clock.
        repeats: how many.
        first_s: on the clock, the first run, which may compile or load a kernel.
        pixels: how many lit pixels the time went into.
        lit_megapixels_per_s: on the clock.
    """

    scene: str
    method: str
    requested: float | None
    work: float | None
    largest_error: float
    rms_error: float
    estimate: float | None
    reference_uncertainty: float
    processor_s: float
    wall_s: float
    repeats: int
    first_s: float
    pixels: int
    lit_megapixels_per_s: float

    @property
    def processor_s_per_megapixel(self) -> float:
        """Processor time for a million lit pixels, s."""
        return 1e6 * self.processor_s / self.pixels


def work_precision(
    problems: Iterable[Problem],
    methods: Sequence[Method],
    *,
    repeats: int,
    tell: Callable[[str], None],
) -> tuple[Row, ...]:
    """Run every method at every setting on every problem.

    Args:
        problems: what is to be solved.
        methods: how.
        repeats: warm runs of each, of which the median counts; one where it takes longer than a
            second.
        tell: is told what is being done.
    """
    rows: list[Row] = []
    for problem in problems:
        for method in methods:
            tell(f"{problem.name}: {method.name}")
            rows += [_measure(problem, method, setting, repeats) for setting in method.settings]
    return tuple(rows)


def _measure(problem: Problem, method: Method, setting: float, repeats: int) -> Row:
    began = time.perf_counter()
    answer = method.run(problem, setting)
    first = time.perf_counter() - began
    batch = max(1, math.ceil(BRIEF / max(first, 1e-6))) if first < BRIEF else 1
    walls, spent = list[float](), list[float]()
    while len(walls) < repeats and not (walls and walls[-1] > SLOW):
        wall, processor = time.perf_counter(), time.process_time()
        for _ in range(batch):
            answer = method.run(problem, setting)
        walls.append((time.perf_counter() - wall) / batch)
        spent.append((time.process_time() - processor) / batch)
    wall, error = statistics.median(walls), answer.values - problem.values
    tolerance = method.setting == "tolerance"
    return Row(
        scene=problem.name,
        method=method.name,
        requested=setting if tolerance else None,
        work=None if tolerance else setting,
        largest_error=float(np.abs(error).max()),
        rms_error=float(np.sqrt(np.mean(error**2))),
        estimate=None if method.estimate is None else method.estimate(problem, setting),
        reference_uncertainty=float(np.sqrt(np.mean(problem.uncertainty**2))),
        processor_s=statistics.median(spent),
        wall_s=wall,
        repeats=len(walls),
        first_s=first,
        pixels=answer.pixels,
        lit_megapixels_per_s=1e-6 * answer.pixels / wall,
    )


def order(works: npt.ArrayLike, errors: npt.ArrayLike) -> float:
    """Slope of log error against log work: -1/2 for independent samples."""
    return float(
        np.polyfit(
            np.log(np.asarray(works, dtype=float)), np.log(np.asarray(errors, dtype=float)), 1
        )[0]
    )


def random_cost(rows: Sequence[Row], error: float) -> float:
    """Processor seconds for a million lit pixels at which independent samples reach an rms error,
    by their law cost = constant/error^2.

    Args:
        rows: of one scene and a method of independent samples; the constant is their median.
        error: root mean square, in units of the white level.
    """
    return (
        statistics.median(row.processor_s_per_megapixel * row.rms_error**2 for row in rows)
        / error**2
    )

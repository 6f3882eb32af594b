"""What a run is able to show: how large each single change of the bench must be to be seen in it.

A change that only a large size would show is hidden from this run, whatever its verdict.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.digits import two_digits
from flflab.verdict.diagnosis import metric_of
from flflab.verdict.geometry import Suspicion, suspicions
from flflab.verdict.prediction import Errors, OpticsFactors, OrderFactors, as_described
from flflab.verdict.properties.values import Values, joined

Array = npt.NDArray[np.float64]
SEEN = 25.0  # of chi squared: five standard deviations
STEP = 1e-3  # of the largest change that suspects are tried with


@dataclass(frozen=True)
class Visible:
    """How large one change must be to be seen in a run.

    Attributes:
        what: would change.
        smallest: change that moves the numbers by five standard deviations, in ``unit``; infinite
            where they do not move.
        unit: of it.
    """

    what: str
    smallest: float
    unit: str

    @property
    def words(self) -> str:
        """``0.12 mm``, or ``not at all``."""
        if not math.isfinite(self.smallest):
            return "not at all"
        return f"{two_digits(self.smallest)} {self.unit}"


def visible(
    found: list[Values], bench: Bench, numbers: Callable[[Errors], list[Values]]
) -> tuple[Visible, ...]:
    """Every change of the geometry, to first order about the bench as described.

    Args:
        found: the numbers that are judged, with the model's draws.
        bench: as described.
        numbers: the same numbers for benches with given errors.
    """
    metric = metric_of(*joined(found))
    tried = suspicions(bench)
    moved = joined(numbers(_one_each(tried)))[2]
    away = (moved[0::2] - moved[1::2]) / 2
    chi2 = np.asarray(metric(metric.measured + away))
    sizes = STEP * np.array([one.largest for one in tried])
    with np.errstate(divide="ignore"):
        smallest = sizes * np.sqrt(SEEN / chi2)
    return tuple(
        Visible(one.what, size * one.per_unit if size < one.largest else math.inf, one.unit)
        for one, size in zip(tried, smallest.tolist(), strict=True)
    )


def _one_each(tried: list[Suspicion]) -> Errors:
    """Benches with a small change, two for each: one way and the other."""
    plain, ways = as_described(2), STEP * np.array([1.0, -1.0])
    return _together([one.change(plain, one.largest * ways) for one in tried])


def _together(parts: list[Any]) -> Any:
    """Draws one after the other, for whatever holds them."""
    first = parts[0]
    if isinstance(first, np.ndarray):
        return np.concatenate(parts)
    if isinstance(first, dict):
        return {key: _together([part[key] for part in parts]) for key in first}
    if isinstance(first, tuple):
        return tuple(_together(list(column)) for column in zip(*parts, strict=True))
    if isinstance(first, Errors | OpticsFactors | OrderFactors):
        names = [field.name for field in fields(first)]
        return replace(
            first, **{name: _together([getattr(part, name) for part in parts]) for name in names}
        )
    return first

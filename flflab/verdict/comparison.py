"""Measured against predicted: rows with difference, uncertainty and z; differences between
configurations; a verdict for each quantity.

A verdict's p-value is the share of simulated benches (draws of the stage errors plus measurement
noise) that disagree with the mean prediction at least as much as the measurement does, in the
statistic r' C^-1 r with C the covariance of both. It therefore holds whatever the shape of the
distribution.
"""

import math
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.property_names import PROPERTY_NAMES
from flflab.whole_file import in_csv, write_own

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One line of ``comparison.csv``; distances in mm from the main lens, frequencies on the
    target.
    """

    configuration: int
    reference_configuration: int | None
    distance_mm: float
    array_mm: float
    sensor_mm: float
    f_number: float
    target: str
    dot: int | None
    cycles_per_mm: float | None
    quantity: str
    measured: float
    uncertainty: float
    predicted: float
    difference: float
    z: float


@dataclass(frozen=True)
class Verdict:
    """Whether a quantity agrees with the model on this bench.

    Attributes:
        quantity: what was compared.
        rows: how many numbers.
        p_value: share of honest simulated benches that disagree at least as much.
        draws: honest benches that were simulated for it.
        worst_z: largest difference from the mean of the honest benches, in its own standard
            uncertainty.
        threshold: the quantity is rejected below this p-value.
        accepted: p_value >= threshold.
        sentence: the verdict in one sentence.
    """

    quantity: str
    rows: int
    p_value: float
    draws: int
    worst_z: float
    threshold: float
    accepted: bool
    sentence: str

    @property
    def p_is_upper_bound(self) -> bool:
        """Whether none of the simulated benches disagreed as much: p is below 1 in their number."""
        return self.p_value * (1 + self.draws) < 1.5

    @property
    def p_words(self) -> str:
        """The p-value for people: ``33.7 %``, or ``none of 500, p < 0.2 %``."""
        if self.p_is_upper_bound:
            return f"none of {self.draws}, p < {percent(1 / self.draws)}"
        return percent(self.p_value)

    @property
    def p_clause(self) -> str:
        """The p-value within a sentence, or that no simulated bench deviates as much."""
        if self.p_is_upper_bound:
            return (
                f"none of {self.draws} simulated benches deviates as much,"
                f" p < {percent(1 / self.draws)}"
            )
        return f"p-value {percent(self.p_value)}"


@dataclass(frozen=True)
class Comparison:
    """All rows and verdicts of a run."""

    rows: tuple[Row, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def accepted(self) -> bool:
        """True where no verdict rejects the model."""
        return all(verdict.accepted for verdict in self.verdicts)


def z_score(difference: float, uncertainty: float) -> float:
    """Difference over standard uncertainty; 0 for no difference at all."""
    if difference == 0:
        return 0.0
    return difference / uncertainty if uncertainty > 0 else math.copysign(math.inf, difference)


def percent(share: float) -> str:
    """A share for people: ``33.7 %``."""
    return f"{100 * share:.3g} %"


def count_spread(draws: npt.NDArray[np.int64], expected: npt.NDArray[np.int64]) -> Array:
    """Standard uncertainty of predicted counts: spread over the draws round the nominal count.

    One more draw that is off by one is added, since n draws without a miss cannot exclude one in n
    + 1.

    Args:
        draws: counts, shape (n, k).
        expected: nominal counts, shape (k,).
    """
    return np.sqrt((np.sum((draws - expected) ** 2, axis=0) + 1) / (len(draws) + 1))


def judge(
    quantity: str,
    measured: Array,
    noise: Array,
    draws: Array,
    threshold: float,
    rng: np.random.Generator,
) -> Verdict:
    """Judge one quantity with its covariance.

    Args:
        quantity: its name.
        measured: measured values, shape (k,).
        noise: covariance of the measurement, shape (k, k).
        draws: predicted values over draws of the stage errors, shape (n, k), n at least 100.
        threshold: p-value below which the model is rejected.
        rng: for the measurement noise of the simulated benches.

    Raises:
        InputError: shapes disagree or there is nothing to judge.
    """
    count = len(measured)
    if count == 0 or draws.shape[1] != count or noise.shape != (count, count) or len(draws) < 100:
        raise InputError(
            f"verdict on {quantity}: {count} values, covariance {noise.shape}, draws {draws.shape}"
            " do not fit together"
        )
    half = len(draws) // 2
    mean = draws[:half].mean(axis=0)
    spread = draws[:half] - mean
    covariance = noise + spread.T @ spread / (half - 1)
    # Half the draws shape the statistic, the other half is its null distribution, so none is judged
    # by itself.
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = vectors / np.sqrt(np.maximum(values, values.max() * 1e-10))
    null = (
        draws[half:]
        - mean
        + rng.multivariate_normal(np.zeros(count), noise, len(draws) - half, method="eigh")
    )
    statistic = float(np.sum(((measured - mean) / scale @ root) ** 2))
    simulated = np.sum((null / scale @ root) ** 2, axis=1)
    p_value = (1 + int(np.count_nonzero(simulated >= statistic))) / (1 + len(simulated))
    accepted = p_value >= threshold
    sentence = (
        f"{PROPERTY_NAMES.get(quantity, quantity)}: {count} values"
        f" {'agree' if accepted else 'do not agree'} with the model"
    )
    worst = float(np.max(np.abs(measured - mean) / scale))
    judged = Verdict(quantity, count, p_value, len(null), worst, threshold, accepted, sentence)
    told = f"{sentence} ({judged.p_clause}; rejected below {percent(threshold)})"
    return replace(judged, sentence=told)


def rule(verdicts: tuple[Verdict, ...]) -> str:
    """How p-values come about and where a property is rejected, in a line beneath their table."""
    draws = max(verdict.draws for verdict in verdicts)
    level = sum(verdict.threshold for verdict in verdicts)
    return (
        f"p-value: the share of {draws} simulated benches, built and measured as stated, that"
        f" disagree with the model at least as much. {len(verdicts)} properties share the level of"
        f" {percent(level)}: each is rejected below {percent(verdicts[0].threshold)}, so that an"
        f" honest bench is rejected at most {percent(level)} of the time."
    )


def write_rows(rows: tuple[Row, ...], file: Path) -> None:
    """Write ``comparison.csv``; empty where a column does not apply."""
    told = (
        [
            "" if value is None else f"{value:.10g}" if isinstance(value, float) else value
            for value in astuple(row)
        ]
        for row in rows
    )
    write_own(file, in_csv([[field.name for field in fields(Row)], *told]))

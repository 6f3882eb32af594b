"""A budget for every number that is judged: each source of uncertainty, what it contributes, and
the expanded uncertainty they make together (GUM, JCGM 100 and 101).

The contribution of a stated source is the standard deviation of what the model says while that
source alone varies: it holds where the number does not depend on it in a straight line, as the
contrast in focus. The combined uncertainty is that of all sources drawn together; what the squares
of the contributions do not add up to is a line of its own, above or below zero.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import stats

from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.values import Values, positions
from flflab.verdict.sources import LENSES, LEVELS, Source
from flflab.whole_file import in_csv, write_own

Array = npt.NDArray[np.float64]
COVERED = 0.95
LEAST = 1e-6  # of the largest variance; what adds less has no line
PICTURES, FLOOR, LAMP = "noise of the pictures", "measurement's floor", "steadiness of the light"
APPROACH = "repeatability of stages and iris"
DRAWN_LENSES = "workmanship: lens to lens"
REMAINDER = "not in the sum (nonlinearity, finite draws)"


@dataclass(frozen=True)
class Contribution:
    """One line of a budget.

    Attributes:
        source: what is uncertain.
        group: of what it is one.
        kind: ``A`` by statistics, ``B`` by other knowledge; empty for what the sum leaves.
        distribution: of the source.
        dof: degrees of freedom.
        stated: standard uncertainty of the source as the bench file states it, in ``unit``; None
            where it comes with the number's own unit.
        unit: of ``stated``; empty for a share.
        variance: what the source adds to the number's variance, in its unit squared; that of what
            the sum leaves may be below 0.
        common: whether configurations share the error, which then cancels between them.
    """

    source: str
    group: str
    kind: str
    distribution: str
    dof: float
    stated: float | None
    unit: str
    variance: float
    common: bool

    @property
    def contribution(self) -> float:
        """Standard uncertainty of the number by this source alone; below 0 where the line takes
        away.
        """
        return math.copysign(math.sqrt(abs(self.variance)), self.variance)


@dataclass(frozen=True)
class Budget:
    """The budget of one number.

    Attributes:
        configuration: which.
        reference: the configuration it is a difference or a ratio against, or None.
        quantity: the property, as in ``comparison.csv``.
        dot: the dot it belongs to, or None.
        cycles_per_mm: the frequency it belongs to, or None.
        lines: of every source that contributes, the largest first, then what the sum leaves.
    """

    configuration: int
    reference: int | None
    quantity: str
    dot: int | None
    cycles_per_mm: float | None
    lines: tuple[Contribution, ...]

    @property
    def uncertainty(self) -> float:
        """Combined standard uncertainty."""
        return math.sqrt(max(math.fsum(line.variance for line in self.lines), 0.0))

    @property
    def dof(self) -> float:
        """Effective degrees of freedom, by Welch and Satterthwaite (JCGM 100, G.4)."""
        lost = math.fsum(line.variance**2 / line.dof for line in self.lines)
        return self.uncertainty**4 / lost if lost > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """By which the combined uncertainty covers 95 % of a t distribution."""
        upper = (1 + COVERED) / 2
        return float(stats.t.ppf(upper, self.dof) if self.dof < 1e9 else stats.norm.ppf(upper))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty, 95 %."""
        return self.coverage_factor * self.uncertainty

    def share(self, line: Contribution) -> float:
        """Share of the variance; nan where there is none."""
        whole = self.uncertainty**2
        return line.variance / whole if whole > 0 else math.nan


@dataclass(frozen=True)
class Apart:
    """What the model says while one source at a time varies, and the pictures' own noise.

    Attributes:
        sources: those that vary.
        alone: of every property, draws of a bench as described and then ``LEVELS`` of each source.
        lenses: the same properties, draws of lenses that differ; None where all are equal.
        approached: the same properties, draws of stages and iris that repeat as well as they do,
            in each configuration by itself; None where that is taken for perfect.
        approached_dof: degrees of freedom with which that was measured; infinite where it is as the
            bench file states it.
        quiet: the same properties with the noise of the pictures alone.
    """

    sources: tuple[Source, ...]
    alone: tuple[Values, ...]
    lenses: tuple[Values, ...] | None
    approached: tuple[Values, ...] | None
    approached_dof: float
    quiet: tuple[Values, ...]


Key = tuple[str, int]


def budgets(
    values: tuple[Values, ...],
    between: tuple[tuple[Values, int], ...],
    apart: Apart,
    measured: tuple[Measured, ...],
    judged: frozenset[str],
) -> tuple[Budget, ...]:
    """The budgets of every judged number, and of every difference and ratio between
    configurations.

    Args:
        values: the numbers.
        between: differences and ratios of them, each with the configuration it is against.
        apart: the same numbers, source by source.
        measured: every configuration.
        judged: the quantities that are.
    """
    found: list[Budget] = []
    for one in (one for one in values if one.quantity in judged):
        found += _of(one, None, ((one.quantity, one.configuration),), apart, measured)
    for one, reference in between:
        quantity = one.quantity.partition("_")[2]
        pair = (quantity, one.configuration), (quantity, reference)
        found += _of(one, reference, pair, apart, measured)
    return tuple(found)


def _of(
    values: Values,
    reference: int | None,
    keys: tuple[Key, ...],
    apart: Apart,
    measured: tuple[Measured, ...],
) -> list[Budget]:
    """The budgets of numbers that are made of those of one or two keys."""
    parts = _parts(apart.quiet, keys)
    quiet = _noise(values, parts)
    other = np.maximum(np.diag(values.noise) - quiet, 0.0)
    alone = _draws(values, _parts(apart.alone, keys))
    middle, varied = alone[0], alone[1:].reshape(-1, LEVELS, alone.shape[1])
    counted = values.draws.dtype.kind == "i"
    centre = middle if counted else varied.mean(axis=1, keepdims=True)
    variances = np.mean((varied - centre) ** 2, axis=1)

    def spread(draws: tuple[Values, ...] | None) -> Array | None:
        if draws is None:
            return None
        drawn = _draws(values, _parts(draws, keys))
        return np.mean((drawn - (middle if counted else drawn.mean(axis=0))) ** 2, axis=0)

    lenses, anew = spread(apart.lenses), spread(apart.approached)
    own = LAMP if values.quantity == "light" else FLOOR
    whole = values.uncertainty**2
    found: list[Budget] = []
    for k in range(len(values.measured)):
        kind = "B" if "views" in values.quantity else "A"
        freedom = (
            math.inf
            if kind == "B"
            else min(_freedom(part, values.dots[k], measured) for part in parts)
        )
        lines = [
            Contribution(PICTURES, PICTURES, kind, "normal", freedom, None, "", quiet[k], False),
            Contribution(own, own, "B", "normal", math.inf, None, "", other[k], False),
        ]
        lines += [
            Contribution(
                one.name, one.group, "B", "normal", math.inf, one.uncertainty, one.unit,
                variances[n, k], True,
            )
            for n, one in enumerate(apart.sources)
        ]  # fmt: skip
        if lenses is not None:
            lines.append(
                Contribution(
                    DRAWN_LENSES, LENSES, "B", "normal", math.inf, None, "",
                    lenses[k], True,
                )
            )  # fmt: skip
        if anew is not None:
            lines.append(
                Contribution(
                    APPROACH, APPROACH, "B" if math.isinf(apart.approached_dof) else "A", "normal",
                    apart.approached_dof, None, "", anew[k], False,
                )
            )  # fmt: skip
        least = LEAST * max(line.variance for line in lines)
        lines = sorted(
            (one for one in lines if one.variance > least), key=lambda one: -one.variance
        )
        left = whole[k] - math.fsum(line.variance for line in lines)
        lines.append(Contribution(REMAINDER, REMAINDER, "", "", math.inf, None, "", left, True))
        found.append(
            Budget(
                values.configuration, reference, values.quantity, values.dots[k],
                values.cycles_per_mm[k], tuple(lines),
            )
        )  # fmt: skip
    return found


def _parts(of: tuple[Values, ...], keys: tuple[Key, ...]) -> tuple[Values, ...]:
    by = {(one.quantity, one.configuration): one for one in of}
    return tuple(by[key] for key in keys)


def _draws(values: Values, of: tuple[Values, ...]) -> Array:
    """Draws of one list of numbers, or of differences or ratios of two."""
    one, *other = (part.draws[:, positions(values, part)].astype(np.float64) for part in of)
    if not other:
        return one
    return one / other[0] if values.quantity.startswith("ratio_") else one - other[0]


def _noise(values: Values, of: tuple[Values, ...]) -> Array:
    """Variances of the same by the noise of each part."""
    one, *other = (np.diag(part.noise)[positions(values, part)] for part in of)
    if not other:
        return one
    if values.quantity.startswith("ratio_"):
        below = of[1].measured[positions(values, of[1])]
        return (one + values.measured**2 * other[0]) / below**2
    return one + other[0]


def _freedom(values: Values, dot: int | None, measured: tuple[Measured, ...]) -> float:
    """Observations of the fit behind a number less its parameters (JCGM 100, G.3.3); of several
    fits the fewest.
    """
    one = next(one for one in measured if one.configuration.index == values.configuration)
    if values.target.startswith("bars"):
        curve = one.curves.get(values.quantity.removeprefix("ratio_"), one.curve)
        return float(max(curve.pixels - len(curve.contrast), 1)) if curve else 1.0
    if values.target == "white":
        return float(max(2 * len(one.lattice.indices) - 6, 1))
    seen = [2 * dots.views - 3 for dots in one.dots if dot is None or dots.dot == dot]
    return float(max(sum(count for count in seen if count > 0), 1))


def write_budgets(budgets: tuple[Budget, ...], file: Path) -> None:
    """Write ``budget.csv``: a line a source, with the number it belongs to and what all of them
    make.
    """
    head = (
        "configuration", "reference_configuration", "quantity", "dot", "cycles_per_mm", "source",
        "type", "distribution", "degrees_of_freedom", "stated", "stated_unit", "contribution",
        "shared_by_configurations", "share_of_variance", "combined_uncertainty",
        "effective_degrees_of_freedom", "coverage_factor", "expanded_uncertainty",
    )  # fmt: skip
    rows = [
        [
            _text(cell)
            for cell in (
                one.configuration, one.reference, one.quantity, one.dot, one.cycles_per_mm,
                line.source, line.kind, line.distribution, line.dof, line.stated,
                line.unit, line.contribution, "yes" if line.common else "no", one.share(line),
                one.uncertainty, one.dof, one.coverage_factor, one.expanded,
            )
        ]
        for one in budgets
        for line in one.lines
    ]  # fmt: skip
    write_own(file, in_csv([list(head), *rows]))


def _text(cell: object) -> object:
    return "" if cell is None else f"{cell:.6g}" if isinstance(cell, float) else cell

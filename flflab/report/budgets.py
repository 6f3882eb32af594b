"""The budgets of uncertainty in the report and in ``verdict.json``: a summary of all numbers, and,
line by line, of each quantity the number that lies farthest from the model.
"""

import math
from typing import Any

import numpy as np

from flflab.digits import two_digits
from flflab.report.quantities import UM, quantity_of
from flflab.report.tables import Table, in_words
from flflab.verdict.budget import (
    APPROACH,
    FLOOR,
    LAMP,
    PICTURES,
    REMAINDER,
    Budget,
    Contribution,
)
from flflab.verdict.evaluation import JUDGED, Evaluation
from flflab.verdict.sources import ATTITUDE, LENSES, OPTICS, ORDER, STAGES, TRACED

SMALL = {  # below how much of a unit which smaller one is read, and how many make one
    "mm": (0.1, *UM), "rad": (0.1, "mrad", 1e3), "": (1e-3, "ppm", 1e6),
}  # fmt: skip
MANY = 1e4  # degrees of freedom from which k no longer changes

GROUPS = (
    PICTURES, FLOOR, LAMP, APPROACH, STAGES, OPTICS, ATTITUDE, ORDER, LENSES, TRACED, REMAINDER,
)  # fmt: skip


def farthest(evaluation: Evaluation) -> tuple[Budget, ...]:
    """Of each judged quantity the budget of the number that lies farthest from the model, in the
    order of the verdicts.
    """
    z = {
        (row.quantity, row.configuration, row.dot, row.cycles_per_mm): abs(row.z)
        for row in evaluation.comparison.rows
        if row.reference_configuration is None
    }
    found: list[Budget] = []
    for quantities in JUDGED.values():
        for quantity in quantities:
            members = [
                one
                for one in evaluation.budgets
                if one.quantity == quantity and one.reference is None
            ]
            if members:
                found.append(max(members, key=lambda one: z.get(_key(one), 0.0)))
    return tuple(found)


def _key(one: Budget) -> tuple[str, int, int | None, float | None]:
    return one.quantity, one.configuration, one.dot, one.cycles_per_mm


def summary_table(evaluation: Evaluation) -> Table:
    """Medians over all numbers of each quantity, differences and ratios included."""
    members: dict[str, list[Budget]] = {}
    for one in evaluation.budgets:
        members.setdefault(one.quantity, []).append(one)
    shares = {
        quantity: [_median_share(of, group) for group in GROUPS] for quantity, of in members.items()
    }
    used = [n for n in range(len(GROUPS)) if any(share[n] != 0 for share in shares.values())]
    rows = [
        (
            in_words(quantity),
            two_digits(quantity_of(quantity).many * _median([one.uncertainty for one in of])),
            _freedom(min(one.dof for one in of)),
            f"{max(one.coverage_factor for one in of):.2f}",
            *(_percent(shares[quantity][n]) for n in used),
        )
        for quantity, of in members.items()
    ]
    headings = (
        "quantity", "standard uncertainty", "least degrees of freedom", "largest k (95 %)",
        *(GROUPS[n] for n in used),
    )  # fmt: skip
    return Table(
        "Where the uncertainties come from (medians; shares of the variance)",
        headings,
        tuple(rows),
    )


def _median_share(budgets: list[Budget], group: str) -> float:
    shares = [
        sum(one.share(line) for line in one.lines if line.group == group)
        for one in budgets
        if one.uncertainty > 0
    ]
    return _median(shares) if shares else 0.0


def _median(values: list[float]) -> float:
    return float(np.median(values))


def budget_tables(evaluation: Evaluation) -> tuple[Table, ...]:
    """One table a judged quantity: the budget of its number farthest from the model."""
    return tuple(_table(one) for one in farthest(evaluation))


def _table(one: Budget) -> Table:
    words, unit, many = quantity_of(one.quantity)
    place = f"configuration {one.configuration}"
    place += f", dot {one.dot}" if one.dot is not None else ""
    place += f", {one.cycles_per_mm:.3g} cycles/mm" if one.cycles_per_mm is not None else ""
    rows = [
        (
            line.source, line.kind or "-", line.distribution or "-", _freedom(line.dof),
            _stated(line),
            two_digits(many * line.contribution), "common" if line.common else "own",
            _percent(one.share(line)),
        )
        for line in one.lines
    ]  # fmt: skip
    rows.append(
        (
            "combined", "", "", _freedom(one.dof), "", two_digits(many * one.uncertainty), "",
            f"k = {one.coverage_factor:.2f}, U = {two_digits(many * one.expanded)} {unit}".strip(),
        )
    )  # fmt: skip
    headings = (
        "source", "type", "distribution", "degrees of freedom", "stated",
        f"contribution{f', {unit}' if unit else ''}", "configurations", "share of the variance",
    )  # fmt: skip
    return Table(f"{words}: {place}", headings, tuple(rows))


def _stated(line: Contribution) -> str:
    """What the bench file states, in the smaller unit where it is small: ``10 ppm``."""
    if line.stated is None:
        return "-"
    least, unit, many = SMALL.get(line.unit, (0.0, "", 0.0))
    if line.stated < least:
        return f"{many * line.stated:.3g} {unit}"
    return f"{line.stated:.3g} {line.unit}" if line.unit else f"{100 * line.stated:.3g} %"


def _freedom(dof: float) -> str:
    return f"{dof:.0f}" if dof < MANY else "infinite"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{round(100 * share, 1) + 0.0:.1f} %"


def budget_numbers(evaluation: Evaluation, name: str) -> list[dict[str, Any]]:
    """What ``verdict.json`` holds of a judged property's budgets."""
    return [
        {
            "quantity": one.quantity,
            "configuration": one.configuration,
            "dot": one.dot,
            "cycles_per_mm": one.cycles_per_mm,
            "uncertainty": one.uncertainty,
            "degrees_of_freedom": _finite(one.dof),
            "coverage_factor": one.coverage_factor,
            "expanded_uncertainty": one.expanded,
            "sources": [
                {
                    "source": line.source,
                    "type": line.kind,
                    "distribution": line.distribution,
                    "degrees_of_freedom": _finite(line.dof),
                    "stated": line.stated,
                    "stated_unit": line.unit,
                    "contribution": line.contribution,
                    "common": line.common,
                    "share": _finite(one.share(line)),
                }
                for line in one.lines
            ],
        }
        for one in farthest(evaluation)
        if one.quantity in JUDGED.get(name, ())
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

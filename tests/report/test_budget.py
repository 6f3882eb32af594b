"""Budgets of uncertainty: recomputed by hand from their sources, and by GTC, which shares no code
with them.
"""

import csv
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import GTC
import numpy as np
import pytest
from scipy.special import j1

from flflab.bench import Bench
from flflab.bench_uncertainty import (
    TargetUncertaintyDescription,
    TemperatureDescription,
    WorkmanshipDescription,
)
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms
from flflab.report.budgets import budget_tables, farthest, summary_table
from flflab.study import Study
from flflab.verdict.budget import (
    DRAWN_LENSES,
    PICTURES,
    REMAINDER,
    Budget,
    Contribution,
    write_budgets,
)
from flflab.verdict.evaluation import Evaluation, evaluate_measured

PIXEL = 6.8e-3  # mm, of the small bench's sensor


def line(source: str, kind: str, dof: float, contribution: float) -> Contribution:
    return Contribution(source, source, kind, "normal", dof, None, "", contribution**2, False)


def found(budgets: tuple[Budget, ...], quantity: str, configuration: int = 0) -> Budget:
    return next(
        one for one in budgets if one.quantity == quantity and one.configuration == configuration
    )


def by_source(budget: Budget) -> dict[str, float]:
    return {one.source: one.contribution for one in budget.lines}


@pytest.mark.parametrize(
    "parts",
    [
        [(0.3, 5.0), (0.4, math.inf), (0.1, 2.0)],
        [(1.0, 4.0), (2e-3, math.inf)],
        [(0.5, math.inf), (0.5, math.inf)],
        [(0.2, 3.0), (0.2, 3.0), (0.2, 7.0), (0.01, 1.0)],
    ],
)
def test_gtc_combines_the_sources_to_the_same_figures(parts: list[tuple[float, float]]) -> None:
    budget = Budget(
        0, None, "mtf", None, None,
        tuple(line(str(n), "A", dof, u) for n, (u, dof) in enumerate(parts)),
    )  # fmt: skip
    total: Any = sum(GTC.ureal(0.0, u, dof) for u, dof in parts)
    assert budget.uncertainty == pytest.approx(total.u, rel=1e-12)
    assert budget.dof == pytest.approx(total.df, rel=1e-9)
    factor = GTC.reporting.k_factor(total.df)
    assert budget.coverage_factor == pytest.approx(factor, rel=1e-6)
    assert budget.expanded == pytest.approx(factor * total.u, rel=1e-6)


def test_the_pitch_s_budget_is_that_of_its_formula_by_hand(
    evaluation: Evaluation, bench: Bench, study: Study
) -> None:
    setting, array = study.configurations[0], bench.optics.array
    p, length, gap = array.pitch[0], setting.array, setting.sensor - setting.array
    # P = p (1 + b/L), b from array to sensor and L from lens to array
    slopes = {
        "main_lens_stage": p * gap / length**2,
        "array_stage": -p / length - p * gap / length**2,
        "sensor_stage": p / length,
    }
    places = {"main_lens_stage": 0.0, "array_stage": setting.array, "sensor_stage": setting.sensor}
    by_hand = {PICTURES: 2e-4 * PIXEL}
    for name, slope in slopes.items():
        axis = bench.description.axes[name]
        by_hand[f"zero of {name}"] = abs(slope) * axis.zero_uncertainty
        by_hand[f"scale of {name}"] = (
            abs(slope * axis.reading(places[name])) * axis.scale_uncertainty
        )
    budget = found(evaluation.budgets, "image_pitch_mm")
    shown = by_source(budget)
    assert shown.pop(REMAINDER) ** 2 < 0.2 * budget.uncertainty**2  # of 400 draws
    assert shown == pytest.approx(
        {name: u for name, u in by_hand.items() if u > 1e-3 * max(by_hand.values())}, rel=1e-3
    )
    assert budget.uncertainty == pytest.approx(math.hypot(*by_hand.values()), rel=0.1)
    freedom = 2 * 35 - 6  # centres of 35 micro-images, six numbers of a lattice
    welch = budget.uncertainty**4 * freedom / by_hand[PICTURES] ** 4
    assert budget.dof == pytest.approx(welch, rel=1e-6)


def test_what_configurations_share_cancels_in_their_difference(evaluation: Evaluation) -> None:
    # configurations 0 and 1 differ in the f-number alone, which the pitch does not depend on
    single = by_source(found(evaluation.budgets, "image_pitch_mm"))
    difference = by_source(found(evaluation.budgets, "difference_image_pitch_mm", 0))
    assert single["zero of array_stage"] > single[PICTURES]
    assert set(difference) == {PICTURES, REMAINDER}
    assert difference[PICTURES] == pytest.approx(math.sqrt(2) * single[PICTURES])
    assert abs(difference[REMAINDER]) < 1e-3 * difference[PICTURES]
    # the bright field's width does depend on it, so some of the common error is left
    field = by_source(found(evaluation.budgets, "difference_bright_field_mm", 0))
    assert field["zero of array_stage"] > 0


@pytest.fixture(scope="module")
def traced(evaluation: Evaluation, bench: Bench, lenient: Study) -> Evaluation:
    """The same run on a bench with certificates of its targets, a temperature and workmanship."""
    update: dict[str, Any] = {
        "target_uncertainty": TargetUncertaintyDescription.model_validate(
            {"dot_spacing": "5 %", "bar_frequency": "0.1 %"}
        ),
        "temperature": TemperatureDescription.model_validate(
            {"uncertainty": "2 K", "expansion": "23e-6 1/K"}
        ),
        "workmanship": WorkmanshipDescription.model_validate(
            {"microlens_position": "0.3 um", "scale": "1e-5"}
        ),
    }
    described = replace(bench, description=bench.description.model_copy(update=update))
    return evaluate_measured(evaluation.measured, lenient, described)


def test_a_warmer_bench_is_longer_which_moves_depths_and_no_pitch(
    traced: Evaluation, study: Study
) -> None:
    warmth = "expansion by temperature"
    assert warmth not in by_source(found(traced.budgets, "image_pitch_mm"))
    # D' = L/(L/D - s L/F) where all lengths but focal ones are 1 + s times as long
    away = study.configurations[0].distance
    depth = by_source(found(traced.budgets, "dot_distance_mm"))[warmth]
    assert depth == pytest.approx(away**2 / 50.0 * 2 * 23e-6, rel=5e-3)


def test_workmanship_moves_the_pitch_as_a_whole_and_lens_by_lens(
    traced: Evaluation, bench: Bench, study: Study
) -> None:
    setting, array = study.configurations[0], bench.optics.array
    pitch = array.pitch[0] * setting.sensor / setting.array
    shown = by_source(found(traced.budgets, "image_pitch_mm"))
    assert shown["workmanship: scale of the array"] == pytest.approx(1e-5 * pitch, rel=1e-3)
    # the slope of a line through places that scatter, of the lenses whose images are on the sensor
    columns, rows = (
        np.arange(-half, half + 1) * array.pitch[0]
        for half in (np.array([420, 300]) * PIXEL / 2 // pitch).astype(int)
    )
    spread = math.sqrt(len(rows) * float(np.sum(columns**2)))
    assert shown[DRAWN_LENSES] == pytest.approx(3e-4 / spread * pitch, rel=0.15)  # of 200 draws


def test_the_bars_certificate_moves_contrast_along_its_curve(traced: Evaluation) -> None:
    model = traced.predicted[0]
    smms = central_smms(model.camera)
    scale = PIXEL / float(magnification(smms, 1 / model.distance))

    def contrast(cycles_per_mm: float) -> float:
        u, z = cycles_per_mm * scale, math.pi * cycles_per_mm * scale * model.blur_px
        return float(np.sinc(u) * 2 * j1(z) / z)

    for budget in traced.budgets:
        if budget.quantity == "mtf" and budget.configuration == 0 and budget.cycles_per_mm:
            nu = budget.cycles_per_mm
            moved = abs(contrast(nu * 1.001) - contrast(nu * 0.999)) / 2
            shown = by_source(budget)["frequencies of the bars (certificate)"]
            assert shown == pytest.approx(moved, rel=0.01)


def test_the_dots_certificate_moves_counts_of_views_and_nothing_else(traced: Evaluation) -> None:
    moved = {
        budget.quantity
        for budget in traced.budgets
        if "spacing of the dots (certificate)" in by_source(budget)
    }
    assert "views" in moved
    assert moved <= {"views", "difference_views"}


def test_budget_csv_has_a_line_a_source_and_its_variances_add_up(
    evaluation: Evaluation, tmp_path: Path
) -> None:
    write_budgets(evaluation.budgets, tmp_path / "budget.csv")
    with (tmp_path / "budget.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(one.lines) for one in evaluation.budgets)
    place = ("configuration", "reference_configuration", "quantity", "dot", "cycles_per_mm")
    sums: dict[tuple[str, ...], float] = {}
    for row in rows:
        u = float(row["contribution"])
        key = (*(row[name] for name in place), row["combined_uncertainty"])
        sums[key] = sums.get(key, 0.0) + math.copysign(u * u, u)
    assert all(
        math.sqrt(max(total, 0.0)) == pytest.approx(float(key[-1]), rel=1e-4)
        for key, total in sums.items()
    )


def test_the_report_shows_the_budget_of_the_number_farthest_from_the_model(
    evaluation: Evaluation,
) -> None:
    rows = tuple(
        replace(row, z=-7.0)
        if (row.quantity, row.configuration, row.dot) == ("views", 2, 3)
        else row
        for row in evaluation.comparison.rows
    )
    worse = replace(evaluation, comparison=replace(evaluation.comparison, rows=rows))
    chosen = {one.quantity: one for one in farthest(worse)}
    assert (chosen["views"].configuration, chosen["views"].dot) == (2, 3)
    captions = [table.caption for table in budget_tables(worse)]
    assert "number of views: configuration 2, dot 3" in captions
    pitch = next(row for row in summary_table(worse).rows if row[0].startswith("pitch of"))
    shares = [float(cell.removesuffix(" %")) for cell in pitch[4:]]
    assert sum(shares) == pytest.approx(100, abs=15)  # medians of shares


def test_every_uncertainty_of_a_budget_has_two_significant_digits(evaluation: Evaluation) -> None:
    cells = [row[1] for row in summary_table(evaluation).rows]
    for table in budget_tables(evaluation):
        cells += [row[5] for row in table.rows]
        cells += [table.rows[-1][-1].split("U = ")[1].split()[0]]
    digits = [
        re.sub(r"e.*", "", cell).lstrip("-0.").replace(".", "") for cell in cells if cell != "0"
    ]
    assert [one for one in digits if len(one.rstrip("0")) > 2 or len(one) < 2] == []


@pytest.mark.parametrize(
    ("stated", "unit", "shown"),
    [
        (1e-3, "mm", "1 µm"),
        (0.5, "mm", "0.5 mm"),
        (5e-4, "rad", "0.5 mrad"),
        (1e-5, "", "10 ppm"),
        (0.02, "", "2 %"),
    ],
)
def test_what_the_bench_file_states_is_shown_in_a_unit_of_its_size(
    evaluation: Evaluation, stated: float, unit: str, shown: str
) -> None:
    chosen = farthest(evaluation)[0]
    one = replace(chosen.lines[0], stated=stated, unit=unit)
    alone = replace(evaluation, budgets=(replace(chosen, lines=(one,)),))
    assert budget_tables(alone)[0].rows[0][4] == shown

"""What a bench file states of lenses and floor widens the comparison where it must, and is named in
the table of where uncertainties come from.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.bench import Bench
from flflab.bench_uncertainty import MeasurementFloorDescription, WorkmanshipDescription
from flflab.study import Study
from flflab.verdict.budget import FLOOR
from flflab.verdict.evaluation import Evaluation, evaluate_measured
from flflab.verdict.sources import LENSES

CONFIGURATIONS = [{"f_number": 4, "distance": ["500 mm", "507 mm"], "focused_at": "507 mm"}]


@pytest.fixture(scope="module")
def evaluations(
    one_bench: Callable[..., Evaluation],
    small_bench: Bench,
    small_study: Callable[[list[dict[str, Any]]], Study],
) -> tuple[Evaluation, Evaluation]:
    """One bench as it is, and the same pictures of one that states lenses and floor."""
    plain = one_bench(0, configurations=CONFIGURATIONS)
    made = WorkmanshipDescription.model_validate(
        {
            "microlens_position": "0.3 um",
            "aperture_decentre": "0.2 um",
            "microlens_focal_length": "0.5 %",
            "scale": 1e-5,
        }
    )
    floor = MeasurementFloorDescription.model_validate(
        {"contrast": 0.002, "position": "0.02 px", "radius": "0.05 px"}
    )
    description = small_bench.description.model_copy(
        update={"workmanship": made, "measurement_floor": floor}
    )
    bench = replace(small_bench, description=description)
    return plain, evaluate_measured(plain.measured, small_study(CONFIGURATIONS), bench, 0)


def quantities_with(evaluation: Evaluation, group: str) -> set[str]:
    """The quantities in whose budgets a group of sources has a line."""
    return {
        one.quantity
        for one in evaluation.budgets
        for line in one.lines
        if line.group == group and one.reference is None
    }


@pytest.mark.ci
def test_every_part_that_is_stated_has_its_lines_and_what_is_not_has_none(
    evaluations: tuple[Evaluation, Evaluation],
) -> None:
    plain, stated = (
        {
            group: {
                one.quantity for one in found.budgets for line in one.lines if line.group == group
            }
            for group in (FLOOR, LENSES)
        }
        for found in evaluations
    )
    assert plain == {FLOOR: set(), LENSES: set()}
    assert len(stated[FLOOR]) >= 6
    assert len(stated[LENSES]) >= 5
    # the lenses are the same in every configuration, the floor of a frame is its own
    for one in evaluations[1].budgets:
        for line in one.lines:
            assert line.common == (line.group != FLOOR) or line.group not in (FLOOR, LENSES)


@pytest.mark.ci
def test_uncertainties_grow_by_what_is_stated_and_measured_numbers_stay(
    evaluations: tuple[Evaluation, Evaluation],
) -> None:
    plain, stated = evaluations
    for before, after in zip(plain.values, stated.values, strict=True):
        assert before.quantity == after.quantity
        assert after.measured == pytest.approx(before.measured, rel=1e-6)
        floor = np.diag(after.noise) - np.diag(before.noise)
        assert np.all(floor > -1e-12 * np.diag(before.noise))
        if after.quantity == "mtf":
            assert floor == pytest.approx(np.full(len(floor), 4e-6 * (1 + 0.2**2)), rel=1e-6)
            # in focus and out, lenses of many focal lengths blur
            assert np.all(after.expected <= before.expected + 1e-3)
        if after.quantity == "bright_field_mm":
            assert floor == pytest.approx((2 * 0.05 * 0.00166) ** 2, rel=1e-6)
        if after.quantity == "dot_distance_mm":
            assert np.all(after.uncertainty > before.uncertainty)
    assert stated.comparison.accepted

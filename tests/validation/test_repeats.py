"""Benches whose stages repeat five times worse than their file says, every picture approached anew:
the verdict on an honest camera stays honest where settings are repeated, and says so.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from flflab.bench import Bench
from flflab.bench_uncertainty import RepeatabilityDescription
from flflab.study import Study
from flflab.verdict.evaluation import Evaluation, evaluate_measured

SETTINGS: list[dict[str, Any]] = [{"f_number": [2.8, 4], "distance": "507 mm"}]
STATED, TRUE = 1e-3, 5e-3  # mm


@pytest.mark.full
@pytest.mark.parametrize("seed", range(2))
def test_an_honest_camera_is_accepted_on_stages_that_repeat_worse_than_stated(
    seed: int,
    one_bench: Callable[..., Evaluation],
    small_bench: Bench,
    small_study: Callable[[list[dict[str, Any]]], Study],
) -> None:
    found = one_bench(seed, configurations=SETTINGS, repeats=5, approach=(STATED, TRUE))
    assert found.comparison.accepted
    assert found.repeats is not None
    assert found.repeats.stages == pytest.approx(TRUE, rel=0.5)
    assert found.repeats.stages_used > 3 * STATED
    assert "1 um is stated" in found.repeats.sentences[0]
    # taken once, what is stated is all there is, and the camera is blamed
    stated = RepeatabilityDescription.model_validate({"stages": f"{STATED} mm"})
    update = {"repeatability": stated}
    bench = replace(small_bench, description=small_bench.description.model_copy(update=update))
    once = evaluate_measured(found.measured, small_study(SETTINGS), bench, seed)
    assert not once.comparison.accepted
    assert once.repeats is None

"""What a plan expects of the MTF's uncertainty against what benches with hidden errors of their own
have.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flflab.bench import Bench
from flflab.study import Study
from flflab.verdict.evaluation import Evaluation
from flflab.verdict.expectation import expect


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "f_number",
    [pytest.param(2.8, marks=pytest.mark.full), pytest.param(4.0, marks=pytest.mark.full)],
)
def test_in_focus_a_plan_expects_what_benches_have(
    one_bench: Callable[..., Evaluation],
    small_bench: Bench,
    small_study: Callable[[list[dict[str, Any]]], Study],
    f_number: float,
) -> None:
    """In exact focus, where it used to put the bench, it said 0.0046 at F/2.8."""
    settings = [{"f_number": f_number, "distance": "507 mm"}]
    curves = [one_bench(seed, configurations=settings).measured[0].curve for seed in range(3)]
    had = float(np.median([curve.uncertainty.max() for curve in curves if curve]))
    study = small_study(settings)
    expected = expect(study.configurations[0], study, small_bench).looks[0]
    assert expected.frames == 1
    assert 0.5 < expected.uncertainty / had < 2.0

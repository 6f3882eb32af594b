"""``flflab plan``: what it prints and what it refuses; nothing connects."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]
FULL = Path(__file__).parents[2] / "examples" / "benches" / "full.yaml"


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("yaw: 12 deg", "rotation_stage would have to go to 12.0000 deg, outside its limits, -10 deg to 10 deg; nothing moved"),
        ("main_lens: 20 mm", "main_lens_stage would have to go to 30.0000 mm, outside its limits, 0 mm to 25 mm; nothing moved"),
        ("sensor: 60.2 mm", "at least 0.3 mm"),
    ],
)
def test_a_plan_out_of_reach_ends_in_one_sentence(asked: str, says: str, flflab: Run, tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(f"name: far\nconfigurations: [{{f_number: 4, distance: 507 mm, {asked}}}]\n", encoding="utf-8")
    ended = flflab("plan", study, "--bench", FULL)
    assert (ended.code, ended.out) == (1, "")
    assert ended.err.startswith("flflab: configuration 0: ")
    assert says in ended.err
    assert ended.err.count("\n") == 1

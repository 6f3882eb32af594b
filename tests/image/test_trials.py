"""The trials of the promise that lie beside their benchmark: the file that docs/pictures-trials.md
cites says what is said of it there.
"""

import csv
from dataclasses import fields
from pathlib import Path

import pytest

from flflab.image.promise import Trial

TRIALS = Path(__file__).parents[2] / "benchmarks"
NAMES = [field.name for field in fields(Trial)]


def trials_in(name: str) -> list[Trial]:
    """All but those given up."""
    with (TRIALS / name).open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert all(list(row) == NAMES for row in rows)
    return [
        Trial(int(row["seed"]), *(float(row[key]) for key in NAMES[1:]))
        for row in rows
        if row["asked"] != "nan"
    ]


@pytest.mark.parametrize("name", ["promise_trials.csv", "promise_trials_before.csv"])
def test_files_of_trials_can_be_gone_on_with(name: str) -> None:
    """They hold every figure of a trial, each scene once."""
    seeds = [trial.seed for trial in trials_in(name)]
    assert len(set(seeds)) == len(seeds) > 800


def test_no_scene_in_the_file_breaks_the_promise() -> None:
    trials = trials_in("promise_trials.csv")
    assert [trial.seed for trial in trials if not trial.kept] == []
    telling = [trial for trial in trials if trial.telling]
    assert sum(trial.estimated <= 5 * trial.achieved for trial in telling) >= 0.95 * len(telling)

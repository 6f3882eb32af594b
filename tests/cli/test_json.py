"""``--json``: one object a command, with null where a number is not finite."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from flflab.alignment import Outcome
from flflab.bench import read_bench
from flflab.cli.aligned import turned, zero_of
from flflab.cli.as_json import plain

Run = Callable[..., Any]


@dataclass(frozen=True)
class Found:
    value: float
    where: Path
    parts: tuple[float, ...]


def test_results_are_plain_json_without_nan() -> None:
    found = plain({1: Found(math.nan, Path("a/b"), (math.inf, 2.0)), "n": np.float64(0.5)})
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        "1": {"value": None, "where": "a/b", "parts": [None, 2.0]},
        "n": 0.5,
    }


def test_the_zero_of_an_alignment_makes_its_reading_the_angle_that_is_left(root: Path) -> None:
    bench = read_bench(root / "examples" / "benches" / "full.yaml")
    one = Outcome(
        "yaw",
        "rotation_stage",
        0.02,
        0.001,
        1e-4,
        0.015,
        3,
        "close enough",
    )
    overlap = Outcome("overlap", "sensor_stage", 0.02, 0.0, 1e-4, 18.0, 3, "close enough")
    assert turned((one, overlap)) == [one]
    axis = bench.description.axes["rotation_stage"]
    assert zero_of(one, bench) + axis.sign * one.reading == pytest.approx(one.after)


@pytest.mark.ci
@pytest.mark.timeout(400)
def test_sweep_and_where_print_one_object(
    flflab: Run, root: Path, small_camera: Path, tmp_path: Path
) -> None:
    bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text())
    bench["optics"] = str(small_camera)
    bench["simulated"] |= {"clock": 1000}
    for axis in bench["axes"].values():
        axis["timeout"] = 5
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False))
    (tmp_path / "study.yaml").write_text(
        "name: near\nconfigurations: [{f_number: 4, distance: 507 mm}]\ntargets: [dots]\n"
    )
    swept = flflab(
        "sweep", tmp_path / "study.yaml", "--bench", tmp_path / "bench.yaml", "--json",
        "--out", tmp_path / "run",
    )  # fmt: skip
    assert swept.code == 0, swept.err
    assert swept.json == {
        "run": str(tmp_path / "run"), "study": "near", "complete": True, "frames": 3,
        "configurations": 1, "accuracy": [],
    }  # fmt: skip
    stood = flflab("bench", "where", "--bench", tmp_path / "bench.yaml", "--json").json
    assert stood["driven_by_a_program"] is False
    assert stood["axes"]["array_stage"] == {
        "reading": None, "moving": False, "unit": "mm", "limits": [0.0, 50.0], "moves": "array.z",
        "world": None,
    }  # fmt: skip

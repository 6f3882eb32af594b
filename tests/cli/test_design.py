"""``flflab design`` as a user starts it."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from flflab.cli.design import design
from flflab.errors import InputError
from flflab.files.camera import read_camera


@pytest.fixture
def asked(root: Path, tmp_path: Path) -> Callable[..., Path]:
    def make(**sections: Any) -> Path:
        given = yaml.safe_load(
            (root / "examples/requirements/osinski.yaml").read_text(encoding="utf-8")
        )
        file = tmp_path / "asked.yaml"
        given["search"] = {"configurations": 40000, "focus_steps": 9, "epsilon": "1 %"}
        file.write_text(yaml.safe_dump(given | sections), encoding="utf-8")
        return file

    return make


@pytest.mark.full
def test_it_leaves_a_page_a_table_and_camera_files(
    asked: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    design(asked(maximise=["elr", "light"]), out, json=True)
    said = json.loads(capsys.readouterr().out)
    assert said["met"] >= len(said["front"]) > 0
    assert [option["name"] for option in said["named"]] == ["most elr", "most light", "balanced"]
    with (out / "front.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(said["named"]) + len(said["front"])
    cameras = sorted((out / "cameras").glob("*.yaml"))
    assert len(cameras) == len(rows)
    balanced = read_camera(out / "cameras" / "balanced.yaml")
    assert balanced.sensor.distance == pytest.approx(said["named"][-1]["sensor_mm"], abs=1e-6)
    page = (out / "design.html").read_text(encoding="utf-8")
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "<th>elr, px</th>" in page
    assert "<th>marginal angle, deg</th>" in page
    assert "<li>at least 2 views</li>" in page
    assert "<th>gap ± 10 um</th><th>tilt ± 0.1 deg</th>" in page.replace("\N{NO-BREAK SPACE}", " ")
    design(
        asked(maximise=["elr", "light"]), out, json=True
    )  # the log says that all is done already
    assert json.loads(capsys.readouterr().out) == said


def test_what_clashes_is_said_with_numbers(asked: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=(
            r"closest: blur .* px instead of at most 3 px; .* closest: resolution .* um instead of"
            r" at most 50 um"
        ),
    ):
        design(
            asked(require={"views": 2, "blur_px": 3, "resolution": "50 um"}, maximise=["area"]),
            tmp_path / "out",
        )
    with pytest.raises(
        InputError,
        match=(
            r"at least two clash: .* blur \(.* px, asked 0.1 px\) and width \(.* mm, asked 15 mm\)"
        ),
    ):
        design(
            asked(require={"views": 9, "blur_px": 0.1, "resolution": "30 um"}, maximise=["area"]),
            tmp_path / "other",
        )

import csv
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from flflab.cli import main

CONTRACT = {
    "frame",
    "points",
    "measured_median",
    "predicted_median",
    "measured_total",
    "predicted_total",
    "virtual_depth_measured",
    "virtual_depth_predicted",
}


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Exit code of ``flflab compare`` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["flflab", "compare", *map(str, arguments)])
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def as_json(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return json.loads(capsys.readouterr().out)


def test_json_has_the_keys_of_the_contract(
    noisy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, noisy, "--camera", noisy / "camera.yaml", "--json") == 0
    found = as_json(capsys)
    assert [frame["frame"] for frame in found["frames"]] == [0, 1, 3, 4]
    assert all(set(frame) >= CONTRACT for frame in found["frames"])
    assert all(frame["points"] == 20 for frame in found["frames"])
    assert [frame["tilt_deg"] for frame in found["frames"]] == pytest.approx(
        [5.0, 26.8, 5.4, 40.0], abs=0.1
    )
    assert found["frames_without_observations"] == [2]
    assert (
        sum(frame["measured_total"] for frame in found["frames"])
        == len((noisy / "observations.csv").read_text().splitlines()) - 1
    )


def test_the_table_says_what_agrees_and_what_is_absent(
    noisy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, noisy, "--camera", noisy / "camera.yaml") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "after one rotation of all poses against the camera, +1" in said
    assert "None of " in said
    assert "lies within 10 % or one view of the measured one in every frame." in said
    assert "Which views are used decides" in said
    assert "Refit of L and b alone to the parallax of 80 points" in said
    assert "Without observations: frame 2." in said


def test_out_leaves_json_table_and_figure(
    noisy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "folder"
    assert run(monkeypatch, noisy, "--camera", noisy / "camera.yaml", "--json", "--out", out) == 0
    assert json.loads((out / "compare.json").read_text()) == as_json(capsys)
    assert (out / "compare.png").read_bytes().startswith(b"\x89PNG")
    with (out / "compare.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == 80
    assert {
        "frame",
        "point",
        "distance_mm",
        "views_measured",
        "views_predicted",
        "views_expected",
    } <= set(rows[0])


def test_without_parallax_there_is_no_refit_and_the_reason_is_said(
    noisy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (noisy / "observations.csv").read_text().splitlines()
    one_each = list({line.split(",", 5)[5]: line for line in lines[1:]}.values())
    for name in ("poses.json", "camera.json"):
        (tmp_path / name).write_text((noisy / name).read_text())
    (tmp_path / "observations.csv").write_text("\n".join([lines[0], *one_each]) + "\n")
    out = tmp_path / "out"
    assert (
        run(monkeypatch, tmp_path, "--camera", noisy / "camera.yaml", "--json", "--out", out) == 0
    )
    found = as_json(capsys)
    assert found["refit"] is None
    assert found["frames"][0]["virtual_depth_measured"] is None
    assert any(
        "There is no refit: refit of L and b: 0 points" in sentence
        for sentence in found["sentences"]
    )
    assert any("no point is seen often enough" in sentence for sentence in found["sentences"])


def test_a_camera_whose_distances_are_wrong_is_seen_in_the_depths_and_mended_by_the_refit(
    noisy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(
        (noisy / "camera.yaml").read_text().replace("distance: 57.1 mm", "distance: 57.2 mm")
    )
    assert run(monkeypatch, noisy, "--camera", wrong, "--json") == 0
    found = as_json(capsys)["virtual_depth_deviation"]
    assert found["described"] > 0.1
    assert found["refit"] < 0.03


def test_bad_input_ends_with_one_sentence_and_exit_code_one(
    noisy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, tmp_path, "--camera", noisy / "camera.yaml") == 1
    said = capsys.readouterr().err
    assert said.startswith("flflab: ")
    assert "camera.json" in said
    assert "Traceback" not in said
    (tmp_path / "file").write_text("")
    assert (
        run(monkeypatch, noisy, "--camera", noisy / "camera.yaml", "--out", tmp_path / "file") == 1
    )
    assert capsys.readouterr().err.endswith(
        f"--out {tmp_path / 'file'}: the folder cannot be made (File exists); give another\n"
    )

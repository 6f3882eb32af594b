"""The main job from end to end on a small simulated bench: an honest one is accepted, a wrong one
is found out.
"""

import csv
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import flflab as ff

Run = Callable[..., Any]
EXAMPLES = Path(__file__).parents[2] / "examples"
STUDY = """name: small
configurations:
  - {f_number: [2.8, 4], distance: 507 mm}
dots: {kind: four-dot, diameter: 1 mm, spacing: 4 mm}
bars: {kind: bars, cycles_per_mm: [0.5, 10], width: 12 mm, height: 8 mm}
draws: 450
reference: 0
"""
TARGETS = "{four-dot: {diameter: 1 mm, spacing: 4 mm}, bars: {width: 12 mm, height: 8 mm}}"


@pytest.fixture
def small_bench(small_camera: Path, tmp_path: Path) -> Callable[..., Path]:
    def write(truths: str = "{}", seed: int = 1) -> Path:
        text = (EXAMPLES / "benches" / "simulated.yaml").read_text(encoding="utf-8")
        for old, new in (
            ("optics: ../cameras/osinski.yaml", f"optics: {small_camera.name}"),
            ("truths: {} ", f"truths: {truths} "),
            ("targets: {} ", f"targets: {TARGETS} "), ("seed: 1", f"seed: {seed}"),
            ("clock: 20 ", "clock: 100 "),
        ):  # fmt: skip
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "bench.yaml"
        file.write_text(text, encoding="utf-8")
        return file

    return write


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "study.yaml"
    file.write_text(STUDY, encoding="utf-8")
    return file


@pytest.mark.full
@pytest.mark.timeout(300)
def test_an_honest_bench_is_accepted_and_leaves_its_files(
    flflab: Run,
    small_bench: Callable[..., Path],
    study: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    out = tmp_path / "run"
    ended = flflab("validate", study, "--bench", small_bench(), "--out", out)
    assert ended.code == 0, ended.err
    assert "The camera does what its model says." in ended.out
    assert "p-value" in ended.out
    assert "properties share the level of" in " ".join(ended.out.split())
    assert re.search(
        r"^\d+/\d+(?:, ~\d+ (?:s|min) left)?: configuration 0, white, frame 0:"
        r" exposure [\d.]+ ms$",
        ended.err,
        re.M,
    )
    assert ended.err.endswith("all recorded; measuring and comparing\n")
    assert {"report.html", "verdict.json", "comparison.csv", "documents.jsonl", "frames.h5"} <= {
        file.name for file in out.iterdir()
    }
    with (out / "comparison.csv").open(encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    columns = (
        "configuration reference_configuration distance_mm array_mm sensor_mm f_number target dot"
        " cycles_per_mm quantity"
    )
    assert list(rows[0]) == [
        *columns.split(),
        "measured",
        "uncertainty",
        "predicted",
        "difference",
        "z",
    ]
    properties = {
        "views",
        "bright_field_mm",
        "total_field_mm",
        "image_pitch_mm",
        "overlap_mm",
        "elr_row_px",
        "dot_distance_mm",
    }
    properties |= {f"array_{turn}_mrad" for turn in ("roll", "yaw", "pitch")}
    properties |= {"dot_scale", "bar_scale", "target_roll_mrad"}
    due = (
        {"mtf", "ratio_mtf", "contrast_paper", "light"}
        | properties
        | {f"difference_{name}" for name in properties}
    )
    assert {row["quantity"] for row in rows} == due
    views = [row for row in rows if row["quantity"] == "views"]
    assert [row["measured"] for row in views] == [row["predicted"] for row in views]
    again = flflab("validate", study, "--bench", small_bench(), "--out", out)
    assert (again.code, "never overwritten" in again.err) == (1, True)
    before = (out / "comparison.csv").read_bytes()
    with monkeypatch.context() as terminal:
        terminal.setenv("FORCE_COLOR", "1")
        shown = flflab("report", out)
    assert shown.code == 0
    assert re.search(r"2/2.*compare with the model", shown.err)  # configurations
    assert (out / "comparison.csv").read_bytes() == before
    other = small_bench()
    other.write_text(
        other.read_text(encoding="utf-8").replace("zero: 40 mm", "zero: 40.02 mm"), encoding="utf-8"
    )
    against = flflab("report", out, "--bench", other)
    assert against.code == 3
    # 20 um of the file's and what this seed's stages are off by themselves
    assert re.search(
        r"Zero of array_stage \(0\.02[0-3]\d* ± [\d.]+\) mm less far along z than described",
        " ".join(against.out.split()),
    )
    assert (out / "report-bench.html").exists()
    assert (out / "comparison.csv").read_bytes() == before
    names = {one.name for one in out.iterdir()}
    elsewhere = flflab("report", out, "--out", tmp_path / "else" / "where")
    assert elsewhere.code == 0
    assert {one.name for one in out.iterdir()} == names
    assert (tmp_path / "else" / "where" / "comparison.csv").read_bytes() == before
    assert (tmp_path / "else" / "where" / "report.html").exists()
    script = [sys.executable, str(EXAMPLES / "scripts" / "look_at_a_run.py"), str(out)]
    looked = subprocess.run(
        script, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert looked.returncode == 0, looked.stderr
    assert "run: small" in looked.stdout
    assert "complete" in looked.stdout
    assert looked.stdout.count("/white/") == 2
    assert (out / "look.png").exists()
    # a record of before frames were checked for motion gives the same numbers
    old = as_recorded(out, tmp_path / "old", changed={})
    reported = flflab("report", old)
    assert reported.code == 0
    assert "All " in reported.out
    assert (old / "comparison.csv").read_bytes() == before
    # a saturated frame is not judged, and its configuration has no other
    bad = as_recorded(out, tmp_path / "bad", changed={"c1/bars/0": {"saturated": 100_000}})
    reported = flflab("report", bad)
    said = " ".join(reported.out.split())
    assert re.search(r"not used: 1 diagnostic: saturated \(\S+ % of its pixels, 1 % are", said)
    with (bad / "comparison.csv").open(encoding="utf-8") as handle:
        assert {row["configuration"] for row in csv.DictReader(handle)} == {"0"}
    found = json.loads((bad / "verdict.json").read_text(encoding="utf-8"))["frames"]
    assert (found["diagnostic"], found["unvalidated"]) == (1, 0)
    assert found["not_used"][0]["point"] == "c1/bars/0"


@pytest.mark.full
@pytest.mark.timeout(600)
def test_stages_that_repeat_worse_than_stated_are_found_by_a_study_that_repeats(
    flflab: Run, small_bench: Callable[..., Path], study: Path, tmp_path: Path
) -> None:
    bench = small_bench(truths="{repeatability.stages: 5 um}")
    text = bench.read_text(encoding="utf-8")
    bench.write_text(text + "repeatability: {stages: 1 um}\n", encoding="utf-8")
    text = study.read_text(encoding="utf-8")
    study.write_text(text + "repeats: 4\nreapproach: true\n", encoding="utf-8")
    ended = flflab("validate", study, "--bench", bench, "--out", tmp_path / "run")
    said = " ".join(ended.out.split())
    assert ended.code == 0, said
    assert re.search(
        r"Stages and iris repeat to [2-9]\S* um \(12 degrees of freedom\), 1 um is", said
    )
    found = json.loads((tmp_path / "run" / "verdict.json").read_text(encoding="utf-8"))
    assert found["configurations"] == 2
    assert found["frames"]["admitted"] >= 2 * 4 * 3
    assert found["repeats"]["stages_stated_mm"] == 1e-3
    assert 2.5e-3 < found["repeats"]["stages_used_mm"] < 9e-3
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Stages and iris repeat to" in page
    with (tmp_path / "run" / "budget.csv").open(encoding="utf-8") as handle:
        kinds = {
            row["type"]
            for row in csv.DictReader(handle)
            if row["source"] == "repeatability of stages and iris"
        }
    assert kinds == {"A"}


def as_recorded(run: Path, to: Path, changed: dict[str, dict[str, Any]]) -> Path:
    """A copy of a run as an older version recorded it, with other facts of some points."""
    shutil.copytree(run, to)
    (to / "SHA256SUMS").unlink()
    file = to / "documents.jsonl"
    documents = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    for one in documents:
        one["doc"].pop("record_schema", None)
        data = one["doc"].get("data", {})
        if one["name"] == "event":
            data.pop("moved_steps")
            data |= changed.get(data["point"], {})
    file.write_text("".join(json.dumps(one) + "\n" for one in documents), encoding="utf-8")
    return to


@pytest.mark.ci
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("truths", "named", "larger"),
    [
        ("{microlens_array.focal_length: 0.935 mm}", "Focal length of the microlenses", 1.963),
        pytest.param(
            "{iris.scale: 0.04}",
            "Aperture of the main lens (its f-number changes inversely)",
            3.846,
            marks=pytest.mark.full,
        ),
    ],
)
def test_a_wrong_microlens_or_iris_is_found_out_and_named(
    flflab: Run,
    small_bench: Callable[..., Path],
    study: Path,
    tmp_path: Path,
    truths: str,
    named: str,
    larger: float,
) -> None:
    ended = flflab("validate", study, "--bench", small_bench(truths), "--out", tmp_path / "run")
    assert ended.code == 3, ended.err
    assert "The camera does not do what its model says." in ended.out
    size = re.search(rf"{re.escape(named)} \((\d+\.\d+)", " ".join(ended.out.split()))
    assert size
    assert float(size[1]) == pytest.approx(larger, abs=0.05)


@pytest.mark.ci
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("shown", "judged", "left_out"),
    [
        pytest.param("bars", ("contrast", "noise of the camera"), "views", id="bars twice"),
        pytest.param("dots", ("number of views",), "contrast", id="dots", marks=pytest.mark.full),
    ],
)
def test_a_study_of_one_target_is_judged_by_what_it_shows(
    flflab: Run,
    small_bench: Callable[..., Path],
    study: Path,
    tmp_path: Path,
    shown: str,
    judged: tuple[str, ...],
    left_out: str,
) -> None:
    twice = "exposure: {frames: 2}\n" if shown == "bars" else ""
    study.write_text(STUDY + f"targets: [{shown}]\n{twice}", encoding="utf-8")
    ended = flflab("validate", study, "--bench", small_bench(), "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    verdicts = ended.out[ended.out.index("Verdicts") :]
    assert all(name in verdicts for name in judged)
    assert left_out not in verdicts
    assert (tmp_path / "run" / "report.html").exists()


@pytest.mark.full
@pytest.mark.timeout(300)
def test_a_script_validates_as_the_command_does(
    small_bench: Callable[..., Path], study: Path, tmp_path: Path
) -> None:
    found = ff.validate(study, small_bench(), out=tmp_path / "run")
    assert found.accepted
    assert found.run.complete
    assert found.page == tmp_path / "run" / "report.html"
    assert found.page.exists()
    with (tmp_path / "run" / "comparison.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.evaluation.comparison.rows)

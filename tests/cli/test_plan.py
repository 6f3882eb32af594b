"""``flflab plan``: what it prints and what it refuses; nothing connects."""

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from flflab.bench import read_bench
from flflab.built_in import Kind, built_in, simulated_bench
from flflab.cli.planned import expected_table
from flflab.measurement.sequential import Look
from flflab.study import read_study
from flflab.verdict.expectation import Expectation

Run = Callable[..., Any]
FULL = Path(__file__).parents[2] / "examples" / "benches" / "full.yaml"


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (
            "yaw: 12 deg",
            (
                "rotation_stage would have to go to 12.0000 deg, outside its limits, -10 deg to 10"
                " deg: array.yaw at 12 deg is due, it reaches -10 deg to 10 deg; nothing moved"
            ),
        ),
        (
            "main_lens: 20 mm",
            (
                "main_lens_stage would have to go to 30.0000 mm, outside its limits, 0 mm to 25 mm:"
                " main_lens.z at 20 mm is due, it reaches -10 mm to 15 mm; nothing moved"
            ),
        ),
        ("sensor: 60.2 mm", "at least 0.3 mm"),
    ],
)
def test_a_plan_out_of_reach_ends_in_one_sentence(
    asked: str, says: str, flflab: Run, tmp_path: Path
) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(
        f"name: far\nconfigurations: [{{f_number: 4, distance: 507 mm, {asked}}}]\n",
        encoding="utf-8",
    )
    ended = flflab("plan", study, "--bench", FULL)
    assert (ended.code, ended.out) == (1, "")
    assert ended.err.startswith("flflab: configuration 0: ")
    assert says in ended.err
    assert ended.err.count("\n") == 1


@pytest.mark.parametrize(
    ("here", "instead", "says"),
    [
        (
            "driver: zaber",
            "driver: zabber",
            "axes.main_lens_stage.driver: there is no driver 'zabber' here; there are zaber",
        ),
        (
            "device: 2",
            "devise: 2",
            "axes.array_stage.devise: there is no such field, did you mean device?",
        ),
        (
            "address: simulated",
            "address: 192.168.0.1",
            "axes.main_lens_stage.address: '192.168.0.1' is not an address; give a serial port",
        ),
        (
            "device: 2",
            "device: 1",
            (
                "axes.array_stage.device: axes main_lens_stage, array_stage, sensor_stage,"
                " target_stage share an address"
            ),
        ),
        (
            "truths: {}",
            "truths: {array.focal_lenght: 1 mm}",
            "simulated.truths.array.focal_lenght: there is no such truth; allowed here: ",
        ),
        (
            "truths: {}",
            "truths: {iris.scale: 1 mm}",
            "simulated.truths.iris.scale: '1 mm': 'mm' is a unit of length",
        ),
        (
            "faults: []",
            "faults: [{device: iris, fault: flip}]",
            "simulated.faults.0: 'flip' is no fault of iris; allowed: silence",
        ),
        (
            "targets: {}",
            "targets: {dots: {}}",
            "simulated.targets.dots: there is no 'dots' on the wheel; allowed: four-dot",
        ),
        (
            "home_towards: +z",
            "home_towards: -z",
            "axes.sensor_stage.home_towards: sensor_stage would",
        ),
    ],
)
def test_a_bench_file_that_cannot_work_is_refused_with_its_line_before_anything_is_planned(
    here: str, instead: str, says: str, flflab: Run, tmp_path: Path
) -> None:
    text = (
        (FULL.parent / "simulated.yaml")
        .read_text(encoding="utf-8")
        .replace("../cameras", str(FULL.parents[1] / "cameras"))
    )
    file = tmp_path / "bench.yaml"
    file.write_text(text.replace(here, instead, 1), encoding="utf-8")
    study = FULL.parents[1] / "studies" / "first.yaml"
    ended = flflab("plan", study, "--bench", file)
    assert (ended.code, ended.out) == (1, "")
    line = 1 + text[: text.index(here)].count("\n")
    assert f"{file}:{line}: {says}" in ended.err


@pytest.mark.ci
def test_a_plan_tells_how_sure_the_frames_make_it_and_how_far_the_stages_leave_it_open(
    flflab: Run, small_camera: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And on a terminal meanwhile how many configurations are done, and for how long."""
    text = (
        (FULL.parent / "simulated.yaml")
        .read_text(encoding="utf-8")
        .replace("../cameras/osinski.yaml", small_camera.name)
    )
    exact = re.sub(
        r"zero_uncertainty: .*",
        "zero_uncertainty: 0 mm",
        re.sub(r"scale_uncertainty: .*", "scale_uncertainty: 0", text),
    )
    study = tmp_path / "study.yaml"
    target = "bars: {kind: bars, cycles_per_mm: [0.5, 10], width: 12 mm, height: 8 mm}\n"
    study.write_text(
        f"name: near\nconfigurations: [{{f_number: 4, distance: 507 mm}}]\n{target}",
        encoding="utf-8",
    )
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    told: dict[str, dict[str, str]] = {}
    for name, bench in (("as stated", text), ("exact", exact)):
        (tmp_path / "bench.yaml").write_text(bench, encoding="utf-8")
        ended = flflab(
            "plan", study, "--bench", tmp_path / "bench.yaml", "--out", tmp_path / "plan.csv"
        )
        assert ended.code == 0, ended.err
        shown, progress = (
            re.sub(r"\x1b\[[\d;?]*\w", "", written) for written in (ended.out, ended.err)
        )
        assert re.search(r"1/1\D+0:\d\d:\d\d.*drawing and measuring", progress)
        assert "from frame noise and the measurement's floor, and from stage errors" in (
            " ".join(shown.split())
        )
        told_json = flflab("plan", study, "--bench", tmp_path / "bench.yaml", "--json").json
        [told[name]] = csv.DictReader(
            (tmp_path / "plan.csv").read_text(encoding="utf-8").splitlines()
        )
    (one,) = told_json["configurations"]
    assert one.pop("why") == ""
    for column, value in told["exact"].items():
        assert str(one[column]) == value or float(value) == pytest.approx(one[column]), column
    assert told_json["seconds"] == pytest.approx(sum(s["seconds"] for s in told_json["steps"]))
    assert told_json["most_megabytes"] == told_json["most_frames"] * 760 * 560 * 2 / 1e6
    assert (
        float(told["as stated"]["mtf_uncertainty_by_stages"])
        > 10 * float(told["as stated"]["mtf_standard_uncertainty"])
        > 0
    )
    assert float(told["exact"]["mtf_uncertainty_by_stages"]) < 1e-12


@pytest.mark.parametrize("width", [80, 60])
def test_a_narrow_terminal_folds_no_number_of_a_plan(width: int) -> None:
    study = read_study(built_in(Kind.STUDY), read_bench(simulated_bench()).optics)
    expected = [
        Expectation(one.index, 8.4e-3, (Look(12, 1.24e-4),), by_stages=0.0171)
        for one in study.configurations
    ]
    console = Console(width=width, file=io.StringIO())
    with console.capture() as taken:
        console.print(expected_table(expected, study, width))
    lines = taken.get().splitlines()
    assert max(len(line) for line in lines) <= width
    rows = [line.split() for line in lines if line.rstrip().endswith("0.017")]
    assert [row[0] for row in rows] == [str(one.index) for one in study.configurations]
    assert all(row[-4:] == ["8.4", "12", "0.00012", "0.017"] for row in rows)
    assert ("sensor" in taken.get()) == (width == 80)

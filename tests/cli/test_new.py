"""``flflab new``: files to begin from, each read again by who uses it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.described import require_drivable
from flflab.bench import BenchDescription, read_bench
from flflab.cli.targets import read_target
from flflab.design.requirements import read_requirements
from flflab.files.camera import read_camera
from flflab.image.scene_file import read_scene
from flflab.missing_light import missing_light
from flflab.study import read_study
from procedures.steps import steps

Run = Callable[..., Any]


def test_a_new_bench_is_a_real_one_with_every_uncertainty_and_can_take_the_first_study(
    flflab: Run, tmp_path: Path
) -> None:
    file = tmp_path / "bench.yaml"
    assert flflab("new", "bench", file).code == 0
    bench = read_bench(file)
    require_drivable(bench)
    described = bench.description
    stated = described.model_fields_set
    assert {
        "light", "optics_uncertainty", "workmanship", "model_uncertainty", "light_uncertainty",
        "envelopes", "measurement_floor",
    } <= stated  # fmt: skip
    assert "simulated" not in stated
    parts = (
        described.optics_uncertainty, described.workmanship, described.model_uncertainty,
        described.measurement_floor,
    )  # fmt: skip
    for part in parts:
        assert part.model_fields_set == set(type(part).model_fields)
        assert all(value > 0 for value in part.model_dump().values())
    assert "simulated" not in {axis.address for axis in described.axes.values()}
    flflab("new", "study", tmp_path / "study.yaml")
    assert steps(read_study(tmp_path / "study.yaml", bench.optics), bench)


def test_every_field_of_a_new_bench_has_a_sentence(flflab: Run, tmp_path: Path) -> None:
    flflab("new", "bench", tmp_path / "bench.yaml")
    lines = (tmp_path / "bench.yaml").read_text(encoding="utf-8").splitlines()
    for name in BenchDescription.model_fields:
        found = [number for number, line in enumerate(lines) if line.startswith(f"{name}:")]
        if name in ("axes", "iris", "target", "optics", "minimum_gap"):
            continue
        for number in found:
            assert lines[number - 1].startswith("#"), name


@pytest.mark.parametrize(("option", "axes"), [("--full", 7), ("--simulated", 4)])
def test_simulated_benches_come_by_options(
    option: str, axes: int, flflab: Run, tmp_path: Path
) -> None:
    file = tmp_path / "bench.yaml"
    assert flflab("new", "bench", file, option).code == 0
    described = read_bench(file).description
    assert len(described.axes) == axes
    assert described.camera.address == "simulated"
    wrong = flflab("new", "study", tmp_path / "study.yaml", option)
    assert wrong.code == 1
    assert "are for a bench" in wrong.err


def test_the_other_new_files_are_read_by_who_uses_them(flflab: Run, tmp_path: Path) -> None:
    for kind in ("scene", "target", "calibration", "requirements", "camera"):
        ended = flflab("new", kind, tmp_path / f"{kind}.yaml")
        assert ended.code == 0, ended.err
    camera = read_camera(tmp_path / "camera.yaml")
    assert read_scene(tmp_path / "scene.yaml").scene.camera == camera
    assert read_target(str(tmp_path / "target.yaml")).kind == "bars"
    assert read_study(tmp_path / "calibration.yaml", camera).configurations
    assert read_requirements(tmp_path / "requirements.yaml")


def test_a_bench_without_light_is_warned_of_diffraction_wider_than_a_pixel(
    flflab: Run, tmp_path: Path
) -> None:
    file = tmp_path / "bench.yaml"
    flflab("new", "bench", file)
    assert missing_light(read_bench(file)) == ""
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    del data["light"]
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    bench = read_bench(file)
    said = missing_light(bench)
    assert "2.8 pixels wide" in said  # 2.44 lambda b / w by hand: 2.77
    assert "Add `light: {wavelength: 550 nm}`" in said
    sensor = replace(bench.optics.sensor, pixel=5e-3)
    assert missing_light(replace(bench, optics=replace(bench.optics, sensor=sensor))) == ""
    checked = flflab("bench", "check", "--bench", file)
    assert said in checked.err

"""``flflab calibrate`` on the simulated bench: the run, the table, and the files one goes on
with.
"""

import json
import re
from pathlib import Path

import pytest
import yaml
from rich.console import Console

from flflab.bench import read_bench
from flflab.bench_calibration import FILES
from flflab.cli.calibrated import conclude, say_numbers, table_of
from flflab.cli.run import run_study
from flflab.errors import RecordError
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.study import read_study
from flflab.targets import FourDot, White
from procedures.steps import ShowTarget, steps
from procedures.study import tell_nobody


@pytest.fixture
def files(root: Path, tmp_path: Path) -> tuple[Path, Path]:
    """The built-in calibration, and the bench with a small sensor, a main lens 0.4 mm longer and an
    iris 2 % wider than described.
    """
    camera = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text())
    camera["sensor"] |= {"resolution": [488, 366], "pixel": "8.3 um"}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera) + "# my camera\n")
    bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text())
    bench["optics"] = "camera.yaml"
    truths = {
        "main_lens.focal_length": "50.4 mm",
        "microlens_array.focal_length": "0.925 mm",
        "iris.scale": 0.02,
    }
    bench["simulated"] |= {"clock": 1000, "truths": truths}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False) + "# my bench\n")
    return root / "examples/studies/calibration.yaml", tmp_path / "bench.yaml"


def test_a_calibration_shows_white_and_dots_only(files: tuple[Path, Path]) -> None:
    study, bench = files
    described = read_bench(bench)
    targets = [
        step.kind
        for step in steps(read_study(study, described.optics), described)
        if isinstance(step, ShowTarget)
    ]
    assert targets == ["white", "four-dot", "black"]


@pytest.mark.ci
@pytest.mark.timeout(400)
def test_planted_errors_are_found_and_written_down(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for target in (White(), FourDot()):  # compiled here: the camera's patience is not for that
        render(one_plane(read_bench(files[1]).optics, target, 507.0))
    run = run_study(*files, tmp_path / "run", None, tell_nobody, "calibrate")
    concluded = conclude(run)
    found = json.loads((tmp_path / "run/calibration.json").read_text())
    for name, truth in (
        ("main_lens.focal_length", 50.4),
        ("microlens_array.focal_length", 0.925),
        ("iris.scale", 0.02),
    ):
        place = found["parameters"].index(name)
        assert abs(found["values"][place] - truth) < 4 * found["uncertainties"][place], name
    calibrated = read_bench(tmp_path / "run/calibrated-bench.yaml")
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", calibrated.description.calibrated or "")
    assert calibrated.optics.main_lens.focal_length == pytest.approx(50.4, abs=0.02)
    for kind in ("camera", "bench"):
        assert f"# my {kind}" in (tmp_path / f"run/calibrated-{kind}.yaml").read_text()
    assert calibrated.description.axes["target_stage"].zero_uncertainty < 0.05
    assert 0 < calibrated.description.optics_uncertainty.main_lens_focal_length < 1e-3
    said = " ".join(capsys.readouterr().out.split())
    assert "main_lens.focal_length" in said
    for width in (100, 80, 60):
        with Console(width=width, record=True) as narrow, narrow.capture() as shown:
            narrow.print(table_of(concluded, width))
        assert "…" not in shown.get()
        assert re.search(r" 50\.[34]\d* ± 0\.0*[1-9]\d mm +100 %", shown.get())
        assert re.search(r"^ *(microlens_array\.)?aperture", shown.get(), re.MULTILINE)
        assert ("50.00000 mm" in shown.get()) == (width > 60)
    assert "do not determine where on the axis the bench as a whole stands" in said
    with pytest.raises(RecordError, match="not overwritten"):
        conclude(run)
    say_numbers(concluded, tuple(run.folder / name for name in FILES))
    printed = json.loads(capsys.readouterr().out)
    assert printed["files"] == list(FILES)
    assert {key: printed[key] for key in found} == found

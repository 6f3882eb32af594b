"""``flflab bench test``: the promises of every bench, asked of one."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from flflab.cli.app import app
from flflab.errors import InputError

Write = Callable[..., Path]


@pytest.fixture
def write(root: Path, tmp_path: Path) -> Write:
    """Writes the built-in bench with a small sensor and fast stages."""

    def write(**simulated: Any) -> Path:
        optics = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text("utf-8"))
        optics["sensor"] |= {"resolution": [64, 48], "pixel": "20 um"}
        (tmp_path / "camera.yaml").write_text(yaml.safe_dump(optics), encoding="utf-8")
        bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text("utf-8"))
        bench["optics"] = "camera.yaml"
        bench["simulated"] |= {"clock": 50} | simulated
        for axis in bench["axes"].values():
            axis["timeout"] = 5.0
        file = tmp_path / "bench.yaml"
        file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
        return file

    return write


def try_out(bench: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "flflab", "bench", "test", "--bench", str(bench)]
    return subprocess.run(
        [*command, *options], capture_output=True, text=True, check=False, timeout=500
    )


@pytest.mark.ci
@pytest.mark.timeout(600)
def test_a_bench_that_keeps_its_promises_ends_well_and_in_junit(
    write: Write, tmp_path: Path
) -> None:
    done = try_out(write(), "--faults", "12", "--junit", str(tmp_path / "bench.xml"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "37 passed" in done.stdout
    suite = ET.parse(tmp_path / "bench.xml").getroot()[0]  # noqa: S314 - written by the line above
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("37", "0", "0")


@pytest.mark.ci
@pytest.mark.timeout(600)
def test_a_bench_whose_stage_breaks_a_promise_ends_with_1_and_says_which(write: Write) -> None:
    stall = {"device": "target_stage", "fault": "stall", "after": 60}
    done = try_out(write(faults=[stall]))
    assert done.returncode == 1, done.stdout + done.stderr
    assert "target_stage" in done.stdout
    assert " failed" in done.stdout


def test_faults_are_shown_to_simulated_axes_only(write: Write) -> None:
    file = write()
    bench = yaml.safe_load(file.read_text(encoding="utf-8"))
    bench["axes"]["array_stage"]["address"] = "/dev/ttyUSB0"
    file.write_text(yaml.safe_dump(bench), encoding="utf-8")
    words = ["bench", "test", "--bench", str(file), "--faults", "5"]
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, InputError)
    assert "array_stage are none" in str(result.exception)

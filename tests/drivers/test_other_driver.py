"""The example of a driver in a package of its own: installed without a network, run on a bench, and
put through the suite of the wheel, as its README says.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

pytestmark = [pytest.mark.ci, pytest.mark.timeout(600)]
FAULTS = 30


@pytest.fixture(scope="module")
def installed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a program that has the package."""
    site = tmp_path_factory.mktemp("site")
    where = ["--no-build-isolation", "--no-deps", "--no-index", "--target", str(site)]
    command = [sys.executable, "-m", "pip", "install", "--quiet", *where]
    subprocess.run([*command, str(root / "examples" / "other_driver")], check=True, timeout=300)
    return {**os.environ, "PYTHONPATH": str(site)}


def run(installed: dict[str, str], folder: Path, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-P", "-m", *words],
        cwd=folder, env=installed, capture_output=True, text=True, check=False, timeout=500,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_its_stage_runs_on_a_bench(installed: dict[str, str], root: Path, tmp_path: Path) -> None:
    source = root / "examples" / "benches" / "simulated.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    bench["optics"] = str((source.parent / bench["optics"]).resolve())
    stage = bench["axes"]["target_stage"]
    for key in ("device", "microstep"):
        del stage[key]
    stage |= {"driver": "acme", "counts_per_mm": 2000.0, "timeout": 5.0}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
    by_hand = ("flflab", "bench")
    home = run(installed, tmp_path, *by_hand, "home", "target_stage", "--bench", "bench.yaml")
    assert "target_stage is at 0.0000 mm" in home
    moved = run(installed, tmp_path, *by_hand, "go", "target.z", "-510 mm", "--bench", "bench.yaml")
    assert "target.z is at -510.00" in moved


def test_it_keeps_what_every_axis_promises_and_is_whole_after_faults(
    installed: dict[str, str], tmp_path: Path
) -> None:
    suite = ["pytest", "-p", "drivers.contract", "-p", "no:cacheprovider"]
    said = run(installed, tmp_path, *suite, "--flflab-axis", "acme", "--flflab-faults", str(FAULTS))
    assert "13 passed" in said


def test_a_driver_that_nobody_brings_is_named(installed: dict[str, str], tmp_path: Path) -> None:
    suite = ["-m", "pytest", "-p", "drivers.contract", "--flflab-axis", "acne"]
    done = subprocess.run(
        [sys.executable, "-P", *suite],
        cwd=tmp_path, env=installed, capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode != 0
    assert "there is no driver 'acne' of axes here; there are zaber," in done.stdout + done.stderr

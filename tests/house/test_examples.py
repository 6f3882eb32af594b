"""The example under bluesky and the notebook run as they stand, on a simulated bench with a small
sensor.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

pytestmark = [pytest.mark.ci, pytest.mark.timeout(600)]


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    """A folder with the built-in bench where the examples expect it; its sensor has 488 x 366
    pixels, its stages are fast.
    """
    benches, cameras = tmp_path / "examples" / "benches", tmp_path / "examples" / "cameras"
    benches.mkdir(parents=True)
    cameras.mkdir()
    camera = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text(encoding="utf-8"))
    camera["sensor"] |= {"resolution": [488, 366], "pixel": "5 um"}
    (cameras / "osinski.yaml").write_text(yaml.safe_dump(camera), encoding="utf-8")
    bench = yaml.safe_load((root / "examples/benches/simulated.yaml").read_text(encoding="utf-8"))
    bench["simulated"]["clock"] = 100
    (benches / "simulated.yaml").write_text(yaml.safe_dump(bench), encoding="utf-8")
    return tmp_path


def run(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_scan_under_bluesky_leaves_three_readable_frames(root: Path, folder: Path) -> None:
    script = root / "examples" / "scripts" / "bluesky_scan.py"
    said = run(folder, str(script), "examples/benches/simulated.yaml")
    assert "3 frames of 488 x 366 pixels" in said
    assert "sensor_stage" in said
    lines = (folder / "scan.jsonl").read_text(encoding="utf-8").splitlines()
    names = [json.loads(line)["name"] for line in lines]
    assert (names[0], names[-1], names.count("event")) == ("start", "stop", 3)


def test_every_cell_of_the_notebook_runs_in_its_order(root: Path, folder: Path) -> None:
    text = (root / "examples/notebooks/through_focus.ipynb").read_text(encoding="utf-8")
    cells: list[dict[str, Any]] = json.loads(text)["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code")
    checked = "print(len(pictures), all(b > a for a, b in zip(pitches, pitches[1:])))"
    assert run(folder, "-c", "\n\n".join([*code, checked])).endswith("3 True\n")

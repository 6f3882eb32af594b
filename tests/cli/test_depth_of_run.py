"""Depth maps of a run: a texture on the target stage against where the stages put it, and
``flflab depth RUN`` on its frames.
"""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]
EXAMPLES = Path(__file__).parents[2] / "examples"
STUDY = """name: depth
configurations:
  - {f_number: 4, distance: [495 mm, 507 mm], focused_at: 507 mm}
texture: {kind: texture, width: 60 mm, grain: 0.06 mm, seed: 3}
targets: [texture]
draws: 500
"""


@pytest.fixture
def taken(flflab: Run, tmp_path: Path) -> tuple[Path, Any]:
    """A run of both places on a camera of 6 x 5 micro-images, and how its validation ended."""
    camera = (EXAMPLES / "cameras" / "osinski.yaml").read_text(encoding="utf-8")
    (tmp_path / "small.yaml").write_text(
        camera.replace("[3664, 2748]", "[540, 460]")
        .replace("pixel: 1.66 um", "pixel: 5 um")
        .replace("count: [25, 25]", "count: [11, 11]"),
        encoding="utf-8",
    )
    text = (EXAMPLES / "benches" / "simulated.yaml").read_text(encoding="utf-8")
    for old, new in (
        ("optics: ../cameras/osinski.yaml", "optics: small.yaml"),
        ("targets: {} ", "targets: {texture: {seed: 3}} "),
        ("clock: 20 ", "clock: 100 "),
    ):
        assert old in text
        text = text.replace(old, new)
    bench, study = tmp_path / "bench.yaml", tmp_path / "study.yaml"
    bench.write_text(text, encoding="utf-8")
    study.write_text(STUDY, encoding="utf-8")
    out = tmp_path / "run"
    return out, flflab("validate", study, "--bench", bench, "--out", out)


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_a_texture_on_the_target_stage_is_mapped_and_judged(
    flflab: Run, taken: tuple[Path, Any]
) -> None:
    folder, ended = taken
    assert ended.code == 0, ended.err
    with (folder / "comparison.csv").open(encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    maps = [row for row in rows if row["quantity"] == "map_distance_mm"]
    assert [float(row["distance_mm"]) for row in maps] == pytest.approx([495, 507], abs=0.2)
    for row in maps:
        assert float(row["measured"]) == pytest.approx(float(row["predicted"]), abs=2)
        assert abs(float(row["z"])) < 3
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Depth maps of the texture against the stages" in page
    made = flflab("depth", folder, "--json")
    assert made.code == 0, made.err
    assert set(made.json["maps"]) == {"c0-texture", "c1-texture"}
    for row, (name, told) in zip(maps, made.json["maps"].items(), strict=True):
        assert told["distance_mm"]["median"] == pytest.approx(float(row["measured"]), abs=0.1)
        assert told["common_mm"] > 0
        kept = json.loads((folder / "depth" / name / "depth.json").read_text(encoding="utf-8"))
        assert kept["distance_mm"] == told["distance_mm"]

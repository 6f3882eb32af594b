"""A study that holds bars along x and along y: both are judged, and drawn over the field."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]
EXAMPLES = Path(__file__).parents[2] / "examples"
STUDY = """name: both
configurations:
  - {f_number: 4, distance: [507 mm, 515 mm], focused_at: 507 mm}
targets: [dots, bars, bars-y]
dots: {kind: four-dot, diameter: 1 mm, spacing: 4 mm}
bars: {kind: bars, cycles_per_mm: [0.5, 8], width: 12 mm, height: 12 mm}
draws: 500
"""


@pytest.mark.ci
@pytest.mark.timeout(300)
def test_contrast_along_x_and_along_y_is_judged_and_drawn(flflab: Run, tmp_path: Path) -> None:
    camera = (EXAMPLES / "cameras" / "osinski.yaml").read_text(encoding="utf-8")
    (tmp_path / "small.yaml").write_text(
        camera.replace("[3664, 2748]", "[1300, 1100]").replace(
            "count: [25, 25]", "count: [11, 11]"
        ),
        encoding="utf-8",
    )
    text = (EXAMPLES / "benches" / "simulated.yaml").read_text(encoding="utf-8")
    chart = STUDY.splitlines()[5].removeprefix("bars: ")
    dots = STUDY.splitlines()[4].removeprefix("dots: ")
    for old, new in (
        ("optics: ../cameras/osinski.yaml", "optics: small.yaml"),
        ("targets: {} ", f"targets: {{bars: {chart}, four-dot: {dots}}} "),
        ("clock: 20 ", "clock: 100 "),
    ):
        assert old in text
        text = text.replace(old, new)
    bench, study, out = tmp_path / "bench.yaml", tmp_path / "study.yaml", tmp_path / "run"
    bench.write_text(text, encoding="utf-8")
    study.write_text(STUDY, encoding="utf-8")
    ended = flflab("validate", study, "--bench", bench, "--out", out)
    assert ended.code == 0, ended.err
    with (out / "comparison.csv").open(encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    for quantity, target in (("mtf", "bars"), ("mtf_y", "bars-y")):
        mine = [row for row in rows if row["quantity"] == quantity]
        assert {row["target"] for row in mine} == {target}
        assert {row["configuration"] for row in mine} == {"0", "1"}
        assert all(abs(float(row["z"])) < 4 for row in mine)
    assert any(row["quantity"] == "ratio_mtf_y" for row in rows)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("MTF of bars along y measured and predicted") == 2
    assert page.count("contrast of every view over the field") == 2

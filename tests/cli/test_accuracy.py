"""``flflab accuracy``: the page, the table and the words it leaves."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Run = Callable[..., Any]


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """No fine tolerances, few pixels and repeats: the pages say of them what they say of many."""
    monkeypatch.setattr("flflab.accuracy.image.TOLERANCES", (3e-2, 1e-2, 3e-3, 1e-3))
    monkeypatch.setattr("flflab.accuracy.image.PIXELS", 40)
    monkeypatch.setattr("flflab.accuracy.image.REPEATS", 1)
    monkeypatch.setattr("flflab.accuracy.measure.REPEATS", 2)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(
    ("what", "columns", "pictures", "says"),
    [
        pytest.param(
            "image",
            {
                "scene",
                "method",
                "requested",
                "largest_error",
                "rms_error",
                "processor_s",
                "first_s",
            },
            6,
            "tolerances requested",
            marks=pytest.mark.ci,
        ),
        pytest.param(
            "measure",
            {"quantity", "method", "frames", "pixels", "uncertainty", "rms_error", "processor_s"},
            4,
            "times what was stated",
            marks=pytest.mark.full,
        ),
        pytest.param(
            "model",
            {"lens", "f_number", "field_mm", "quantity", "model", "exact", "limit", "holds"},
            10,
            "Virtual depth to 1 %",
            marks=pytest.mark.ci,
        ),
    ],
)
def test_accuracy_leaves_a_page_and_a_table_and_says_where(
    flflab: Run, what: str, columns: set[str], pictures: int, says: str, tmp_path: Path
) -> None:
    ended = flflab("accuracy", what, "--out", tmp_path / "new" / "folder")
    assert ended.code == 0, ended.err
    page, table = (
        tmp_path / "new" / "folder" / f"accuracy-{what}.{kind}" for kind in ("html", "csv")
    )
    assert f"Page: {page}" in ended.out
    assert f"Table: {table}" in ended.out
    assert "…" not in ended.out, "a cell of the table is cut"
    assert says in " ".join((ended.out + page.read_text(encoding="utf-8")).split())
    text = page.read_text(encoding="utf-8")
    assert (
        text.count('<img src="data:image/svg+xml;base64,') == pictures == text.count("<figcaption>")
    )
    assert "http" not in text.replace("data:image", "")
    with table.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert columns <= set(rows[0])
    assert len(rows) >= 40


@pytest.mark.full
def test_depth_of_a_camera_of_ones_own_is_shown_against_distance(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    ended = flflab("accuracy", "depth", "--camera", small_camera, "--out", tmp_path)
    assert ended.code == 0, ended.err
    assert "a dot's depth has an rms error of" in " ".join(ended.out.split())
    assert (tmp_path / "accuracy-depth.html").read_text(encoding="utf-8").count(
        '<img src="data:image/svg+xml;base64,'
    ) == 2
    with (tmp_path / "accuracy-depth.csv").open(encoding="utf-8") as stream:
        rows = [
            {name: float(cell or "nan") for name, cell in row.items()}
            for row in csv.DictReader(stream)
        ]
    (focus,) = (row for row in rows if abs(row["distance_mm"] - 506.7016) < 1e-3)
    assert focus["views"] == pytest.approx(focus["model_views"], abs=0.3)
    # half of natural fall-off within micro-images is not known
    assert focus["model_mm"] < focus["stated_mm"] < 10 * focus["model_mm"]
    assert focus["rms_error_mm"] < 2 * focus["stated_mm"]
    # s - c = (b/L) c / ((1 + b/L) x): a gap 1 um longer reads as another x and with it another
    # distance
    x = 60 / 506.7016 + 1 - 60 / 50
    longer = x * (1.151 / 61.151) / (1.15 / 61.15)
    assert focus["gap_mm_per_um"] == pytest.approx(
        abs(60 / (longer - 1 + 60 / 50) - 506.7016), rel=0.01
    )


@pytest.mark.full
@pytest.mark.timeout(300)
def test_the_lattice_of_a_camera_of_ones_own_is_shown_against_the_f_number(
    flflab: Run, small_camera: Path, tmp_path: Path
) -> None:
    ended = flflab("accuracy", "lattice", "--camera", small_camera, "--out", tmp_path)
    assert ended.code == 0, ended.err
    assert "from one white frame the origin is known to" in " ".join(ended.out.split())
    assert (tmp_path / "accuracy-lattice.html").read_text(encoding="utf-8").count(
        '<img src="data:image/svg+xml;base64,'
    ) == 2
    with (tmp_path / "accuracy-lattice.csv").open(encoding="utf-8") as stream:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(stream)]
    # at F/1.6 this sensor holds too few whole micro-images
    assert [row["f_number"] for row in rows] == [2.8, 4.0, 8.0, 16.0]
    (row,) = (row for row in rows if row["f_number"] == 4.0)
    assert f"{row['origin_px']:.4f} ({row['origin_error_px']:.4f})" in ended.out
    # centres lie 0.4 mm (1 + 1.15/60) apart about the sensor's middle, total fields reach (A b / L
    # + d |kappa|) / 2 px
    gap, pixel = 1.15, 0.00166
    apart, reach = (
        0.4 * (1 + gap / 60) / pixel,
        (12.5 * gap / 60 + 0.336 * abs(1 + gap / 60 - gap / 0.917)) / 2 / pixel,
    )
    x, y = np.meshgrid(apart * np.arange(-3, 4), apart * np.arange(-3, 4))
    seen = np.hypot(np.maximum(np.abs(x) - 380, 0), np.maximum(np.abs(y) - 280, 0)) < reach
    assert row["micro_images"] == np.count_nonzero(seen)
    assert row["bias_px"] < 5e-3
    assert row["origin_error_px"] < 1.7 * row["origin_px"]  # eight coordinates
    # twenty-four times fewer pixels than the whole sensor's 0.0005 px
    assert row["origin_error_px"] == pytest.approx(0.0005 * math.sqrt(24), rel=0.5)
    assert row["origin_px"] < 0.03  # how much of fall-off micro-images show is most of it


@pytest.mark.parametrize("what", ["depth", "lattice"])
def test_a_camera_of_several_kinds_of_microlenses_is_refused(
    flflab: Run, root: Path, tmp_path: Path, what: str
) -> None:
    ended = flflab(
        "accuracy", what, "--camera", root / "examples" / "cameras" / "r12a.yaml", "--out", tmp_path
    )
    assert ended.code == 1
    assert "has microlenses of 3 focal lengths; give a camera whose array has one" in " ".join(
        ended.err.split()
    )


def test_only_image_depth_and_lattice_take_a_camera(flflab: Run, small_camera: Path) -> None:
    ended = flflab("accuracy", "model", "--camera", small_camera)
    assert ended.code == 1
    assert "only image, depth and lattice take one" in " ".join(ended.err.split())


@pytest.mark.parametrize("what", ["benches", "nonsense"])
def test_accuracy_of_what_there_is_not_is_refused_with_a_list_of_what_there_is(
    flflab: Run, what: str
) -> None:
    ended = flflab("accuracy", what)
    assert ended.code == 2
    assert f"'{what}' is not one of 'image', 'measure', 'model', 'depth', 'lattice'" in " ".join(
        ended.err.split()
    )

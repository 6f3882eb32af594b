"""What accuracy costs for one's own scene and bench: rows, advice and pages."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from flflab.accuracy.bench_page import BenchRow, bench_advice, bench_page, bench_table
from flflab.accuracy.own_page import scene_advice, scene_page, scene_table
from flflab.accuracy.own_scene import AUTO, RANDOM, RAYS, SceneRow, scene_rows
from flflab.accuracy.page import write_page
from flflab.accuracy.scenes import bench_scene
from flflab.accuracy.work_precision import order
from flflab.errors import InputError
from flflab.image.scene import in_light

Rows = tuple[tuple[SceneRow, ...], float]


@pytest.fixture(scope="module")
def rows() -> Rows:
    """Of a small frame out of focus."""
    return scene_rows(bench_scene(4.0, 900.0, (160, 120)), lambda doing: None)


@pytest.mark.ci
def test_what_is_asked_of_a_picture_is_kept_against_independent_rays(rows: Rows) -> None:
    every, uncertainty = rows
    assert uncertainty < 1e-3
    kept = [row for row in every if row.method == AUTO and (row.requested or 0) > 2 * uncertainty]
    assert kept
    assert all(row.rms_error <= (row.requested or 0) for row in kept)


def test_rays_come_closer_and_monte_carlo_by_the_root_of_their_number(rows: Rows) -> None:
    by_rays = [row for row in rows[0] if row.method == RAYS]
    assert by_rays[0].rms_error > 3 * by_rays[-1].rms_error
    random = [row for row in rows[0] if row.method == RANDOM]
    slope = order([row.rays or 0 for row in random], [row.rms_error for row in random])
    assert slope == pytest.approx(-0.5, abs=0.12)


def test_the_page_begins_with_the_advice(rows: Rows, tmp_path: Path) -> None:
    advice = scene_advice(*rows)
    assert advice[0].startswith("Ask for 0.002: closed forms take ")
    write_page(scene_page(rows[0], "small", rows[1], "here"), tmp_path / "page.html")
    assert "Ask for 0.002" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert len(scene_table(rows[0]).rows) == len(rows[0])


def test_light_of_one_wavelength_has_no_reference_and_is_refused() -> None:
    scene = in_light(bench_scene(4.0, 900.0, (16, 16)), 550e-6)
    with pytest.raises(InputError, match="leave `wavelength` out"):
        scene_rows(scene, lambda doing: None)


def validated(tolerance: float, **changed: Any) -> BenchRow:
    """A validation of made-up figures."""
    row = BenchRow(tolerance, 1, 20.0, 10.0, 1.0, 1.0, 0.3, "mtf", 2e-3, accepted=True)
    return replace(row, **changed)


def test_the_coarsest_pictures_that_leave_the_verdict_alone_are_advised(tmp_path: Path) -> None:
    rows = (
        validated(1e-4, recording_s=60.0),
        validated(5e-4),
        validated(5e-3, rms_z=3.0, accepted=False),
        validated(5e-4, frames=4, recording_s=50.0, uncertainty_contrast=1e-3),
    )
    advice = bench_advice(rows)
    assert advice[0].startswith("Pictures drawn to 0.0005 of white are enough")
    assert "30 s instead of 70 s" in advice[0]
    assert advice[1].startswith("4 frames a point take 60 s")
    assert advice[2] == "From 0.005 of white on the verdict is another one."
    write_page(bench_page(rows, "here"), tmp_path / "page.html")
    assert bench_table(rows).rows[2][-1] == "rejected"

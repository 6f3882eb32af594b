"""White pictures measured without a camera file: drawn ones of known truth, and real ones."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner
from white_pictures.drawing import draw_white
from white_pictures.matching import compare_lattice, match
from white_pictures.named import NAMED
from white_pictures.not_whites import NOT_WHITES
from white_pictures.profiles import OverlappingDiscs
from white_pictures.random_specs import random_spec
from white_pictures.spec import Readout, WhiteSpec

from flflab.cli.app import app
from flflab.errors import MeasurementError
from flflab.files.image import read_picture
from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.white import MeasuredWhite, measure_blind
from flflab.measurement.white_json import figures_of

REAL = Path(__file__).parents[3] / "shared" / "data" / "real_white"
QUICK = (
    "GUV-like",
    "touching",
    "spots of 5.3 px",
    "hexagonal spots",
    "unlit surrounds",
    "wide gaps",
)
LATE = ("seaurchin-like", "R12-like", "corners at 5 %", "pitch of 480 px")
BY_HAND = ("antleg-like", "worked example F/4")  # others like them are measured every day


def drawn(spec: WhiteSpec, seed: int) -> tuple[MeasuredWhite, Any, Any, Any]:
    """A drawn picture measured, its truth, and both compared."""
    picture, truth = draw_white(spec, np.random.default_rng(seed))
    found = measure_blind(picture)
    white = found.white
    matched = match(truth, white.values[white.whole, :2], white.indices[white.whole])
    grid = white.grid
    pitch, angle = pitch_and_angle(grid.layout, grid.vectors_px)
    errors = compare_lattice(truth.lattice, grid.origin_px, pitch, math.degrees(angle))
    return found, truth, matched, errors


def deviations(found: MeasuredWhite, errors: Any) -> np.ndarray:
    """Errors of pitch, angle, origin x, y in stated standard uncertainties."""
    figures = figures_of(found.white, found.picture.shape)
    sure = np.hypot(figures.own, figures.common)
    return np.array([errors.pitch, math.radians(errors.angle), *errors.origin]) / sure


def stated(found: MeasuredWhite) -> np.ndarray:
    white = found.white
    own = np.sqrt(white.spread.covariance[:, [0, 1], [0, 1]])
    return np.hypot(own, white.definition_px)[white.whole]


@pytest.mark.ci
@pytest.mark.parametrize(
    "name",
    [
        *QUICK,
        *(pytest.param(name, marks=pytest.mark.ci) for name in LATE),
        *(pytest.param(name, marks=pytest.mark.full) for name in BY_HAND),
    ],
)
def test_every_whole_micro_image_is_indexed_and_found_where_it_was_drawn(
    name: str,
) -> None:
    found, truth, matched, errors = drawn(NAMED[name], 1)
    assert matched.index_is_right
    assert len(matched.overlooked) <= 0.01 * np.count_nonzero(truth.whole)
    assert abs(errors.pitch) < 1e-3 * truth.lattice.pitch
    assert np.mean(np.abs(matched.z(stated(found))) < 3) > 0.97
    assert np.abs(deviations(found, errors)).max() < 4


@pytest.mark.parametrize(
    ("pictures", "least"),
    [
        pytest.param(6, 0.6, marks=pytest.mark.ci),
        pytest.param(200, 0.85, marks=[pytest.mark.full, pytest.mark.timeout(3600)]),
    ],
)
def test_stated_intervals_hold_what_they_say_for_random_pictures(
    pictures: int, least: float
) -> None:
    lattices, centres, ratios = list[np.ndarray](), list[float](), list[float]()
    for seed in range(pictures):
        spec = random_spec(np.random.default_rng(1000 + seed))
        try:
            found, _, matched, errors = drawn(spec, seed)
        except MeasurementError:
            continue
        if not matched.whole.any():
            continue
        lattices.append(np.abs(deviations(found, errors)) < 2)
        centres.append(float(np.mean(np.abs(matched.z(stated(found))) < 2)))
        ratios.append(float(np.median(stated(found))) / matched.rms)
    assert len(lattices) >= 0.95 * pictures
    assert np.mean(lattices, axis=0).min() >= least
    assert np.mean(centres) >= 0.9
    assert np.median(ratios) <= 3


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("clouds", marks=pytest.mark.full),
        pytest.param("bars", marks=pytest.mark.ci),
        *("leaves", "noise", "flat", "constant", "dark", "saturated_white"),
    ],
)
def test_what_is_no_white_picture_is_refused(name: str) -> None:
    picture = NOT_WHITES[name]((500, 600), np.random.default_rng(1))
    with pytest.raises(MeasurementError, match="white picture: "):
        measure_blind(picture)


def codes(picture: np.ndarray) -> list[str]:
    return [remark.code for remark in measure_blind(picture).remarks]


@pytest.mark.parametrize("name", ["checkerboard", "scene_through_the_camera"])
def test_spots_of_another_shape_and_a_scene_are_remarked(name: str) -> None:
    picture = NOT_WHITES[name]((500, 600), np.random.default_rng(1))
    assert "misfit" in codes(picture)


def test_an_even_picture_of_an_exact_array_is_not_remarked_on() -> None:
    spec = WhiteSpec(shape=(500, 600), pitch=40.0)
    picture, _ = draw_white(spec, np.random.default_rng(3))
    assert codes(picture) == ["noise-estimated"]


@pytest.mark.ci
def test_saturated_warm_striped_and_developed_pictures_are_remarked() -> None:
    rng = np.random.default_rng(3)
    spec = WhiteSpec(shape=(500, 600), pitch=40.0)
    picture, _ = draw_white(spec, rng)
    numbers = picture.astype(np.float64)
    light = float(np.quantile(numbers, 0.95))
    striped = numbers + rng.normal(0, 0.01 * light, 600)[None, :]
    assert "fixed-pattern" in codes(np.rint(np.clip(striped, 0, 65535)).astype(np.uint16))
    warm = picture.copy()
    warm[rng.integers(0, 500, 300), rng.integers(0, 600, 300)] = 65000
    assert "warm-pixels" in codes(warm)
    clipped = np.minimum(picture, np.uint16(0.98 * light))
    assert {"saturated", "saturation-found"} & set(codes(clipped))
    developed = replace(spec, readout=Readout(white=150.0, black=0.0, bits=8, gamma=2.2))
    assert "gamma" in codes(draw_white(developed, rng)[0])


@pytest.mark.parametrize(
    "pictures", [pytest.param(3, marks=pytest.mark.ci), pytest.param(30, marks=pytest.mark.full)]
)
def test_three_kinds_are_told_apart_and_none_is_invented(pictures: int) -> None:
    found = drawn(NAMED["R12-like"], 2)[0]
    assert found.types.count == 3
    for seed in range(pictures):
        layout = ("square", "hexagonal along x")[seed % 2]
        spec = WhiteSpec(
            shape=(400, 500), pitch=24.0, layout=layout, scatter=0.03, brightness=0.015
        )
        assert drawn(spec, seed)[0].types.count == 1


@pytest.mark.skipif(not REAL.is_dir(), reason="the real white pictures lie elsewhere")
@pytest.mark.parametrize(
    ("name", "pitch", "tolerance"),
    [
        ("guv_white.tif", 15.402, 0.006),
        ("antleg_white_corner.png", 27.528, 0.010),
        ("seaurchin_white_edge.png", 17.202, 0.015),
    ],
)
def test_real_white_pictures_have_the_pitch_that_others_found(
    name: str, pitch: float, tolerance: float
) -> None:
    lattice = measure_blind(read_picture(REAL / name)).json()["lattice"]
    assert lattice["pitch_px"] == pytest.approx(pitch, abs=tolerance)
    assert lattice["layout"] == "square"


def test_the_command_measures_a_white_picture_without_a_camera_file(tmp_path: Path) -> None:
    spec = WhiteSpec(shape=(500, 600), pitch=40.0, angle=1.0)
    picture, _ = draw_white(spec, np.random.default_rng(3))
    np.save(tmp_path / "white.npy", picture)
    overlay = tmp_path / "seen.png"
    said = CliRunner().invoke(
        app, ["measure", str(tmp_path / "white.npy"), "--overlay", str(overlay)]
    )
    assert said.exit_code == 0, said.output
    for words in ("square", "pitch", "radius at half light", "kinds of microlens"):
        assert words in said.output
    assert overlay.read_bytes().startswith(b"\x89PNG")


def test_a_picture_of_dots_without_a_camera_file_is_a_usage_error(tmp_path: Path) -> None:
    np.save(tmp_path / "dots.npy", np.zeros((100, 100), dtype=np.uint16))
    said = CliRunner().invoke(app, ["measure", str(tmp_path / "dots.npy"), "--target", "four-dot"])
    assert said.exit_code == 2


def test_a_bent_lattice_is_not_followed_into_a_dark_frame() -> None:
    spec = WhiteSpec(shape=(420, 300), pitch=26.0, angle=23.0, slope=0.1, bend=0.3)
    picture, truth = draw_white(spec, np.random.default_rng(5))
    found = measure_blind(np.pad(picture, 200, constant_values=500))
    figures = figures_of(found.white, found.picture.shape)
    sure = math.hypot(figures.own[0], figures.common[0])
    assert abs(figures.values[0] - truth.lattice.pitch) < min(3 * sure, 1e-3 * 26.0)


def test_touching_micro_images_in_a_dark_frame_are_the_bright_ones() -> None:
    spec = WhiteSpec(
        shape=(300, 360),
        layout="hexagonal along x",
        pitch=13.0,
        angle=12.0,
        profile=OverlappingDiscs(6.8, 2.3),
    )
    picture, truth = draw_white(spec, np.random.default_rng(5))
    framed = np.pad(picture, ((150, 150), (180, 180)), constant_values=500)
    grid = measure_blind(framed).white.grid
    pitch, _ = pitch_and_angle(grid.layout, grid.vectors_px)
    assert pitch == pytest.approx(truth.lattice.pitch, rel=3e-4)

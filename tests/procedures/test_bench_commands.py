"""``flflab bench ...`` and ``flflab plan`` as an operator types them, on a served bench."""

from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import cv2
import pytest
from typer.testing import CliRunner

from flflab.cli.app import app
from flflab.errors import InputError, InterlockError, LimitError, NotHomedError
from sim.serve import Served

Told = Callable[..., str]


@pytest.fixture
def bench(served: Callable[..., Any]) -> Generator[tuple[Served, Path], None, None]:
    with served() as (running, _, file):
        yield running, file


@pytest.fixture
def told(bench: tuple[Served, Path]) -> Told:
    def tell(*words: str) -> str:
        command, *rest = words
        result = CliRunner().invoke(app, ["bench", command, "--bench", str(bench[1]), *rest])
        if isinstance(result.exception, Exception):
            raise result.exception
        assert result.exit_code == 0, result.output
        return result.output

    return tell


def test_check_names_every_device(told: Told) -> None:
    said = told("check")
    for name in (
        "main_lens_stage",
        "array_stage",
        "sensor_stage",
        "target_stage",
        "camera",
        "iris",
        "target",
    ):
        assert name in said
    assert said.count("not homed") == 4


def test_home_move_jog_and_where(told: Told, bench: tuple[Served, Path]) -> None:
    assert "unknown" in told("where")
    with pytest.raises(NotHomedError, match="array_stage"):
        told("move", "array_stage", "5 mm")
    assert "sensor_stage is at 0.0000 mm" in told("home")
    assert "array_stage is at 5.0" in told("move", "array_stage", "5 mm")
    assert "array_stage is at 4.5" in told("jog", "array_stage", "--", "-500 um")
    said = told("where").splitlines()
    line = next(line for line in said if "array_stage" in line)
    assert "array.z" in line
    assert "44.5" in line
    world, now = bench[0].world, bench[0].world.clock.now()
    assert world.elements(now)["array.z"] == pytest.approx(44.5, abs=0.02)
    assert "All axes stopped" in told("stop")


def test_what_is_not_possible_is_refused(told: Told) -> None:
    told("home", "array_stage", "sensor_stage")
    with pytest.raises(LimitError, match="0 mm to 50 mm"):
        told("move", "array_stage", "51 mm")
    with pytest.raises(InputError, match="has no unit"):
        told("move", "array_stage", "5")
    with pytest.raises(InputError, match="its axes are main_lens_stage, array_stage"):
        told("move", "filter_stage", "5 mm")
    told("move", "sensor_stage", "19 mm")
    with pytest.raises(InterlockError, match=r"at least 0\.3 mm"):
        told("move", "array_stage", "20.9 mm")


def test_a_snap_is_a_picture_of_16_bits(told: Told, tmp_path: Path) -> None:
    said = told("snap", "-o", str(tmp_path / "a.png"), "--exposure", "5 ms")
    assert "120 x 90 pixels, 0.005 s" in said
    picture = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert (picture.shape, picture.dtype.name) == ((90, 120), "uint16")
    with pytest.raises(InputError, match=r"\.png, \.tiff or \.dng"):
        told("snap", "-o", str(tmp_path / "a.jpeg"))


def test_a_plan_is_told_without_a_bench(write: Callable[..., tuple[Path, Path]]) -> None:
    study, bench = write()
    result = CliRunner().invoke(app, ["plan", str(study), "--bench", str(bench)])
    assert result.exit_code == 0
    assert "home sensor_stage, main_lens_stage" in result.output
    assert "c1/bars/0: take a frame" in result.output
    assert "at most 8 frames" in result.output

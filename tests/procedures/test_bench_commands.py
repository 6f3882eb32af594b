"""``flflab bench ...`` and ``flflab plan`` as an operator types them, on a served bench."""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Generator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import cv2
import pytest
import tifffile
from PIL import Image
from typer.testing import CliRunner

from drivers.bench import connect
from flflab.bench import read_bench, seeded
from flflab.cli.app import app
from flflab.cli.connected import connected_bench
from flflab.errors import InputError, InterlockError, LimitError, NotHomedError
from flflab.files.image import read_picture
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


def test_iris_and_target_are_set_and_elements_go_to_places_of_the_world(told: Told) -> None:
    assert "iris is at f/5.6" in told("set", "iris", "f/5.6")
    assert "target is bars" in told("set", "target", "bars")
    with pytest.raises(LimitError, match="there is no 'rings' here"):
        told("set", "target", "rings")
    with pytest.raises(InputError, match="an f-number is due, as f/4"):
        told("set", "iris", "wide")
    told("home")
    said = told("go", "array.z", "60 mm", "sensor.z", "61.15 mm")
    assert "array.z is at 60.000" in said
    assert "sensor.z is at 61.1" in said
    with pytest.raises(InterlockError, match=r"at least 0\.3 mm"):
        told("go", "sensor.z", "60.1 mm")
    with pytest.raises(InputError, match="a place is due after each name"):
        told("go", "sensor.z")


@pytest.mark.parametrize(
    "ending",
    ["tiff", pytest.param("png", marks=pytest.mark.ci), pytest.param("dng", marks=pytest.mark.ci)],
)
def test_a_snap_says_what_it_was_taken_with(told: Told, tmp_path: Path, ending: str) -> None:
    told("home", "array_stage", "sensor_stage")
    told("go", "array.z", "60 mm")
    told("go", "sensor.z", "61.15 mm")
    file = tmp_path / f"a.{ending}"
    told("snap", "-o", str(file), "--exposure", "5 ms")
    if ending == "png":
        with Image.open(file) as opened:
            text = str(opened.info["Description"])
    else:
        with tifffile.TiffFile(file) as opened:
            text = cast(Any, opened.pages[0]).description
    note = json.loads(text)
    assert note["exposure_s"] == pytest.approx(5e-3)
    assert note["world"]["sensor.z"] == pytest.approx(61.15, abs=1e-3)
    assert note["world"]["target.z"] is None
    assert note["readings"]["array_stage_mm"] == pytest.approx(20.0, abs=1e-3)
    age = datetime.now(UTC) - datetime.fromisoformat(note["taken"])
    assert 0 <= age.total_seconds() < 300


@pytest.mark.ci
def test_while_a_program_drives_the_bench_others_look_and_it_goes_on(
    bench: tuple[Served, Path], tmp_path: Path
) -> None:
    file = bench[1]

    def look(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-P", "-m", "flflab", "bench", *words, "--bench", str(file)]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    with connect(file) as driver:
        driver.home("array_stage", "sensor_stage")
        driver.doing = "step 3 of 8: home"
        picture = str(tmp_path / "last.tiff")
        early = look("snap", "--last", "-o", picture)
        driver.camera.prepare(2e-3)
        frame = driver.camera.grab()
        where, status = look("where"), look("status")
        last = look("snap", "--last", "-o", picture)
        driver.array_stage.move_to(3.0).wait()  # nobody stopped it
    assert (early.returncode, "has no frame yet" in early.stderr) == (1, True)
    assert where.returncode == 0, where.stderr
    assert re.search(r"array_stage +0\.0000 mm .* array\.z +40\.0000 mm", where.stdout)
    assert re.search(r"target_stage +not homed", where.stdout)
    assert "step 3 of 8: home" in where.stderr
    assert status.stdout == "A program drives this bench: step 3 of 8: home.\nNothing moves.\n"
    assert last.returncode == 0, last.stderr
    assert (read_picture(Path(picture)) == frame.picture).all()
    assert look("status").stdout == "No program of yours drives this bench.\n"


def test_a_seed_that_nobody_would_obey_is_refused(bench: tuple[Served, Path]) -> None:
    read = read_bench(bench[1])
    with pytest.raises(InputError, match="seed 7 would have no effect, since no device there"):
        seeded(read, 7)
    assert seeded(read, None) is read


def test_an_interrupted_move_says_where_it_stopped(
    served: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(file: Path) -> None:
        with connected_bench(file) as connected:
            connected.home("target_stage")
            connected.target_stage.move_to(140.0)
            raise KeyboardInterrupt

    with served(clock=5) as (running, _, file):
        with pytest.raises(KeyboardInterrupt):
            interrupted(file)
        world = running.world
        true = world.elements(world.clock.now())["target.z"] + 600
    found = re.search(r"target_stage stopped at (\S+) mm", capsys.readouterr().err)
    assert found is not None
    assert float(found[1]) == pytest.approx(true, abs=0.3)  # its zero is known to 50 um


def test_a_plan_is_told_without_a_bench(write: Callable[..., tuple[Path, Path]]) -> None:
    study, bench = write()
    result = CliRunner().invoke(app, ["plan", str(study), "--bench", str(bench)])
    assert result.exit_code == 0
    assert "home sensor_stage, main_lens_stage" in result.output
    assert "c1/bars/0: take a frame" in result.output
    assert "at most 8 frames" in result.output

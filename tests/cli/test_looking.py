"""``flflab bench snap`` and ``scan`` as an operator uses them to adjust by hand, on a served
bench.
"""

import functools
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from flflab.bench import read_bench
from flflab.files.image import read_picture
from flflab.files.raw import read_raw
from sim.serve import Served, serve, warm_up, write_bench

Run = Callable[..., Any]


@pytest.fixture
def bench(root: Path, tmp_path: Path) -> Iterator[tuple[Served, Path]]:
    """A served bench with a sensor of 160 x 120 pixels, and a file that leads to it."""
    camera = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text(encoding="utf-8"))
    camera["sensor"] |= {"resolution": [160, 120], "pixel": "6 um"}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera), encoding="utf-8")
    described = yaml.safe_load(
        (root / "examples/benches/simulated.yaml").read_text(encoding="utf-8")
    )
    described["optics"] = "camera.yaml"
    described["simulated"]["clock"] = 100
    (tmp_path / "bench.yaml").write_text(
        yaml.safe_dump(described, sort_keys=False), encoding="utf-8"
    )
    read = read_bench(tmp_path / "bench.yaml")
    with serve(read) as served:
        warm_up(served).join()
        write_bench(read, served, tmp_path / "served.yaml")
        yield served, tmp_path / "served.yaml"


@pytest.mark.ci
def test_a_scan_shows_where_it_is_sharpest_and_goes_there(
    flflab: Run, bench: tuple[Served, Path]
) -> None:
    served, file = bench
    world = served.world
    home = flflab("bench", "home", "--bench", file)
    assert home.code == 0, home.err
    flflab("bench", "move", "main_lens_stage", "10 mm", "--bench", file)
    flflab("bench", "move", "array_stage", "20 mm", "--bench", file)
    scanned = flflab(
        "bench",
        "scan",
        "sensor_stage",
        "18.6 mm",
        "19.1 mm",
        "--points",
        "6",
        "--exposure",
        "5 ms",
        "--bench",
        file,
        "--go",
    )
    assert scanned.code == 0, scanned.err
    assert len(re.findall(r"^\d/6 .* mm  sharpness \d\.\d+$", scanned.err, re.MULTILINE)) == 6
    curve = re.findall(r"^(\d+\.\d+) mm  (\d\.\d+)  (#+)$", scanned.out, re.MULTILINE)
    assert len(curve) == 6
    figures = np.array([float(figure) for _, figure, _ in curve])
    assert [len(bar) for _, _, bar in curve] == pytest.approx(
        [max(1, round(40 * (figure - figures.min()) / np.ptp(figures))) for figure in figures],
        abs=1,
    )
    if "at the end of the range" not in scanned.out:
        best = re.search(r"sharpest at (\d+\.\d+) mm", scanned.out)
        assert best is not None
        assert f"sensor_stage is at {best[1]}"[:-1] in scanned.out
        assert abs(float(best[1]) - float(curve[int(np.argmax(figures))][0])) <= 0.1
    assert world.gap(world.clock.now()) > 0.3


@pytest.fixture
def in_focus(flflab: Run, bench: tuple[Served, Path]) -> tuple[Served, Path]:
    """The bench with main lens and array where a scan of the sensor passes through focus."""
    file = bench[1]
    assert flflab("bench", "home", "--bench", file).code == 0
    for axis, reading in (("main_lens_stage", "10 mm"), ("array_stage", "20 mm")):
        assert flflab("bench", "move", axis, reading, "--bench", file).code == 0
    return bench


def scan_of_the_sensor(file: Path) -> tuple[object, ...]:
    points = "--points", 6, "--exposure", "5 ms", "--bench", file
    return "bench", "scan", "sensor_stage", "18.6 mm", "19.6 mm", *points


def shown(served: Served) -> str:
    return served.world.target_name(served.world.clock.now())


@pytest.mark.ci
def test_a_scan_shows_a_target_that_can_be_in_focus_says_so_and_how_to_go_there(
    flflab: Run, in_focus: tuple[Served, Path]
) -> None:
    served, file = in_focus
    assert flflab("bench", "set", "target", "white", "--bench", file).code == 0
    scanned = flflab(*scan_of_the_sensor(file))
    assert scanned.code == 0, scanned.err
    assert "focus is looked for on the bars target, shown for it\n" in scanned.out
    assert shown(served) == "bars"
    offered = re.search(r"^to go there: flflab (bench move .*)$", scanned.out, re.MULTILINE)
    assert offered is not None, scanned.out
    moved = flflab(*shlex.split(offered[1]))
    best = re.search(r"sharpest at (\d+\.\d+) mm", scanned.out)
    assert best is not None
    there = re.fullmatch(r"sensor_stage is at (\d+\.\d+) mm\n", moved.out)
    assert there is not None, moved.out
    assert float(there[1]) == pytest.approx(float(best[1]), abs=0.001)  # a microstep is half of it

    assert flflab("bench", "set", "target", "edge", "--bench", file).code == 0
    again = flflab(*scan_of_the_sensor(file))
    assert "focus is looked for on the edge target\n" in again.out
    assert shown(served) == "edge"


@pytest.mark.ci
def test_a_scan_asks_a_person_for_the_target_where_none_turns_the_wheel(
    flflab: Run, in_focus: tuple[Served, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    served, file = in_focus
    described = yaml.safe_load(file.read_text(encoding="utf-8"))
    described["target"] = {"driver": "manual"}
    file.write_text(yaml.safe_dump(described), encoding="utf-8")
    before = served.world.elements(served.world.clock.now())
    monkeypatch.setattr(sys, "stdin", None)
    alone = flflab(*scan_of_the_sensor(file))
    assert alone.code == 1
    assert "a person has to do this: put the target bars in place" in alone.err
    assert served.world.elements(served.world.clock.now()) == before

    described["target"]["names"] = ["white", "black"]
    file.write_text(yaml.safe_dump(described), encoding="utf-8")
    without = flflab(*scan_of_the_sensor(file))
    assert without.code == 1
    assert "there is none of bars, chirp, four-dot, edge here; nothing moved" in without.err
    assert served.world.elements(served.world.clock.now()) == before


def test_a_scan_beyond_the_limits_moves_nothing(flflab: Run, bench: tuple[Served, Path]) -> None:
    served, file = bench
    before = served.world.elements(served.world.clock.now())
    refused = flflab("bench", "scan", "array_stage", "10 mm", "60 mm", "--bench", file)
    assert refused.code == 1
    assert "array_stage: asked to go to" in refused.err
    same = flflab("bench", "scan", "array_stage", "10 mm", "10 mm", "--bench", file)
    assert (same.code, "the two must differ" in same.err) == (1, True)
    away = flflab("bench", "scan", "array_stage", "10 mm", "20 mm", "--bench", file)
    assert (
        away.code,
        "array_stage: asked where it is, but it has no reference; home it first" in away.err,
    ) == (1, True)
    assert served.world.elements(served.world.clock.now()) == before


def test_a_scan_into_the_gap_moves_nothing_and_says_how_far_it_may_go(
    flflab: Run, bench: tuple[Served, Path]
) -> None:
    served, file = bench
    home = flflab("bench", "home", "array_stage", "sensor_stage", "--bench", file)
    assert home.code == 0, home.err
    flflab("bench", "move", "array_stage", "20 mm", "--bench", file)
    before = served.world.elements(served.world.clock.now())
    refused = flflab("bench", "scan", "sensor_stage", "15 mm", "25 mm", "--bench", file)
    assert refused.code == 1
    told = re.search(
        r"at least 0\.3 mm are required .*; nothing moved\. Farthest allowed: (\d+\.\d{3}) mm$",
        refused.err.strip(),
    )
    assert told is not None, refused.err
    assert served.world.elements(served.world.clock.now()) == before
    beyond = f"{float(told[1]) + 0.002:.3f} mm"
    assert flflab("bench", "move", "sensor_stage", beyond, "--bench", file).code == 1
    moved = flflab("bench", "move", "sensor_stage", f"{told[1]} mm", "--bench", file)
    assert moved.code == 0, moved.err
    assert served.world.gap(served.world.clock.now()) > 0.3


def test_a_snap_is_written_as_raw_too_and_needs_somewhere_to_go(
    flflab: Run, bench: tuple[Served, Path], tmp_path: Path
) -> None:
    _, file = bench
    taken = flflab("bench", "snap", "--bench", file, "-o", tmp_path / "a.dng", "--exposure", "4 ms")
    assert taken.code == 0, taken.err
    assert "160 x 120 pixels, 0.004 s, Mono12" in taken.out
    raw = read_raw(tmp_path / "a.dng")
    assert (raw.values.shape, raw.black_level[0], raw.white_level, raw.exposure_s) == (
        (120, 160),
        64,
        4095,
        0.004,
    )
    refused = flflab("bench", "snap", "--bench", file)
    assert (refused.code, "give a file for the picture with -o" in refused.err) == (2, True)


@pytest.mark.ci
def test_a_watched_folder_is_simulated_like_any_camera(
    flflab: Run, bench: tuple[Served, Path], tmp_path: Path
) -> None:
    described = yaml.safe_load((tmp_path / "bench.yaml").read_text(encoding="utf-8"))
    described["camera"] = {
        "driver": "folder", "address": "simulated", "released_by": "program",
        "exposures": ["10 us", "10 s"], "gains": [1, 16],
        "full_scale": 4095, "black_level": 64, "electrons_per_dn": 2.977, "read_noise_electrons": 3,
        "timeout": "100 s",
    }  # fmt: skip
    (tmp_path / "folder.yaml").write_text(
        yaml.safe_dump(described, sort_keys=False), encoding="utf-8"
    )
    taken = flflab(
        "bench",
        "snap",
        "--bench",
        tmp_path / "folder.yaml",
        "-o",
        tmp_path / "a.png",
        "--exposure",
        "4 ms",
        "--gain",
        "2",
    )
    assert (taken.code, "160 x 120 pixels, 0.004 s, Mono12" in taken.out) == (0, True), taken.err
    checked = flflab("bench", "check", "--bench", tmp_path / "folder.yaml")
    assert (checked.code, "watched folder, program releases" in " ".join(checked.out.split())) == (
        0,
        True,
    ), checked.err


@pytest.mark.ci
@pytest.mark.skipif(
    sys.platform == "win32", reason="an interrupt cannot be sent to one process alone there"
)
def test_a_live_view_ends_at_an_interrupt_without_a_traceback_even_in_the_background(
    bench: tuple[Served, Path], tmp_path: Path
) -> None:
    command = [
        sys.executable,
        "-m",
        "flflab",
        "bench",
        "snap",
        "--bench",
        bench[1],
        "--live",
        "-o",
        tmp_path / "now.png",
    ]
    in_background = functools.partial(
        signal.signal, signal.SIGINT, signal.SIG_IGN
    )  # so a shell starts a job with &
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=in_background
    ) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline() for _ in range(3)]
        child.send_signal(signal.SIGINT)
        _, complaints = child.communicate(timeout=20)
    assert child.returncode == 130
    assert "Traceback" not in complaints
    for number, line in enumerate(lines, start=1):
        assert re.match(
            rf"frame {number}  sharpness \d\.\d{{5}} [#.]{{40}} best \d\.\d{{5}}, \d+ saturated,"
            r" \d+\.\d frames/s",
            line,
        ), line
    assert read_picture(tmp_path / "now.png").shape == (120, 160)

"""``flflab bench`` on a served bench with every axis of the paper's Fig. 10: what an operator types
and reads.
"""

import math
import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.bench import connect
from flflab.bench import read_bench
from flflab.errors import DeviceError
from sim.serve import serve, write_bench

Run = Callable[..., Any]


@pytest.fixture
def bench_file(root: Path, tmp_path: Path) -> Iterator[Path]:
    """The bench served a hundred times faster than real, and a file that leads to it."""
    source = root / "examples" / "benches" / "full.yaml"
    copy = tmp_path / "full.yaml"
    text = source.read_text(encoding="utf-8").replace("clock: 20 ", "clock: 100 ")
    copy.write_text(
        text.replace("../cameras", str(root / "examples" / "cameras")), encoding="utf-8"
    )
    bench = read_bench(copy)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        yield tmp_path / "served.yaml"


def test_an_operator_checks_homes_moves_and_stops_every_axis(flflab: Run, bench_file: Path) -> None:
    checked = flflab("bench", "check", "--bench", bench_file)
    assert checked.code == 0, checked.err
    for words in (
        "Zaber device 50000",
        "Thorlabs KDC101",
        "Oriental Motor AZ drive, slave 2",
        "not homed",
    ):
        assert words in " ".join(checked.out.split())
    refused = flflab("bench", "move", "goniometer", "2 deg", "--bench", bench_file)
    assert refused.code == 1
    assert (
        "goniometer: asked to go to 2.000000 deg, but it has no reference; home it first"
        in refused.err
    )
    homed = flflab("bench", "home", "--bench", bench_file)
    assert homed.code == 0, homed.err
    assert "ring is at 0.0000 deg" in homed.out
    moved = flflab("bench", "move", "goniometer", "2.5 deg", "--bench", bench_file)
    assert (moved.code, moved.out) == (0, "goniometer is at 2.5000 deg\n")
    jogged = flflab("bench", "jog", "ring", "--bench", bench_file, "--", "-0.5 deg")
    assert (jogged.code, jogged.out) == (0, "ring is at -0.5000 deg\n")
    back = flflab("bench", "jog", "ring", "-.5 deg", "--bench", bench_file)
    assert (back.code, back.out) == (0, "ring is at -1.0000 deg\n")
    below = flflab("bench", "move", "ring", "-2 deg", "--bench", bench_file)
    assert (below.code, below.out) == (0, "ring is at -2.0000 deg\n")
    misspelt = flflab("bench", "move", "ring", "-2 deg", "--bnech", bench_file)
    assert misspelt.code == 2
    assert "No such option: --bnech" in misspelt.err
    stood = flflab("bench", "where", "--bench", bench_file)
    assert "array.pitch 2.5000 deg" in " ".join(stood.out.split())
    turned = flflab("bench", "where", "--bench", bench_file, "--json").json["axes"]["goniometer"]
    assert turned["world"] == pytest.approx(math.radians(2.5), abs=1e-5)
    assert (turned["unit"], turned["moves"], turned["moving"]) == ("rad", "array.pitch", False)
    devices = flflab("bench", "check", "--bench", bench_file, "--json").json["devices"]
    assert [one["name"] for one in devices][-3:] == ["camera", "iris", "target"]
    assert all(one["answers"] for one in devices)
    ring = next(one for one in devices if one["name"] == "ring")
    assert ring["position"] == pytest.approx(math.radians(-2), abs=1e-5)
    assert (ring["driver"], ring["unit"]) == ("oriental", "rad")
    stopped = flflab("bench", "stop", "--bench", bench_file)
    assert (stopped.code, stopped.out) == (0, "All axes stopped.\n")


def test_every_axis_that_answers_is_stopped_whatever_else_of_the_bench_is_off_or_wrong(
    flflab: Run, bench_file: Path
) -> None:
    described = yaml.safe_load(bench_file.read_text(encoding="utf-8"))
    host, port = described["axes"]["sensor_stage"]["address"].removeprefix("socket://").split(":")
    number = described["axes"]["sensor_stage"]["device"]
    with socket.create_connection((host, int(port)), 5.0) as line, line.makefile("rwb") as stage:
        for command, state in ((f"/{number} move vel 10\n", b"BUSY"), (f"/{number}\n", b"BUSY")):
            stage.write(command.encode())
            stage.flush()
            assert state in stage.readline()
        described["camera"]["address"] = described["axes"]["ring"]["address"] = "127.0.0.1:9"
        described["axes"]["goniometer"]["driver"] = "zabber"
        bench_file.write_text(yaml.safe_dump(described), encoding="utf-8")
        stopped = flflab("bench", "stop", "--bench", bench_file)
        assert stopped.code == 1
        told = [
            line for line in stopped.err.splitlines() if "it may still move, cut its power" in line
        ]
        assert len(told) == 2
        assert all(any(name in line for line in told) for name in ("ring", "goniometer")), told
        stage.write(f"/{number}\n".encode())
        stage.flush()
        assert b"IDLE" in stage.readline()


@pytest.mark.parametrize(
    "broken", ["axes: [", "axes: {}", None], ids=["no YAML", "other axes", "no file"]
)
def test_who_drives_a_bench_is_stopped_whatever_became_of_its_file(
    flflab: Run, bench_file: Path, broken: str | None
) -> None:
    with connect(bench_file) as bench:
        bench_file.unlink()
        if broken is not None:
            bench_file.write_text(broken, encoding="utf-8")
        stopped = flflab("bench", "stop", "--bench", bench_file)
        assert (stopped.code, stopped.out) == (0, "All axes stopped.\n")
        with pytest.raises(
            DeviceError,
            match="ring: asked to move, nothing moved: another program had this bench stopped",
        ):
            bench.ring.home()


def test_where_nobody_drives_a_bench_whose_file_is_no_yaml_the_operator_is_sent_to_stop_it_by_hand(
    flflab: Run, bench_file: Path
) -> None:
    bench_file.write_text(
        bench_file.read_text(encoding="utf-8").replace("axes:", "axes: ["), encoding="utf-8"
    )
    stopped = flflab("bench", "stop", "--bench", bench_file)
    assert (stopped.code, stopped.out) == (1, "")
    said = stopped.err.splitlines()
    assert said[0].startswith(f"flflab: {bench_file}:")
    assert said[-1].startswith("no axis was stopped")
    assert said[-1].endswith(
        "stop them by hand, by the emergency stop or by their power, then correct the file"
    )


def test_an_axis_is_stopped_whatever_is_wrong_with_the_rest_of_its_file(
    flflab: Run, bench_file: Path
) -> None:
    described = yaml.safe_load(bench_file.read_text(encoding="utf-8"))
    described["minimal_gap"] = described.pop("minimum_gap")
    described["optics"] = "nowhere.yaml"
    described["axes"]["ring"]["limits"] = ["5 mm", 7]
    del described["axes"]["array_stage"]["microstep"]
    bench_file.write_text(yaml.safe_dump(described), encoding="utf-8")
    stopped = flflab("bench", "stop", "--bench", bench_file)
    assert (stopped.code, stopped.out) == (0, "All axes stopped.\n")


@pytest.mark.parametrize("field", ["address", "driver"])
@pytest.mark.parametrize("wrong", [7, [1], None, {"a": 1}])
def test_an_axis_whose_address_or_driver_is_no_text_keeps_no_other_from_being_stopped(
    flflab: Run, bench_file: Path, field: str, wrong: object
) -> None:
    described = yaml.safe_load(bench_file.read_text(encoding="utf-8"))
    described["axes"]["ring"][field] = wrong
    bench_file.write_text(yaml.safe_dump(described), encoding="utf-8")
    stopped = flflab("bench", "stop", "--bench", bench_file)
    assert (stopped.code, stopped.out) == (1, "")
    assert [line.split()[0] for line in stopped.err.splitlines()] == ["flflab:"]
    assert "ring" in stopped.err


def test_80_columns_show_serial_numbers_names_and_limits_whole_and_a_pipe_one_line_a_device(
    flflab: Run, bench_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert flflab("bench", "home", "ring", "--bench", bench_file).code == 0
    assert flflab("bench", "move", "ring", "-169.98 deg", "--bench", bench_file).code == 0
    piped = flflab("bench", "check", "--bench", bench_file).out
    assert re.search(
        r"^main_lens_stage +not homed +Zaber device \d+, serial 100001, firmware .*, at 1 +WR: no"
        r" reference position$",
        piped,
        re.M,
    )
    assert len(piped.splitlines()) == 2 + 7 + 3
    monkeypatch.setenv("FORCE_COLOR", "1")  # so rich takes the pipe for a terminal
    monkeypatch.setenv("COLUMNS", "80")
    checked, stood = (
        re.sub(r"\x1b\[[\d;]*m", "", flflab("bench", what, "--bench", bench_file).out)
        for what in ("check", "where")
    )
    for line in (checked + stood).splitlines():
        assert len(line) <= 80
        assert "…" not in line
    for whole in ("main_lens_stage", "100001,", "100004,", "27000001,", "-169.9800 deg"):
        assert whole in checked
    assert re.search(
        r"^ring +-169\.9800 deg +-170 deg to 170 deg +array\.roll +-169\.9800 deg$",
        stood,
        re.MULTILINE,
    )


@pytest.mark.ci
def test_a_simulated_bench_stands_where_the_last_command_left_it(
    flflab: Run, root: Path, tmp_path: Path
) -> None:
    source = root / "examples" / "benches" / "simulated.yaml"
    bench = yaml.safe_load(source.read_text(encoding="utf-8"))
    bench["optics"] = str((source.parent / bench["optics"]).resolve())
    file = tmp_path / "bench.yaml"
    file.write_text(yaml.safe_dump(bench), encoding="utf-8")
    homed = flflab("bench", "home", "target_stage", "--bench", file)
    assert (homed.code, homed.out) == (0, "target_stage is at 0.0000 mm\n")
    gone = flflab("bench", "go", "target.z", "-510 mm", "--bench", file)
    assert gone.code == 0
    assert re.fullmatch(r"target\.z is at -510\.000\d mm\n", gone.out)
    stood = flflab("bench", "where", "--bench", file).out
    assert re.search(r"target_stage +89\.999\d mm .* target\.z +-510\.000\d mm", stood)
    assert re.search(r"array_stage +not homed", stood)


def test_a_length_for_an_axis_that_turns_is_refused(flflab: Run, bench_file: Path) -> None:
    refused = flflab("bench", "move", "ring", "5 mm", "--bench", bench_file)
    assert refused.code in (1, 2)
    assert "'mm' is a unit of length; an angle is a number and a unit of rad" in refused.err


def test_one_stage_for_two_axes_is_refused_by_check_and_by_move(
    flflab: Run, bench_file: Path
) -> None:
    data = yaml.safe_load(bench_file.read_text(encoding="utf-8"))
    twice = bench_file.with_name("twice.yaml")
    for address, says in (
        ("127.0.0.1", "array_stage is the same stage as main_lens_stage"),
        ("127.1", "array_stage is the same stage as main_lens_stage"),
    ):
        data["axes"]["array_stage"] |= {
            "device": 1,
            "address": data["axes"]["sensor_stage"]["address"].replace("127.0.0.1", address),
        }
        twice.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
        for command in (("check",), ("move", "array_stage", "5 mm")):
            refused = flflab("bench", *command, "--bench", twice)
            assert refused.code == 1
            assert says in refused.err

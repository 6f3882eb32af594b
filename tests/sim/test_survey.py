"""A look at every device of a simulated bench at once, some of which say nothing."""

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from drivers.stopping import axes_to_stop, stop_axes
from drivers.survey import SILENT, survey
from flflab.bench import Bench, read_bench
from sim.serve import serve, write_bench

WriteBench = Callable[..., Bench]


def test_one_look_tells_of_every_device_and_of_every_one_that_is_silent(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    silent = ("goniometer", "iris")
    bench = write_bench_file(
        "full", faults=[{"device": name, "fault": "silence"} for name in silent]
    )
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        data = yaml.safe_load((tmp_path / "served.yaml").read_text())
        data["axes"]["rotation_stage"]["address"] = "socket://127.0.0.1:9"
        (tmp_path / "served.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
        rows = {row.name: row for row in survey(read_bench(tmp_path / "served.yaml"))}
    assert list(rows) == [*bench.description.axes, "camera", "iris", "target"]
    assert {name for name, row in rows.items() if row.identity == SILENT} == {
        *silent,
        "rotation_stage",
    }
    for name in (*silent, "rotation_stage"):
        assert rows[name].state.startswith(name)
        assert re.search("check|is `flflab sim` still running", rows[name].state)
    assert rows["array_stage"].identity.startswith("Zaber device")
    assert "not homed" in rows["ring"].state


def test_whoever_takes_too_long_is_said_to(write_bench_file: WriteBench, tmp_path: Path) -> None:
    bench = write_bench_file("full")
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        rows = survey(read_bench(tmp_path / "served.yaml"), timeout=0.0)
        deadline = time.monotonic() + 10
        while any(thread.name.startswith("look at") for thread in threading.enumerate()):
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert any(
        row.state.startswith(f"{row.name}: no answer within 0 s; is `flflab sim` still running?")
        for row in rows
    )


def test_a_vertical_axis_is_said_to_fall_without_current(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    bench = write_bench_file("full")
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        data = yaml.safe_load((tmp_path / "served.yaml").read_text())
        data["axes"]["target_stage"]["vertical"] = True
        (tmp_path / "served.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
        states = {row.name: row.state for row in survey(read_bench(tmp_path / "served.yaml"))}
        served.stop()
        faults = stop_axes(axes_to_stop(tmp_path / "served.yaml"))
    assert "unless it has a brake" in states["target_stage"]
    assert "brake" not in states["array_stage"]
    assert "hold up what it carries, then cut its power" in faults["target_stage"]
    assert faults["array_stage"].endswith("it may still move, cut its power")

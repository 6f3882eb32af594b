"""The real drivers on the simulated bench: whatever is asked, array and sensor never meet in truth."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.bench import connect
from flflab.bench import Bench
from flflab.errors import DeviceError
from sim.serve import serve, write_bench

WriteBench = Callable[..., Bench]


@pytest.mark.parametrize("error", ["3 um", "-3 um"])
def test_the_true_gap_is_kept_through_homing_and_any_moves(write_bench_file: WriteBench, tmp_path: Path, error: str) -> None:
    truths = {"array_stage.zero": error, "sensor_stage.zero": "-3 um" if error == "3 um" else "3 um"}
    bench = write_bench_file(truths=truths, clock=100)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        world = served.world
        begun = world.clock.now()
        refused = 0
        with connect(tmp_path / "served.yaml") as connected:
            array, sensor = connected.axes["array_stage"], connected.axes["sensor_stage"]
            with contextlib.suppress(DeviceError):
                sensor.move_to(25.0).wait(10)
            for axis in (array, sensor):
                axis.home().wait(10)
            generator = np.random.default_rng(7)
            for _ in range(25):
                axis = (array, sensor)[generator.integers(2)]
                try:
                    axis.move_to(float(generator.uniform(5, 45))).wait(10)
                except DeviceError:
                    refused += 1
        instants = np.linspace(begun, world.clock.now(), 20_000)
        gaps = [world.gap(float(instant)) for instant in instants]
    assert refused > 3
    assert min(gaps) >= bench.description.minimum_gap

"""The real drivers on the simulated benches: whatever is asked, array and sensor never meet in truth, tilted or not."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.base import wait_all
from drivers.bench import connect
from flflab.bench import Bench
from flflab.errors import DeviceError, InterlockError, MotionError
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


def test_the_true_gap_is_kept_by_a_tilting_array_whose_axes_move_together(write_bench_file: WriteBench, tmp_path: Path) -> None:
    """Four axes by three makers; each is told to go on while the others are still under way, and is stopped now and then."""
    truths = {"array_stage.zero": "3 um", "sensor_stage.zero": "-3 um", "goniometer.zero": "0.03 deg", "rotation_stage.zero": "-0.03 deg"}
    bench = write_bench_file("full", truths=truths | {"rotation_stage.start": "5 deg"}, clock=20)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        world = served.world
        begun = world.clock.now()
        refused, tilted = 0, 0
        with connect(tmp_path / "served.yaml") as connected:
            under_way = {name: connected.axes[name].home() for name in ("array_stage", "sensor_stage")}
            wait_all(*under_way.values(), timeout=20)
            under_way |= {name: connected.axes[name].home() for name in ("goniometer", "rotation_stage")}
            generator = np.random.default_rng(11)
            for _ in range(60):
                name = list(under_way)[generator.integers(4)]
                axis = connected.axes[name]
                with contextlib.suppress(MotionError):
                    under_way[name].wait(10)
                low, high = (17.0, 21.0) if axis.coordinate.unit == "mm" else axis.limits
                try:
                    under_way[name] = axis.move_to(float(generator.uniform(low, high)))
                except InterlockError:
                    refused += 1
                    continue
                tilted += axis.coordinate.unit == "rad"
                if generator.random() < 0.1:
                    axis.stop()
            connected.stop()
        instants = np.linspace(begun, world.clock.now(), 20_000)
        least = min(world.gap(float(instant)) for instant in instants)
    assert refused > 3
    assert tilted > 3
    assert bench.description.minimum_gap <= least < 3

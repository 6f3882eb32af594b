"""Two programs that no lock keeps apart, as on two computers: judged by the true gap."""

import contextlib
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Axis
from drivers.bench import ConnectedBench, connect
from flflab.bench import Bench
from flflab.errors import DeviceError, InterlockError
from sim.motion import move
from sim.serve import Served, serve, write_bench

WriteBench = Callable[..., Bench]
TWO = ("array_stage", "sensor_stage")


@pytest.fixture
def served(
    write_bench_file: WriteBench, tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[Served]:
    """A bench served at the rate that the test asks for."""
    bench = write_bench_file(clock=request.param)
    with serve(bench) as served:
        write_bench(bench, served, tmp_path / "served.yaml")
        yield served


@pytest.fixture
def here(served: Served, tmp_path: Path) -> Iterator[ConnectedBench]:
    """The bench from this computer, homed."""
    with connect(tmp_path / "served.yaml") as bench:
        for name in ("main_lens_stage", "sensor_stage", "array_stage"):
            bench.axes[name].home().wait(20)
        yield bench


@pytest.fixture
def elsewhere(
    here: ConnectedBench, tmp_path: Path, other_address: Callable[[str], str]
) -> Iterator[ConnectedBench]:
    """The same bench from another computer."""
    text = (tmp_path / "served.yaml").read_text(encoding="utf-8")
    other = tmp_path / "elsewhere.yaml"
    other.write_text(
        re.sub(r"socket://[\d.]+:\d+", lambda found: other_address(found[0]), text),
        encoding="utf-8",
    )
    with connect(other) as bench:
        yield bench


def least_gap(served: Served, begun: float) -> float:
    instants = np.linspace(begun, served.world.clock.now(), 4000)
    return min(served.world.gap(float(instant)) for instant in instants)


@pytest.mark.ci
@pytest.mark.parametrize("served", [20], indirect=True)
def test_two_programs_that_approach_each_other_at_once_keep_the_gap(
    served: Served, here: ConnectedBench, elsewhere: ConnectedBench
) -> None:
    together = threading.Barrier(2)
    arrived: list[bool] = []

    def approach(axis: Axis, delay: float) -> None:
        together.wait(20)
        time.sleep(delay)
        try:
            axis.move_to(20.5).wait(20)
        except DeviceError:
            arrived.append(False)
        else:
            arrived.append(True)

    generator = np.random.default_rng(5)
    least = np.inf
    for round_ in range(12):
        begun = served.world.clock.now()
        late = float(generator.uniform(0, 0.02)) if round_ % 3 else 0.3
        threads = [
            threading.Thread(target=approach, args=(here.array_stage, 0.0)),
            threading.Thread(target=approach, args=(elsewhere.sensor_stage, late)),
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        least = min(least, least_gap(served, begun))
        here.array_stage.move_to(18.0).wait(20)
        elsewhere.sensor_stage.move_to(18.0).wait(20)
    assert least >= 0.3
    assert arrived.count(False) >= 12
    assert arrived.count(True) > 0


@pytest.mark.ci
@pytest.mark.parametrize("served", [1], indirect=True)
def test_a_neighbour_that_somebody_else_moves_stops_what_is_on_its_way_towards_it(
    served: Served, here: ConnectedBench
) -> None:
    here.sensor_stage.move_to(16.0).wait(20)
    here.array_stage.move_to(12.0).wait(20)
    begun = served.world.clock.now()
    status = here.array_stage.move_to(23.0)
    time.sleep(0.3)
    carriage = served.world.carriages["sensor_stage"]
    with served.world.lock:
        now = served.world.clock.now()
        carriage.motion = move(carriage.motion, now, 22.0, 2.0, 400.0)
    with pytest.raises(InterlockError, match="its neighbour sensor_stage moved meanwhile"):
        status.wait(20)
    time.sleep(3.5)
    assert not here.array_stage.is_moving()
    assert least_gap(served, begun) >= 0.3


@pytest.mark.parametrize("served", [20], indirect=True)
def test_own_motions_of_a_neighbour_stop_nothing(served: Served, here: ConnectedBench) -> None:
    here.sensor_stage.move_to(18.0).wait(20)
    for end in (20.5, 15.0, 20.5):
        status = here.array_stage.move_to(end)
        away = here.sensor_stage.move_to(15.0)
        status.wait(20)
        away.wait(20)
        with contextlib.suppress(InterlockError):
            here.sensor_stage.move_to(18.0).wait(20)

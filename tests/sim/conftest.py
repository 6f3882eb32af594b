"""A simulated bench with a small sensor, and Zaber chains on lines of their own."""

import contextlib
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
import yaml

from flflab.bench import Bench, read_bench
from sim.clock import Clock, RunningClock
from sim.faults import Fault, Faults
from sim.serve import Served, serve, write_bench
from sim.server import PtyLine, TcpLine
from sim.stage import Stage
from sim.world import Carriage
from sim.zaber import Chain, Device

MICROSTEP = 0.00049609375  # mm
WriteBench = Callable[..., Bench]
ServeSlowly = Callable[..., AbstractContextManager[tuple[Served, Path]]]


@pytest.fixture
def write_bench_file(root: Path, tmp_path: Path) -> WriteBench:
    """Write an example bench with a sensor of 240 x 180 pixels and other simulated values, and read
    it.
    """

    def write(example: str = "simulated", **simulated: object) -> Bench:
        camera = yaml.safe_load((root / "examples/cameras/osinski.yaml").read_text())
        camera["sensor"] |= {"resolution": [240, 180], "pixel": "6 um"}
        (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
        bench = yaml.safe_load((root / f"examples/benches/{example}.yaml").read_text())
        bench["optics"] = "camera.yaml"
        bench["simulated"] |= {"clock": 200} | simulated
        (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False))
        return read_bench(tmp_path / "bench.yaml")

    return write


@pytest.fixture
def serve_slowly(write_bench_file: WriteBench, tmp_path: Path) -> ServeSlowly:
    """Serve an example bench in real time, its axes near their references and slow, beside a bench
    file that leads to it.
    """

    @contextlib.contextmanager
    def serve_it(
        example: str, starts: dict[str, str], speeds: dict[str, str], *, pty: bool = False
    ) -> Generator[tuple[Served, Path]]:
        truths = {f"{name}.start": start for name, start in starts.items()}
        bench = write_bench_file(example, truths=truths, clock=1)
        data = yaml.safe_load(bench.file.read_text())
        for name, speed in speeds.items():
            data["axes"][name]["speed"] = speed
        bench.file.write_text(yaml.safe_dump(data, sort_keys=False))
        with serve(bench, pty=pty) as served:
            write_bench(bench, served, tmp_path / "served.yaml")
            yield served, tmp_path / "served.yaml"

    return serve_it


def chain_of(
    clock: Clock, devices: int = 2, faults: dict[int, Fault] | None = None, start: float = 20.0
) -> Chain:
    """Devices 1, 2 ... with 150 mm of travel, 10 mm/s and 400 mm/s^2, each left at ``start`` mm."""
    stages = [
        Stage(Carriage(clock, start), (0.0, 150.0), MICROSTEP, 10 / MICROSTEP, 400 / MICROSTEP)
        for _ in range(devices)
    ]
    planted = faults or {}
    return Chain(
        [
            Device(
                number,
                stage,
                Faults([planted[number]] if number in planted else []),
                100_000 + number,
            )
            for number, stage in enumerate(stages, start=1)
        ],
        threading.RLock(),
    )


@pytest.fixture
def tcp_chain() -> Iterator[TcpLine]:
    """Two devices on TCP, a thousand times faster than real ones."""
    line = TcpLine(chain_of(RunningClock(1000)).open_session)
    yield line
    line.stop()


@pytest.fixture
def pty_chain() -> Iterator[PtyLine]:
    """The same on a pseudo terminal; tests that use it are for systems that have them."""
    line = PtyLine(chain_of(RunningClock(1000)).open_session)
    yield line
    line.stop()


@pytest.fixture
def make_chain() -> Callable[..., Chain]:
    """Makes chains without a line: (clock, devices, faults, start)."""
    return chain_of

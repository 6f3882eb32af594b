"""Ends of a program that drives a bench which reach more than it: a service's end, a fork,
files that somebody takes away.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from drivers import locks
from drivers.bench import connect
from flflab.errors import DeviceError
from sim.serve import Served

ServeSlowly = Callable[..., AbstractContextManager[tuple[Served, Path]]]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and forks of POSIX")
MOVES = """
import os, signal, sys, time
for number in (signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
    signal.signal(number, signal.SIG_DFL)  # nohup and shells in the background have some ignored
from drivers.bench import connect
bench = connect(sys.argv[1])
for name in ("main_lens_stage", "sensor_stage", "array_stage"):
    bench.axes[name].home().wait(20)
bench.array_stage.move_to(18.0)
print("moving", flush=True)
sys.stdin.readline()
os.execv("/bin/sleep", ["sleep", "60"])
"""


@pytest.fixture
def slow(serve_slowly: ServeSlowly) -> Iterator[tuple[Served, Path]]:
    """A bench in real time, served, and a bench file that leads to it."""
    starts = dict.fromkeys(("main_lens_stage", "array_stage", "sensor_stage"), "0.2 mm")
    with serve_slowly("simulated", starts, {"array_stage": "1 mm/s"}) as served:
        yield served


def moves(served: Served, name: str = "array_stage") -> bool:
    return served.world.carriages[name].moving(served.world.clock.now())


def rests_on_the_way(served: Served) -> bool:
    deadline = time.monotonic() + 12  # on a busy machine; the way takes 18 s
    while moves(served):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return 0 < served.world.carriages["array_stage"].at(served.world.clock.now()) < 17.9


@pytest.mark.skipif(sys.platform != "linux", reason="its sentinel is found by /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_to_every_program_of_a_service_stops_its_axes(
    slow: tuple[Served, Path], number: signal.Signals
) -> None:
    served, file = slow
    with program(file) as child:
        children = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
        assert moves(served)
        for process in (*map(int, children), child.pid):
            os.kill(process, number)
        assert rests_on_the_way(served)


def test_a_program_that_becomes_another_one_leaves_no_axis_moving(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with program(file) as child:
        assert moves(served)
        assert child.stdin is not None
        child.stdin.write(b"\n")
        child.stdin.flush()
        assert rests_on_the_way(served)
        with connect(file) as bench:
            bench.array_stage.move_to(1.0).wait(20)


@contextlib.contextmanager
def program(file: Path) -> Generator[subprocess.Popen[bytes]]:
    """A program whose array is under way, killed in the end."""
    command = [sys.executable, "-P", "-c", MOVES, str(file)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"moving\n"
            yield child
        finally:
            child.kill()


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:This process")
def test_a_forked_child_that_closes_the_bench_leaves_it_its_parent_s(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with connect(file) as bench:
        bench.target_stage.home().wait(20)
        status = bench.target_stage.move_to(8.0)
        child = os.fork()
        if child == 0:
            with contextlib.suppress(BaseException):
                bench.close()
            os._exit(0)
        os.waitpid(child, 0)
        assert moves(served, "target_stage")
        with pytest.raises(DeviceError, match="another program drives this bench"):
            connect(file)
        status.wait(30)
        bench.target_stage.move_to(7.9).wait(20)


@pytest.mark.ci
def test_an_owner_whose_files_were_taken_away_moves_nothing_and_takes_away_no_other_s(
    slow: tuple[Served, Path],
) -> None:
    _, file = slow
    first = connect(file)
    first.target_stage.home().wait(20)
    for lock in {lock for files in locks.lock_files(file).values() for lock in files}:
        lock.unlink()
    with connect(file) as second:
        with pytest.raises(DeviceError, match=r"nothing moved: the files in .* were taken away"):
            first.target_stage.move_to(1.0)
        first.close()
        with pytest.raises(DeviceError, match="another program drives this bench"):
            connect(file)
        second.target_stage.move_to(1.0).wait(20)

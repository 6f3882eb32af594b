"""A bench is stopped from outside, whatever else goes wrong; judged by where the simulated stages
are.
"""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers import locks
from drivers.bench import connect
from drivers.owner import lock_files
from drivers.stopping import stop_bench
from flflab.errors import DeviceError, MotionError
from sim.serve import Served

ServeSlowly = Callable[..., AbstractContextManager[tuple[Served, Path]]]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals, pipes and links of POSIX")
MOVING = ("array_stage", "sensor_stage")
STOP = [sys.executable, "-P", "-m", "flflab", "bench", "stop", "--bench"]
OWNER = """
import sys
from drivers.base import wait_all
from drivers.bench import connect
from flflab.errors import DeviceError
with connect(sys.argv[1]) as bench:
    for name in ("main_lens_stage", "sensor_stage", "array_stage"):
        bench.axes[name].home().wait(60)
    moving = [bench.axes[name].move_to(18.0) for name in ("array_stage", "sensor_stage")]
    print("moving", flush=True)
    ends = [status.exception(60) for status in moving]
    print(ends[0], flush=True)
    sys.stdin.readline()
    try:
        bench.array_stage.move_to(1.0).wait(60)
        print("moved again", flush=True)
    except DeviceError as error:
        print(error, flush=True)
"""


@pytest.fixture(params=["tcp", "pty"])
def line(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def slow(serve_slowly: ServeSlowly, line: str) -> Iterator[tuple[Served, Path]]:
    """A bench in real time, served on TCP or pseudo terminals, and a bench file to it."""
    starts = dict.fromkeys((*MOVING, "main_lens_stage"), "0.2 mm")
    speeds = dict.fromkeys(MOVING, "4 mm/s")
    with serve_slowly("simulated", starts, speeds, pty=line == "pty") as served:
        yield served


@contextlib.contextmanager
def owner(file: Path, program: str = OWNER) -> Generator[subprocess.Popen[str]]:
    """A program that drives the bench, its axes under way; killed in the end."""
    command = [sys.executable, "-P", "-c", program, str(file)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as child:
        try:
            assert said(child) == "moving"
            yield child
        finally:
            child.kill()


def said(child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None
    return child.stdout.readline().rstrip("\n")


def ask(child: subprocess.Popen[str]) -> str:
    assert child.stdin is not None
    child.stdin.write("\n")
    child.stdin.flush()
    return said(child)


def at_rest(served: Served) -> bool:
    now = served.world.clock.now()
    return not any(carriage.moving(now) for carriage in served.world.carriages.values())


def comes_to_rest(served: Served, seconds: float = 3.0) -> bool:
    deadline = time.monotonic() + seconds
    while not at_rest(served):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def rests_soon(served: Served) -> bool:
    return comes_to_rest(served) and all(
        0 < served.world.carriages[name].at(served.world.clock.now()) < 17.9 for name in MOVING
    )


def test_a_stop_returns_when_every_axis_reads_at_rest_and_latches(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with owner(file) as child:
        ended = subprocess.run([*STOP, str(file)], capture_output=True, text=True, check=False)
        assert at_rest(served)
        assert (ended.returncode, ended.stdout) == (0, "All axes stopped.\n"), ended.stderr
        assert re.search(
            "stopped on the way at|another program had this bench stopped", said(child)
        )
        assert "another program had this bench stopped" in ask(child)
        child.wait(20)  # the next who connects finds the line free
    with connect(file) as bench:  # a new connection may move
        bench.array_stage.move_to(1.0).wait(20)


@pytest.mark.ci
def test_an_owner_that_is_frozen_is_stopped_past_and_moves_nothing_when_it_thaws(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with owner(file) as child:
        os.kill(child.pid, signal.SIGSTOP)
        ended = subprocess.run([*STOP, str(file)], capture_output=True, text=True, check=False)
        assert at_rest(served)
        assert rests_soon(served)
        assert ended.returncode == 0, ended.stderr
        assert f"process {child.pid} drives this bench and does not answer" in ended.stderr
        os.kill(child.pid, signal.SIGCONT)
        said(child)
        assert "another program had this bench stopped" in ask(child)
        assert at_rest(served)


def test_a_program_that_is_suspended_by_ctrl_z_leaves_no_axis_moving(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with owner(file) as child:
        os.kill(child.pid, signal.SIGTSTP)  # no shell is there to handle it
        os.kill(child.pid, signal.SIGSTOP)
        assert rests_soon(served)
        os.kill(child.pid, signal.SIGCONT)


@pytest.fixture
def tcp_only(line: str) -> None:
    if line != "tcp":
        pytest.skip("has nothing to do with the line")


def strangers(place: Path) -> list[Callable[[], object]]:
    def fifo() -> None:
        os.mkfifo(place)

    return [
        fifo,
        lambda: place.symlink_to("/dev/zero"),
        lambda: place.symlink_to("/dev/tty"),
        place.mkdir,
        lambda: place.write_bytes(b"\0" * 10_000_000),
        lambda: place.write_text("[1, 2]"),
        lambda: place.write_text('{"port": 1e400, "process": [], "bench": 7}'),
    ]


@pytest.mark.usefixtures("tcp_only")
@pytest.mark.parametrize("which", range(7))
def test_strange_files_where_locks_lie_are_not_opened_and_delay_no_stop(
    slow: tuple[Served, Path], which: int
) -> None:
    served, file = slow
    with connect(file) as bench:
        bench.sensor_stage.home().wait(20)
        files = {name: found[0] for name, found in lock_files(file).items()}
    other = locks.folder() / f"{locks.PREFIX}{'0' * 24}.{locks.user()}{locks.LOCK}"
    for place in (files["array_stage"], other):
        strangers(place)[which]()
    try:
        served.world.carriages["array_stage"]
        begun = time.monotonic()
        assert stop_bench(file).faults == []
        assert time.monotonic() - begun < 2
        with connect(file) as bench:  # what is this user's own is taken away
            assert bench.sensor_stage.is_homed()
    finally:
        for place in (files["array_stage"], other):
            if place.is_dir():
                place.rmdir()
            else:
                place.unlink(missing_ok=True)


FORGED = """
import fcntl, json, socket, sys
server = socket.create_server(("127.0.0.1", 0))
held = []
for name in sys.argv[1:]:
    held.append(open(name, "w"))
    json.dump({"process": 1, "port": server.getsockname()[1], "bench": ""}, held[-1])
    held[-1].flush()
    fcntl.flock(held[-1], fcntl.LOCK_EX)
print("moving", flush=True)
while True:
    link, _ = server.accept()
    link.recv(100)
    link.sendall(b"heard\\nstopped\\n")
    link.close()
"""


@pytest.mark.usefixtures("tcp_only")
def test_a_forged_owner_that_says_all_stopped_does_not_satisfy_a_stop(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with owner(file) as child:
        child.kill()
        child.wait()
        assert rests_soon(served)
    files = sorted({str(found) for several in lock_files(file).values() for found in several})
    place = served.addresses["axes"]["sensor_stage"]["address"]
    host, port = place.rsplit(":", 1)
    command = [sys.executable, "-P", "-c", FORGED, *files]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as forged,
        socket.create_connection((host, int(port))) as stage,
    ):
        try:
            assert said(forged) == "moving"
            stage.sendall(b"/3 move vel 2000\n")  # whoever else moves it
            assert stage.recv(100)
            assert not at_rest(served)
            assert stop_bench(file).faults == []
            assert at_rest(served)
        finally:
            forged.kill()
    for name in files:
        Path(name).unlink()


@pytest.mark.usefixtures("tcp_only")
def test_connections_held_open_at_the_owners_port_delay_no_stop(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    with connect(file) as bench, contextlib.ExitStack() as held:
        for name in ("main_lens_stage", "sensor_stage", "array_stage"):
            bench.axes[name].home().wait(20)
        lock = lock_files(file)["array_stage"][0]
        port = json.loads(lock.read_text())["port"]
        for _ in range(100):
            held.enter_context(socket.create_connection(("127.0.0.1", port)))
        status = bench.array_stage.move_to(18.0)
        begun = time.monotonic()
        assert stop_bench(file).faults == []
        assert time.monotonic() - begun < 2
        assert at_rest(served)
        with pytest.raises(MotionError, match="stopped on the way"):
            status.wait(10)


def test_a_stop_waits_for_no_lock_of_the_program_that_drives(slow: tuple[Served, Path]) -> None:
    """Every lock that a motion or an exchange takes is held by somebody who never lets it go."""
    served, file = slow
    with connect(file) as bench:
        for name in ("main_lens_stage", "sensor_stage", "array_stage"):
            bench.axes[name].home().wait(20)
        status = bench.array_stage.move_to(18.0)
        chain = bench.array_stage._commands._chain  # noqa: SLF001  # pyright: ignore
        with bench.array_stage._starting, bench._watching, chain._turns.take():  # noqa: SLF001  # pyright: ignore
            stopping = threading.Thread(target=bench.array_stage.stop)
            stopping.start()
            assert comes_to_rest(served)
            assert served.world.carriages["array_stage"].at(served.world.clock.now()) < 17
        stopping.join()
        with pytest.raises(MotionError):
            status.wait(20)


@pytest.mark.usefixtures("tcp_only")
def test_a_line_that_cannot_be_reached_is_told_of_and_the_others_are_stopped(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    data = yaml.safe_load(file.read_text())
    data["axes"]["target_stage"]["address"] = "socket://127.0.0.1:9"
    file.write_text(yaml.safe_dump(data))
    (fault,) = stop_bench(file).faults
    assert fault.startswith("target_stage:")
    assert "cut its power" in fault
    with pytest.raises(DeviceError, match="target_stage"), connect(file):
        pass
    assert at_rest(served)


@pytest.mark.usefixtures("tcp_only")
def test_a_name_server_that_says_nothing_delays_no_stop_of_another_line(
    slow: tuple[Served, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served, file = slow
    data = yaml.safe_load(file.read_text())
    data["axes"] = {"target_stage": data["axes"]["target_stage"], **data["axes"]}
    data["axes"]["target_stage"]["address"] = "socket://stage.invalid:4001"
    named = tmp_path / "named.yaml"
    named.write_text(yaml.safe_dump(data, sort_keys=False))
    ask, end = socket.getaddrinfo, threading.Event()

    def silent(host: str, *further: Any, **named: Any) -> Any:
        if host == "stage.invalid":
            assert end.wait(60)
            raise socket.gaierror("no answer")
        return ask(host, *further, **named)

    monkeypatch.setattr(socket, "getaddrinfo", silent)
    with owner(file):
        stopping = threading.Thread(target=stop_bench, args=(named,))
        stopping.start()
        try:
            assert rests_soon(served)
            assert stopping.is_alive()
        finally:
            end.set()
            stopping.join()

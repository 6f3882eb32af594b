# longer than 450 lines because one subject's sentences of behaviour stand together
"""Who drives a bench: one program at a time, stopped by others through it, and by its sentinel when
it dies.
"""

import contextlib
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
import yaml

from drivers.axis import Axis
from drivers.bench import connect
from drivers.owner import Owner, ask_owners_to_stop, lock_files
from drivers.sentinel import Sentinel
from flflab.errors import DeviceError, MotionError
from sim.serve import Served

ServeSlowly = Callable[..., AbstractContextManager[tuple[Served, Path]]]
MOVING = ("array_stage", "rotation_stage", "ring")
DRIVER = """
import sys, time
from drivers.base import wait_all
from drivers.bench import connect
with connect(sys.argv[1]) as bench:
    for names in (("array_stage", "sensor_stage"), ("rotation_stage", "goniometer", "ring")):
        wait_all(*(bench.axes[name].home() for name in names))
    moving = [bench.axes[name] for name in ("array_stage", "rotation_stage", "ring")]
    for axis in moving:
        axis.move_to(0.6 * axis.limits[1])
    print("moving", flush=True)
    time.sleep(60)
"""


EDITED = DRIVER.replace("as bench:", "as bench:\n    open(sys.argv[1], 'w').write('axes: {}')", 1)
INTERRUPTED = """
import os, signal, sys, threading, time
from flflab.cli import main
started = threading.Event()
sys.setprofile(lambda frame, event, what: started.set() if frame.f_code.co_name == "_have_sentinel" and event == "call" else None)
threading.Thread(target=lambda: (started.wait(), time.sleep(0.05), os.kill(os.getpid(), signal.SIGINT)), daemon=True).start()
sys.argv = ["flflab", "bench", "home", "ring", "--bench", sys.argv[1]]
main()
"""  # noqa: E501


@pytest.fixture
def slow(serve_slowly: ServeSlowly) -> Iterator[tuple[Served, Path]]:
    """A bench in real time that stands near its references, served; and a bench file to it."""
    starts = {
        "array_stage": "0.2 mm",
        "sensor_stage": "2 mm",
        "rotation_stage": "0.1 deg",
        "ring": "1 deg",
    }
    speeds = {"array_stage": "4 mm/s", "rotation_stage": "1 deg/s", "ring": "12 deg/s"}
    with serve_slowly("full", starts, speeds) as served:
        yield served


@contextlib.contextmanager
def another_program(file: Path, program: str = DRIVER) -> Generator[subprocess.Popen[bytes]]:
    """A program that moves three axes of three makers, killed in the end."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", program, str(file)], stdout=subprocess.PIPE
    ) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"moving\n"
            yield child
        finally:
            child.kill()


def at_rest(served: Served) -> bool:
    now = served.world.clock.now()
    return not any(served.world.carriages[name].moving(now) for name in MOVING)


@pytest.mark.parametrize(
    "program",
    [DRIVER, EDITED],
    ids=["as it is", "whose bench file was edited before the first motion"],
)
def test_when_the_owner_is_killed_its_sentinel_stops_every_axis_on_the_way(
    slow: tuple[Served, Path], program: str
) -> None:
    served, file = slow
    described = file.read_text(encoding="utf-8")
    with another_program(file, program) as child:
        assert not at_rest(served)
        child.kill()
    deadline = time.monotonic() + 20
    while not at_rest(served):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    places = {name: served.world.carriages[name].at(served.world.clock.now()) for name in MOVING}
    assert 0 < places["array_stage"] < 29
    assert 0 < math.degrees(places["rotation_stage"]) < 5.9
    assert 0 < math.degrees(places["ring"]) < 100
    file.write_text(described, encoding="utf-8")
    with connect(file) as bench:  # the lock died with its owner
        assert not any(bench.axes[name].is_moving() for name in MOVING)


def sentinels() -> list[int]:
    """Process numbers of this process's sentinels."""
    children = Path(f"/proc/{os.getpid()}/task").glob("*/children")
    pids = [int(pid) for file in children for pid in file.read_text().split()]
    return [pid for pid in pids if b"drivers.sentinel" in Path(f"/proc/{pid}/cmdline").read_bytes()]


@pytest.mark.skipif(
    sys.platform == "win32", reason="an interrupt cannot be sent to one process alone there"
)
def test_an_interrupt_while_the_sentinel_starts_is_told_in_one_sentence(
    slow: tuple[Served, Path],
) -> None:
    _, file = slow
    program = [sys.executable, "-P", "-c", INTERRUPTED, str(file)]
    ended = subprocess.run(program, capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr) == (130, "\nflflab: interrupted\n")


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_a_sentinel_that_has_died_is_followed_by_another_before_the_next_motion(
    slow: tuple[Served, Path],
) -> None:
    _, file = slow
    with connect(file) as bench:
        bench.ring.home().wait(20)
        (first,) = sentinels()
        os.kill(first, signal.SIGKILL)
        deadline = time.monotonic() + 5
        # Its last thread must have ended too: until then it is not over for who waits for it.
        while (
            Path(f"/proc/{first}/stat").read_text().rpartition(") ")[2][0] != "Z"
            or len(list(Path(f"/proc/{first}/task").iterdir())) > 1
        ):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        bench.ring.move_to(math.radians(2)).wait(20)
        (second,) = sentinels()
        assert second != first


def test_a_sentinel_watches_until_every_axis_stands(
    slow: tuple[Served, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    served, file = slow
    stood, let_go = list[bool](), Sentinel.close

    def close(sentinel: Sentinel) -> None:
        stood.append(at_rest(served))
        let_go(sentinel)

    monkeypatch.setattr(Sentinel, "close", close)
    with connect(file) as bench:
        bench.ring.home().wait(20)
        bench.ring.move_to(math.radians(160))
        assert not at_rest(served)
    assert stood == [True]


def test_another_program_is_refused_and_can_have_the_owner_stop(slow: tuple[Served, Path]) -> None:
    served, file = slow
    with another_program(file) as child:
        with pytest.raises(
            DeviceError,
            match=rf"\(process {child.pid}\).*Wait until it finishes\. .* stops its axes and ends",
        ):
            connect(file)
        assert set(ask_owners_to_stop(file).values()) == {""}
        deadline = time.monotonic() + 5
        while not at_rest(served):
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_stop_reaches_the_motions_of_a_script_through_its_own_connection(
    slow: tuple[Served, Path],
) -> None:
    _, file = slow
    with connect(file) as bench:
        bench.ring.home().wait(20)
        status = bench.ring.move_to(math.radians(160))
        asker = threading.Thread(target=ask_owners_to_stop, args=(file,))
        asker.start()
        with pytest.raises(MotionError, match=r"stopped on the way at \d+\.\d+ deg"):
            status.wait(10)
        asker.join()
    assert set(ask_owners_to_stop(file).values()) == {None}, (
        "a bench that was let go still has an owner"
    )


def test_a_stop_that_comes_while_every_axis_stands_keeps_the_owner_from_moving_any(
    slow: tuple[Served, Path],
) -> None:
    _, file = slow
    with connect(file) as bench:
        bench.ring.home().wait(20)
        assert set(ask_owners_to_stop(file).values()) == {""}
        with pytest.raises(
            DeviceError,
            match=(
                "ring: asked to move, nothing moved: another program had this bench stopped;"
                " connect again"
            ),
        ):
            bench.ring.move_to(math.radians(160))
        assert bench.ring.position() == pytest.approx(0, abs=1e-4)
    with connect(file) as bench:
        bench.ring.move_to(math.radians(2)).wait(20)


def test_a_copy_of_the_bench_file_is_the_same_bench_even_where_it_is_half_edited(
    slow: tuple[Served, Path], tmp_path: Path
) -> None:
    _, file = slow
    copy = tmp_path / "copy.yaml"
    copy.write_text(
        file.read_text(encoding="utf-8").replace("minimum_gap", "minimal_gap"), encoding="utf-8"
    )
    with connect(file):
        with pytest.raises(DeviceError, match="another program drives this bench"):
            Owner(copy)
        assert set(ask_owners_to_stop(copy).values()) == {""}
    assert set(ask_owners_to_stop(copy).values()) == {None}


def test_an_owner_that_does_not_answer_is_named(slow: tuple[Served, Path]) -> None:
    _, file = slow
    with connect(file):
        for lock in lock_files(file)["ring"]:
            lock.write_text('{"process": 4711, "port": 9, "token": "none"}')
        answers = ask_owners_to_stop(file)
        assert "process 4711 drives this bench and does not answer" in (answers["ring"] or "")
        assert answers["array_stage"] == "", "of two owners the other was not asked"


@pytest.mark.skipif(sys.platform == "win32", reason="no program can be held there")
def test_axes_of_an_owner_that_hangs_are_stopped_past_it_and_it_goes_on_with_none(
    slow: tuple[Served, Path],
) -> None:
    served, file = slow
    command = [sys.executable, "-P", "-m", "flflab", "bench", "stop", "--bench", str(file)]
    with another_program(file) as child:
        os.kill(child.pid, signal.SIGSTOP)
        assert not at_rest(served)
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        deadline = time.monotonic() + 2
        while not at_rest(served):
            assert time.monotonic() < deadline, "told to stop, an axis did not come to rest"
            time.sleep(0.005)
        places = [served.world.carriages[name].at(served.world.clock.now()) for name in MOVING]
        assert 0 < places[0] < 29
        assert 0 < math.degrees(places[1]) < 5.9
        assert 0 < math.degrees(places[2]) < 100
        os.kill(child.pid, signal.SIGCONT)
        time.sleep(0.5)
        assert [
            served.world.carriages[name].at(served.world.clock.now()) for name in MOVING
        ] == places
    assert (ended.returncode, ended.stdout) == (0, "All axes stopped.\n")
    assert f"process {child.pid} drives this bench and does not answer" in ended.stderr
    assert f"`kill -9 {child.pid}`" in ended.stderr
    assert ended.stderr.endswith("past it every axis was stopped\n")


def test_only_who_may_read_its_key_can_stop_a_bench_through_its_owner(
    slow: tuple[Served, Path],
) -> None:
    _, file = slow
    with connect(file):
        for lock in lock_files(file)["array_stage"]:
            key = lock.with_suffix(".key")
            assert "token" not in lock.read_text()
            if sys.platform != "win32":
                assert key.stat().st_mode & 0o077 == 0
            key.write_text(key.read_text().replace('"token": "', '"token": "x'))
        assert "did not say that the axes stopped" in (
            ask_owners_to_stop(file)["array_stage"] or ""
        )


def test_a_bench_is_the_same_one_however_its_addresses_are_spelt(
    slow: tuple[Served, Path], tmp_path: Path
) -> None:
    _, file = slow
    other = tmp_path / "other.yaml"
    other.write_text(
        file.read_text(encoding="utf-8").replace("socket://127.0.0.1", "localhost"),
        encoding="utf-8",
    )
    assert "localhost" in other.read_text(encoding="utf-8")
    with connect(file):
        with pytest.raises(DeviceError, match="another program drives this bench"):
            Owner(other)
        assert set(ask_owners_to_stop(other).values()) == {""}
    Owner(other).close()


def test_a_bench_that_shares_one_line_with_another_is_not_driven_beside_it_and_stops_all_of_both(
    slow: tuple[Served, Path], tmp_path: Path
) -> None:
    _, file = slow
    whole = yaml.safe_load(file.read_text(encoding="utf-8"))
    part = tmp_path / "part.yaml"
    part.write_text(yaml.safe_dump({"axes": {"stage": whole["axes"]["ring"]}}), encoding="utf-8")
    with connect(file):
        with pytest.raises(DeviceError, match="another program drives this bench"):
            Owner(part)
        assert ask_owners_to_stop(part) == {"stage": ""}
    owner = Owner(part)
    try:
        with pytest.raises(DeviceError, match="another program drives this bench"):
            connect(file)
        owner.stops_with(lambda: None)
        others = {
            name
            for name, axis in whole["axes"].items()
            if axis["address"] != whole["axes"]["ring"]["address"]
        }
        assert {
            name for name, answer in ask_owners_to_stop(file).items() if answer is None
        } == others
    finally:
        owner.close()


@pytest.mark.skipif(sys.platform == "win32", reason="every account has a folder there")
def test_an_account_without_a_folder_of_its_own_owns_a_bench_too(
    slow: tuple[Served, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    import pwd

    def nobody(number: int) -> None:
        raise KeyError(number)

    monkeypatch.delenv("HOME")
    monkeypatch.setattr(pwd, "getpwuid", nobody)
    with connect(slow[1]), pytest.raises(DeviceError, match="another program drives this bench"):
        Owner(slow[1])


@pytest.mark.skipif(sys.platform == "win32", reason="there ports are no files")
def test_the_owner_of_a_port_is_found_by_the_link_to_it_also_after_the_link_has_gone(
    tmp_path: Path,
) -> None:
    port, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    files = [tmp_path / f"{address.name}.yaml" for address in (port, link)]
    for file, address in zip(files, (port, link), strict=True):
        file.write_text(
            yaml.safe_dump({"axes": {"stage": {"driver": "zaber", "address": str(address)}}}),
            encoding="utf-8",
        )
    owner = Owner(files[1])
    try:
        with pytest.raises(DeviceError, match="another program drives this bench"):
            Owner(files[0])
        link.unlink()
        with pytest.raises(DeviceError, match="another program drives this bench"):
            Owner(files[1])
    finally:
        owner.close()
    Owner(files[0]).close()


def test_the_two_files_that_macos_has_for_a_port_are_one_line(tmp_path: Path) -> None:
    files = [tmp_path / "tty.yaml", tmp_path / "cu.yaml"]
    for file in files:
        axis = {"driver": "zaber", "address": f"/dev/{file.stem}.usbserial-1"}
        file.write_text(yaml.safe_dump({"axes": {"stage": axis}}), encoding="utf-8")
    owner = Owner(files[0])
    try:
        with pytest.raises(DeviceError, match="another program drives this bench"):
            Owner(files[1])
    finally:
        owner.close()


def test_a_stop_of_one_bench_leaves_the_other_benches_of_the_same_user_alone(
    tmp_path: Path,
) -> None:
    owners: dict[str, Owner] = {}
    for name in ("one", "other"):
        file = tmp_path / f"{name}.yaml"
        axis = {"driver": "zaber", "address": f"/dev/flflab-{name}"}
        file.write_text(yaml.safe_dump({"axes": {"stage": axis}}), encoding="utf-8")
        owners[name] = Owner(file)
        owners[name].stops_with(lambda: None)
    try:
        assert ask_owners_to_stop(tmp_path / "one.yaml")["stage"] == ""
        assert owners["one"].told_to_stop()
        assert not owners["other"].told_to_stop()
    finally:
        for owner in owners.values():
            owner.close()


@pytest.mark.ci
def test_simulated_benches_of_one_file_can_be_driven_side_by_side(root: Path) -> None:
    file = root / "examples" / "benches" / "simulated.yaml"
    with contextlib.ExitStack() as both:
        first, second = (both.enter_context(connect(file)) for _ in range(2))
        assert first.array_stage is not second.array_stage


FORKS = """
import os, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from drivers.bench import connect
bench = connect(sys.argv[1])
if sys.argv[2] == "after":
    bench.ring.home().wait(20)  # the sentinel has begun
pool = ProcessPoolExecutor(2, get_context("fork"))
list(pool.map(abs, range(8)))
for names in (("main_lens_stage", "sensor_stage"), ("array_stage",)):
    for status in [bench.axes[name].home() for name in names]:
        status.wait(20)
bench.array_stage.move_to(18.0)
print("moving", flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="nothing is forked there")
@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.filterwarnings("ignore:This process")
def test_a_killed_owner_s_axes_stop_whatever_it_forked(
    slow: tuple[Served, Path], when: str
) -> None:
    served, file = slow
    command = [sys.executable, "-P", "-W", "ignore", "-c", FORKS, str(file), when]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"moving\n"
            assert not at_rest(served)
            os.kill(child.pid, signal.SIGKILL)
            deadline = time.monotonic() + 5
            while not at_rest(served):
                assert time.monotonic() < deadline
                time.sleep(0.01)
            place = served.world.carriages["array_stage"].at(served.world.clock.now())
            assert 0 < place < 17
            with connect(file) as bench:  # its workers live and hold no lock and no line
                bench.array_stage.move_to(1.0).wait(20)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)


@pytest.mark.ci
@pytest.mark.skipif(sys.platform == "win32", reason="nothing is forked there")
@pytest.mark.filterwarnings("ignore:This process")
def test_a_forked_child_moves_nothing_and_its_end_stops_nothing(slow: tuple[Served, Path]) -> None:
    served, file = slow
    with connect(file) as bench:
        bench.ring.home().wait(20)
        status = bench.ring.move_to(math.radians(100))
        child = os.fork()
        if child == 0:
            moved = 1
            with contextlib.suppress(BaseException), bench:
                with contextlib.suppress(DeviceError):
                    bench.rotation_stage.home()
                    moved = 2
                raise RuntimeError("the child fails")
            os._exit(moved)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
        assert served.world.carriages["ring"].moving(served.world.clock.now())
        assert not served.world.carriages["rotation_stage"].moving(served.world.clock.now())
        status.wait(30)


@pytest.mark.skipif(sys.platform == "win32", reason="there the place is another")
@pytest.mark.parametrize(
    ("changed", "environment"),
    [
        ("127.0.0.1", {"TMPDIR": "/var/tmp"}),  # noqa: S108
        ("127.0.0.1", {"HOME": "/nonexistent", "XDG_RUNTIME_DIR": "/nonexistent"}),
        ("127.1", {}),
        ("0x7f000001", {}),
        ("[::ffff:127.0.0.1]", {}),
    ],
)
def test_one_line_has_one_owner_whatever_its_address_is_called_and_wherever_files_go(
    slow: tuple[Served, Path], tmp_path: Path, changed: str, environment: dict[str, str]
) -> None:
    _, file = slow
    other = tmp_path / "other.yaml"
    other.write_text(file.read_text().replace("socket://127.0.0.1", f"socket://{changed}"))
    program = "import sys; from drivers.bench import connect; connect(sys.argv[1])"
    with connect(file):
        second = subprocess.run(
            [sys.executable, "-P", "-c", program, str(other)],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=False,
        )
    assert f"another program drives this bench (process {os.getpid()})" in second.stderr


def home_and_fail(axis: Axis) -> None:
    axis.home()
    raise RuntimeError("it fails")


def test_a_program_that_leaves_stops_only_what_it_started(
    slow: tuple[Served, Path], other_address: Callable[[str], str], tmp_path: Path
) -> None:
    """Another computer drives the same stages: no lock tells of it."""
    served, file = slow
    elsewhere = tmp_path / "elsewhere.yaml"
    elsewhere.write_text(
        re.sub(
            r"socket://127\.0\.0\.1:\d+",
            lambda found: other_address(found[0]),
            file.read_text(),
        )
    )
    with connect(file) as bench:
        bench.ring.home().wait(20)
        status = bench.ring.move_to(math.radians(60))
        with pytest.raises(RuntimeError, match="it fails"), connect(elsewhere) as other:
            home_and_fail(other.sensor_stage)
        assert served.world.carriages["ring"].moving(served.world.clock.now())
        now = served.world.clock.now()
        assert not served.world.carriages["sensor_stage"].moving(now + 1.0)
        status.wait(30)

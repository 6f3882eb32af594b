"""Connecting to a whole bench: every fault at once, nothing left open, one stop for all, a
simulated bench that dies with its parent.
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml

import drivers
from drivers.base import wait_all
from drivers.bench import ConnectedBench, connect_described
from drivers.simulated import SimulatedBench
from flflab.bench import read_bench, with_seed
from flflab.errors import CommunicationError, DeviceError, InputError, MotionError

Write = Callable[..., Path]


@pytest.fixture
def write(root: Path, tmp_path: Path) -> Write:
    """Write a copy of the built-in bench with changes, each a path such as
    ``axes.array_stage.device`` and a value (None: without it).
    """

    def write(changes: dict[str, Any]) -> Path:
        source = root / "examples" / "benches" / "simulated.yaml"
        bench = yaml.safe_load(source.read_text(encoding="utf-8"))
        bench["optics"] = str((source.parent / bench["optics"]).resolve())
        for path, value in changes.items():
            *places, last = path.split(".")
            place = bench
            for part in places:
                place = place[part]
            place.pop(last) if value is None else place.update({last: value})
        file = tmp_path / "bench.yaml"
        file.write_text(yaml.safe_dump(bench, sort_keys=False), encoding="utf-8")
        return file

    return write


def nowhere() -> dict[str, Any]:
    axes = {
        f"axes.{name}_stage.address": "127.0.0.1:9"
        for name in ("main_lens", "array", "sensor", "target")
    }
    return axes | {f"{name}.address": "127.0.0.1:10" for name in ("camera", "iris", "target")}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (
            {"axes.array_stage.driver": "zabre"},
            (
                r"axes\.array_stage\.driver: there is no driver 'zabre' here; there are zaber,"
                r" thorlabs, oriental, standa, manual"
            ),
        ),
        (
            {"camera.driver": "kodak"},
            r"camera\.driver: there is no driver 'kodak' here; there are scpi",
        ),
        ({"axes.array_stage.device": None}, r"axes\.array_stage\.device: this field is missing"),
        ({"axes.array_stage.device": 100}, r"axes\.array_stage\.device: .*not 100"),
        ({"axes.array_stage.microstep": 0.5}, r"axes\.array_stage\.microstep: 0\.5 has no unit"),
        (
            {"axes.array_stage.microstpe": "1 um"},
            r"axes\.array_stage\.microstpe: there is no such field, did you mean microstep\?",
        ),
        (
            {"axes.sensor_stage.limits": ["0 mm", "fifty"]},
            r"axes\.sensor_stage\.limits\.1: 'fifty' is not a quantity",
        ),
    ],
)
def test_a_wrong_key_is_refused_with_file_line_and_field(
    changes: dict[str, Any], says: str, write: Write
) -> None:
    file = write({**nowhere(), **changes})
    with pytest.raises(InputError, match=rf"bench\.yaml:\d+: {says}"):
        drivers.connect(file)


def test_all_faults_of_the_file_come_at_once_and_nothing_is_opened(
    write: Write, dialogue: Callable[..., str]
) -> None:
    wrong = {
        "axes.array_stage.driver": "zabre",
        "axes.sensor_stage.address": "nonsense:port",
        "iris.address": "192.168.0.1",
    }
    with pytest.raises(InputError) as caught:
        drivers.connect(write({**nowhere(), "axes.main_lens_stage.address": dialogue([]), **wrong}))
    faults = str(caught.value).split("\n")
    expected = (
        "array_stage.driver: there is no driver 'zabre'",
        "sensor_stage.address: 'nonsense:port' is",
        "iris.address: '192.168.0.1' is",
    )
    assert len(faults) == len(expected)
    for fault, says in zip(faults, expected, strict=True):
        assert says in fault


def test_all_who_do_not_answer_are_told_at_once_and_nothing_stays_open(
    write: Write, toy_chain: Callable[..., str], toy_stage: type[Any]
) -> None:
    good = toy_chain(toy_stage())
    with pytest.raises(CommunicationError) as caught:
        drivers.connect(
            write(
                {
                    **nowhere(),
                    "axes.main_lens_stage.address": good,
                    "axes.main_lens_stage.device": 1,
                }
            )
        )
    faults = str(caught.value).split("\n")
    assert len(faults) == 6
    assert all("cannot be reached" in fault for fault in faults)
    for name in ("array_stage", "sensor_stage", "target_stage", "camera", "iris", "target"):
        assert any(fault.startswith(name) for fault in faults), name


def manual_but_axes(chain: str) -> dict[str, Any]:
    axes = {
        f"axes.{name}_stage.address": chain for name in ("main_lens", "array", "sensor", "target")
    }
    others = {name: {"driver": "manual"} for name in ("iris", "target")}
    return {**axes, **others}


class Silent:
    """An SCPI camera that says the least a camera has to say."""

    LINES = (
        (b"*CLS;ABOR;*RST;SYST:ERR?\n", b'0,"No error"\n'),
        (
            (
                b"*CLS;SENS:FULL?;SENS:OFFS?;SENS:READ?;EXP? MIN;EXP? MAX;GAIN? MIN;GAIN?"
                b" MAX;SYST:ERR?\n"
            ),
            b'4095;64;0.05;1e-05;10;1;16;0,"No error"\n',
        ),
        (b"*CLS;SENS:SIZE?;FORM?;SYST:ERR?\n", b'3,2;"MONO12";0,"No error"\n'),
        (b"*CLS;EXP?;GAIN?;SENS:CONV?;SENS:NOIS?;SYST:ERR?\n", b'0.01;1;4;3;0,"No error"\n'),
    )


@pytest.fixture
def resources() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_one_axis_that_does_not_answer_keeps_no_other_from_stopping(
    write: Write,
    toy_chain: Callable[..., str],
    toy_stage: type[Any],
    dialogue: Callable[..., str],
    resources: ExitStack,
) -> None:
    stages = [toy_stage() for _ in range(4)]
    file = write(
        {**manual_but_axes(toy_chain(*stages)), "camera.address": dialogue(list(Silent.LINES))}
    )
    bench = resources.enter_context(drivers.connect(file))
    statuses = [axis.move_to(axis.limits[1] * 0.25) for axis in bench.axes.values()]
    stages[0].fault = lambda _text, _reply: b""
    begin = time.monotonic()
    with pytest.raises(DeviceError, match="main_lens_stage") as caught:
        bench.stop()
    assert time.monotonic() - begin < 5
    assert "array_stage" not in str(caught.value)
    for name, stage, status in zip(bench.axes, stages, statuses, strict=True):
        assert not stage.busy, name
        assert isinstance(
            status.exception(5), MotionError if stage is not stages[0] else DeviceError
        )
    stages[0].fault = None


def fail_while_moving(bench: ConnectedBench) -> None:
    bench.target_stage.move_to(30.0)
    raise RuntimeError("the plan failed")


def test_leaving_a_bench_after_an_error_stops_the_axes_that_it_started_and_no_others(
    write: Write, toy_chain: Callable[..., str], toy_stage: type[Any], dialogue: Callable[..., str]
) -> None:
    stages = [toy_stage(speed=10000.0) for _ in range(4)]
    file = write(
        {**manual_but_axes(toy_chain(*stages)), "camera.address": dialogue(list(Silent.LINES))}
    )
    bench = drivers.connect(file)
    with pytest.raises(RuntimeError, match="the plan failed"), bench:
        fail_while_moving(bench)
    assert not stages[3].busy
    assert "stop" not in stages[0].heard
    with pytest.raises(
        AttributeError, match="the bench has no mirror; its axes are main_lens_stage"
    ):
        _ = bench.mirror


def test_address_simulated_starts_a_bench_and_ends_it(root: Path) -> None:
    with drivers.connect(root / "examples" / "benches" / "simulated.yaml") as bench:
        wait_all(bench.array_stage.home(), bench.sensor_stage.home(), timeout=20)
        bench.array_stage.move_to(12.5).wait(20)
        assert bench.world("array.z") == pytest.approx(52.5, abs=0.001)


@pytest.mark.skipif(
    sys.platform == "win32", reason="an interrupt cannot be sent to one process alone there"
)
def test_a_simulated_bench_whose_start_is_interrupted_ends(root: Path) -> None:
    """No process is left behind, which conftest sees to, and no thread."""
    threads = set(threading.enumerate())
    threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            SimulatedBench(root / "examples" / "benches" / "simulated.yaml", seed=1)
    finally:
        signal.signal(signal.SIGINT, before)
    assert not {
        thread.name
        for thread in set(threading.enumerate()) - threads
        if not isinstance(thread, threading.Timer)
    }


def test_a_simulated_bench_that_does_not_start_says_its_last_words(tmp_path: Path) -> None:
    with pytest.raises(
        CommunicationError,
        match=r"the simulated bench did not start, it ended .*its last words: .*no-such",
    ):
        SimulatedBench(tmp_path / "no-such.yaml", seed=0)


@pytest.mark.skipif(sys.platform == "win32", reason="a shell stands for Python")
def test_what_simulates_a_bench_is_told_its_file_and_the_seed_that_it_has_now(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, shell = root / "examples" / "benches" / "simulated.yaml", tmp_path / "shell"
    shell.write_text('#!/bin/sh\necho "$@" >&2\n')
    shell.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(shell))
    with pytest.raises(
        CommunicationError,
        match=rf"last words: -P -m flflab sim {re.escape(str(file))} --json --seed 4711",
    ):
        connect_described(with_seed(read_bench(file), 4711))


@pytest.mark.ci
def test_a_simulated_bench_is_asked_for_its_first_frame_when_what_draws_it_is_compiled(
    root: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bench = SimulatedBench(root / "examples" / "benches" / "simulated.yaml", seed=1)
    try:
        with pytest.raises(
            CommunicationError,
            match=(
                r"simulated\.yaml: the simulated bench still compiles .* after 0 s; see what else"
            ),
        ):
            bench.wait_until_ready(timeout=0.0)
        assert (
            capfd.readouterr().err
            == "the simulated bench compiles what draws its pictures, the first time one or two"
            " minutes\n"
        )
        bench.wait_until_ready()
        bench.wait_until_ready(timeout=0.0)
    finally:
        bench.close()


def test_a_camera_of_the_simulated_bench_takes_no_picture_before_it_is_ready(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def not_yet(bench: SimulatedBench) -> None:
        raise CommunicationError("the bench still compiles")

    monkeypatch.setattr(SimulatedBench, "wait_until_ready", not_yet)
    with (
        drivers.connect(root / "examples" / "benches" / "simulated.yaml") as bench,
        pytest.raises(CommunicationError, match="still compiles"),
    ):
        bench.camera.grab()


def test_what_is_wrong_with_the_whole_simulated_bench_is_told_once(
    root: Path, tmp_path: Path
) -> None:
    text = (root / "examples" / "benches" / "simulated.yaml").read_text(encoding="utf-8")
    text = text.replace("faults: []", "faults: [{device: sensor_stage, fault: silent}]").replace(
        "../cameras", f"{root}/examples/cameras"
    )
    file = tmp_path / "bench.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(CommunicationError) as refused, drivers.connect(file):
        pass
    [sentence] = str(refused.value).splitlines()
    assert "'silent' is no fault of sensor_stage; allowed: silence" in sentence


def lives(process: str) -> bool:
    try:
        return (
            Path(f"/proc/{process}/cmdline").read_bytes() != b""
        )  # empty: it has ended and waits to be reaped
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_a_simulated_bench_dies_with_its_parent(root: Path) -> None:
    bench = root / "examples" / "benches" / "simulated.yaml"
    program = (
        f"import time, drivers.simulated as s; s.SimulatedBench({str(bench)!r}, seed=1);"
        " print('up', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-P", "-c", program], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"up\n"
        children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
        assert len(children) == 1
        os.kill(parent.pid, signal.SIGKILL)
    deadline = time.monotonic() + 10
    while lives(children[0]):
        assert time.monotonic() < deadline
        time.sleep(0.05)

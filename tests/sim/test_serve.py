"""A whole bench on the loopback: addresses, shared lines, refusals, and an end with its parent."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from flflab.bench import Bench, read_bench
from flflab.errors import InputError
from sim.serve import serve, write_bench

WriteBench = Callable[..., Bench]
READY = b'{"ready": true}\n'
FIRST_FRAMES = """
import gc, sys, threading
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from flflab.bench import read_bench
from sim.motion import rest
from sim.serve import serve, warm_up

def compiled():
    return {(one.py_func.__qualname__, types) for one in gc.get_objects() if isinstance(one, Dispatcher) for types in one.signatures}

with serve(read_bench(Path(sys.argv[1]))) as served:
    warm_up(served).join()
    warm, ended = compiled(), threading.Event()
    [camera] = [one for address in served.scpi for one in address.instruments if hasattr(one, "warm_up")]
    for place in range(len(served.world.targets)):
        served.world.wheel.motion = rest(place)
        camera.commands["INITiate"]([], ended)
        assert camera.next_frame(ended)[1].any()
    print(compiled() - warm)
"""  # noqa: E501
READ = (
    "import sys; from pathlib import Path; from flflab.bench import read_bench; bench ="
    " read_bench(Path(sys.argv[1])); "
)
CHILD = f"{READ}from sim.serve import main; main(bench, json_line=True)"
TELLS_OF_DRAWING = (
    "from sim.camera import SimulatedCamera; SimulatedCamera.warm_up = lambda camera:"
    " print('drawn', flush=True); "
)


def test_instruments_that_share_an_address_share_a_line(write_bench_file: WriteBench) -> None:
    with serve(write_bench_file()) as running:
        axes = running.addresses["axes"]
        assert {axes[name]["address"] for name in axes} == {axes["array_stage"]["address"]}
        assert [axes[name]["device"] for name in axes] == [1, 2, 3, 4]
        assert (
            running.addresses["camera"] == running.addresses["iris"] == running.addresses["target"]
        )
        assert running.addresses["camera"]["driver"] == "scpi"


def test_stopping_frees_the_ports_and_leaves_no_thread(write_bench_file: WriteBench) -> None:
    before = set(threading.enumerate())
    running = serve(write_bench_file())
    addresses = [
        running.addresses["camera"]["address"],
        running.addresses["axes"]["array_stage"]["address"],
    ]
    clients = [
        socket.create_connection(("127.0.0.1", int(address.split(":")[1]))) for address in addresses
    ]
    running.stop()
    assert set(threading.enumerate()) == before
    for client, address in zip(clients, addresses, strict=True):
        assert client.recv(1) == b""
        client.close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", int(address.split(":")[1])))


@pytest.mark.skipif(os.name != "posix", reason="pseudo terminals are there on Linux and macOS only")
def test_stages_on_pseudo_terminals(write_bench_file: WriteBench) -> None:
    with serve(write_bench_file(), pty=True) as running:
        path = running.addresses["axes"]["array_stage"]["address"]
        line = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(line, b"/2 get pos\n")
        assert os.read(line, 100) == b"@02 0 OK IDLE WR 0\r\n"
        os.close(line)


def test_every_axis_of_the_full_bench_is_served_those_of_one_line_together(
    write_bench_file: WriteBench,
) -> None:
    with serve(write_bench_file("full")) as running:
        axes = running.addresses["axes"]
        assert [axes[name]["driver"] for name in axes] == ["zaber"] * 4 + ["thorlabs"] + [
            "oriental"
        ] * 2
        assert axes["goniometer"]["address"] == axes["ring"]["address"]
        assert len({axes[name]["address"] for name in axes}) == 3


def test_people_are_told_where_each_axis_answers(root: Path) -> None:
    code = f"{READ}from sim.serve import main; main(bench)"
    command = [sys.executable, "-P", "-c", code, str(root / "examples/benches/full.yaml")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline() for _ in range(11)]
    assert [line.split("  ")[1:] for line in lines[4:7]] == [
        ["thorlabs", "axis rotation_stage\n"], ["oriental", "axis goniometer, device 1\n"],
        ["oriental", "axis ring, device 2\n"],
    ]  # fmt: skip


def test_a_written_bench_leads_to_what_is_served(
    write_bench_file: WriteBench, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir()
    bench = write_bench_file()
    with serve(bench) as running:
        write_bench(bench, running, tmp_path / "elsewhere" / "served.yaml")
        written = read_bench(tmp_path / "elsewhere" / "served.yaml")
        assert written.optics == bench.optics
        assert (
            written.description.axes["array_stage"].address
            == f"socket://{running.addresses['axes']['array_stage']['address']}"
        )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"camera": {"driver": "opencv", "address": "0"}},
            "camera: there is no simulator for driver 'opencv'",
        ),
        (
            {"simulated": {"faults": [{"device": "camera", "fault": "stall"}]}},
            "'stall' is no fault of camera",
        ),
        ({"simulated": {"faults": [{"device": "lamp", "fault": "silence"}]}}, "no device 'lamp'"),
    ],
)
def test_what_cannot_be_simulated_is_refused(
    write_bench_file: WriteBench, change: dict[str, object], words: str
) -> None:
    file = write_bench_file().file
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | change))
    with pytest.raises(InputError, match=words):
        serve(read_bench(file))


def test_axes_of_one_line_need_numbers_of_their_own(write_bench_file: WriteBench) -> None:
    file = write_bench_file().file
    data = yaml.safe_load(file.read_text())
    data["axes"]["array_stage"]["device"] = 1
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    with pytest.raises(
        InputError, match=r"main_lens_stage, array_stage, .* device number of its own"
    ):
        serve(read_bench(file))


def start(bench: Bench, root: Path, stdin: int, before: str = "") -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", before + CHILD, str(bench.file)],
        stdin=stdin,
        stdout=subprocess.PIPE,
        cwd=root,
    )


def test_it_prints_its_addresses_and_ends_with_its_standard_input(
    write_bench_file: WriteBench, root: Path
) -> None:
    with start(write_bench_file(), root, subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        addresses = json.loads(child.stdout.readline())
        host, port = addresses["camera"]["address"].split(":")
        with socket.create_connection((host, int(port))) as client:
            client.sendall(b"*OPC?\n")
            assert client.recv(10) == b"1\n"
        child.stdin.close()
        assert child.wait(10) == 0
        assert child.stdout.read() in (b"", READY)


def test_it_says_when_all_that_a_first_frame_needs_is_compiled(
    write_bench_file: WriteBench, root: Path
) -> None:
    with start(write_bench_file(), root, subprocess.PIPE, TELLS_OF_DRAWING) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        assert "camera" in json.loads(child.stdout.readline())
        assert child.stdout.readline() == b"drawn\n"
        assert child.stdout.readline() == READY
        child.stdin.close()
        assert child.wait(10) == 0


@pytest.mark.ci
@pytest.mark.parametrize("name", ["simulated", "full"])
def test_a_frame_of_any_target_needs_no_kernel_that_the_warm_up_did_not(
    write_bench_file: WriteBench, name: str
) -> None:
    """In a process of its own, where no other test has asked for kernels; behind small pixels no
    dot stands in the picture's middle.
    """
    file = write_bench_file(name).file
    camera = (file.parent / "camera.yaml").read_text(encoding="utf-8")
    (file.parent / "camera.yaml").write_text(
        camera.replace("6 um", "2 um").replace("240", "720").replace("180", "540"), encoding="utf-8"
    )
    child = subprocess.run(
        [sys.executable, "-c", FIRST_FRAMES, str(file)],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert (child.returncode, child.stderr, child.stdout) == (0, "", "set()\n")


def test_it_serves_without_standard_input_until_a_signal(
    write_bench_file: WriteBench, root: Path
) -> None:
    with start(write_bench_file(), root, subprocess.DEVNULL) as child:
        assert child.stdout is not None
        json.loads(child.stdout.readline())
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(0.5)
        child.send_signal(signal.SIGTERM)
        assert child.wait(10) == 0


@pytest.mark.ci
@pytest.mark.skipif(
    sys.platform == "win32", reason="there a signal to one process is another thing"
)
def test_a_ctrl_c_leaves_the_parent_time_to_stop_its_axes(
    write_bench_file: WriteBench, root: Path
) -> None:
    with start(write_bench_file(), root, subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        json.loads(child.stdout.readline())
        child.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(0.5)
        child.stdin.close()
        assert child.wait(10) == 0


@pytest.mark.skipif(
    not hasattr(os, "kill") or sys.platform == "win32", reason="kills a process the POSIX way"
)
def test_a_killed_parent_takes_the_simulator_with_it(
    write_bench_file: WriteBench, root: Path
) -> None:
    parent_program = (
        f"import subprocess, sys, time; child = subprocess.Popen([sys.executable, '-c', {CHILD!r},"
        " sys.argv[1]], stdin=subprocess.PIPE, stdout=subprocess.PIPE); print(child.pid,"
        " child.stdout.readline().decode(), flush=True); time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", parent_program, str(write_bench_file().file)],
        stdout=subprocess.PIPE,
        cwd=root,
    ) as parent:
        assert parent.stdout is not None
        number, line = parent.stdout.readline().decode().split(" ", 1)
        port = int(json.loads(line)["camera"]["address"].split(":")[1])
        parent.kill()
        with socket.create_connection(("127.0.0.1", port)) as client:
            client.settimeout(10)
            assert client.recv(1) == b""  # the simulator closes its lines
        assert int(number) > 0


def test_drawing_ahead_ends_in_silence_with_the_interpreter(write_bench_file: WriteBench) -> None:
    """From then on pools refuse work; a traceback then would abort the process."""
    bench = write_bench_file()
    ahead = (
        "import sys; from concurrent.futures import thread; from pathlib import Path; from"
        " flflab.bench import read_bench; "
    )
    ahead += (
        "from sim.serve import serve, warm_up; served = serve(read_bench(Path(sys.argv[1])));"
        " thread._python_exit(); "
    )
    ahead += "warm_up(served).join(); served.stop()"
    child = subprocess.run(
        [sys.executable, "-c", ahead, str(bench.file)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (child.returncode, child.stderr) == (0, "")

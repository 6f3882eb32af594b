"""Nobody waits for a client that has gone, and nothing that is being drawn delays an end."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from flflab.bench import Bench
from flflab.image.bands import GivenUpError, given_up_when, go_on, in_bands
from sim.server import TcpLine

WriteBench = Callable[..., Bench]
CAMERA = """
import socket, sys
host, port = sys.argv[1].split(":")
line = socket.create_connection((host, int(port)))
answers = line.makefile("rb")
for words in (f"TARG:KIND {sys.argv[2]};*OPC?", "INIT;*OPC?"):
    line.sendall(words.encode() + b"\\n")
    answers.readline()
print("asks", flush=True)
line.sendall(b"FETC?\\n")
print(answers.read(1).decode(), flush=True)
"""


def test_a_picture_that_nobody_waits_for_is_given_up_between_two_pieces() -> None:
    done: list[int] = []

    def work(first: int, last: int) -> Iterator[None]:
        for row in range(first, last):
            done.append(row)
            yield

    with given_up_when(lambda: len(done) >= 5), pytest.raises(GivenUpError):
        in_bands(work, 100_000)
    assert len(done) < 1000
    in_bands(work, 100)  # outside, work goes on
    assert set(range(100)) <= set(done)


def test_an_interruption_of_one_band_ends_the_others() -> None:
    def work(first: int, last: int) -> Iterator[None]:
        if first == 0:
            raise KeyboardInterrupt
        while True:
            time.sleep(0.001)
            yield

    with pytest.raises(KeyboardInterrupt):
        in_bands(work, 100)


class Draws:
    """Draws without end, for whoever says anything."""

    def __init__(self, begun: threading.Event, given_up: threading.Event) -> None:
        self.begun, self.given_up = begun, given_up

    def receive(self, data: bytes) -> bytes:
        self.begun.set()
        try:
            while True:
                go_on()
                time.sleep(0.001)
        except GivenUpError:
            self.given_up.set()
            raise

    def unasked(self) -> bytes:
        return b""


@pytest.mark.parametrize("ends", ["client", "line"])
def test_drawing_ends_with_its_client_and_with_its_line(ends: str) -> None:
    begun, given_up = threading.Event(), threading.Event()
    line = TcpLine(lambda: Draws(begun, given_up))
    host, port = line.address.split(":")
    try:
        with socket.create_connection((host, int(port))) as client:
            client.sendall(b"FETC?\n")
            assert begun.wait(5)
            if ends == "line":
                line.stop()
            else:
                assert not given_up.wait(0.1)
        assert given_up.wait(5)
    finally:
        line.stop()


def used(process: int) -> float:
    """Processor seconds of a process, whatever else keeps the machine busy."""
    words = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="reads what a process has used in /proc")
def test_a_killed_client_delays_neither_the_next_one_nor_the_end(
    write_bench_file: WriteBench, root: Path
) -> None:
    bench = write_bench_file(effects={"tolerance": 1.2e-4})
    camera = bench.file.parent / "camera.yaml"
    data = yaml.safe_load(camera.read_text())
    data["sensor"] |= {"distance": "62 mm", "resolution": [3664, 2748], "pixel": "1.66 um"}
    camera.write_text(yaml.safe_dump(data))  # four dots take 40 s of one core
    command = [sys.executable, "-m", "flflab", "sim", str(bench.file), "--json"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, cwd=root
    ) as child:
        assert child.stdout is not None
        address = json.loads(child.stdout.readline())["camera"]["address"]
        assert json.loads(child.stdout.readline()) == {"ready": True}

        begun = used(child.pid)

        def asking(kind: str) -> subprocess.Popen[str]:
            client = subprocess.Popen(
                [sys.executable, "-c", CAMERA, address, kind], stdout=subprocess.PIPE, text=True
            )
            assert client.stdout is not None
            assert client.stdout.readline() == "asks\n"
            return client

        with asking("four-dot") as gone:
            while used(child.pid) < 1 + begun:
                time.sleep(0.05)
            gone.kill()
        before = used(child.pid)
        with asking("white") as waits:
            assert waits.stdout is not None
            assert waits.stdout.readline() == "2\n"  # the second exposure's number
            assert used(child.pid) - before < 6
        begun = used(child.pid)
        with asking("four-dot"):
            while used(child.pid) < 1 + begun:
                time.sleep(0.05)
            before = used(child.pid)
            child.send_signal(signal.SIGTERM)
            _, status, spent = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            assert child.returncode == 0
            assert spent.ru_utime + spent.ru_stime - before < 1

"""Peers made of bytes: a scripted dialogue, and a chain of toy stages that knows just enough to
move.
"""

import contextlib
import importlib
import itertools
import os
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

Reply = bytes | Callable[[], bytes] | None
LAST_WORDS_S = 1.0  # what a driver sent last, asking for no answer, may still be on its way


class Dialogue:
    """Plays (expected bytes, reply) pairs to one client after another; anything else it hears, and
    anything left over, is a fault.
    """

    def __init__(self, pairs: list[tuple[bytes, Reply]]) -> None:
        self.left = list(pairs)
        self.faults: list[str] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self._over = threading.Event()
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(TimeoutError):
                link, _ = self._server.accept()
                with link:
                    link.settimeout(0.05)
                    with contextlib.suppress(ConnectionError):
                        self._talk(link)

    def _talk(self, link: socket.socket) -> None:
        heard = b""
        while not self._over.is_set():
            if self.left and heard.startswith(self.left[0][0]):
                due, reply = self.left.pop(0)
                heard = heard[len(due) :]
                if reply is None:
                    return
                link.sendall(reply() if callable(reply) else reply)
                continue
            due = self.left[0][0] if self.left else b""
            if heard and not due.startswith(heard):
                self.faults.append(f"heard {heard!r}, due was {due!r}")
                heard = b""
            try:
                more = link.recv(4096)
            except TimeoutError:
                continue
            if not more:
                return
            heard += more

    def end(self) -> None:
        deadline = time.monotonic() + LAST_WORDS_S
        while self.left and not self.faults and time.monotonic() < deadline:
            time.sleep(0.005)
        self._over.set()
        self._thread.join()
        self._server.close()


@pytest.fixture
def dialogue() -> Iterator[Callable[[list[tuple[bytes, Reply]]], str]]:
    """Start a scripted peer; the test fails where the dialogue went otherwise or was not
    finished.
    """
    peers: list[Dialogue] = []

    def start(pairs: list[tuple[bytes, Reply]]) -> str:
        peers.append(Dialogue(pairs))
        return peers[-1].address

    yield start
    for peer in peers:
        peer.end()
    for peer in peers:
        assert peer.faults == []
        assert peer.left == []


SERIALS = itertools.count(70001)


class ToyStage:
    """A stage in microsteps that moves at a constant speed in real time, and shows one fault when
    told to.
    """

    def __init__(self, speed: float = 100000.0, homed: bool = True, resolution: int = 64) -> None:
        self.speed, self.homed = speed, homed
        self.limit = 100000
        self.settings = {
            "resolution": resolution,
            "limit.min": 0,
            "limit.max": self.limit,
            "maxspeed": 0,
            "system.serial": next(SERIALS),
        }
        self.start = self.end = 0.0
        self.since = 0.0
        self.flags: set[str] = set()
        self.stuck_at: float | None = None
        self.fault: Callable[[str, bytes], bytes] | None = None
        self.hang_ups = 0
        self.heard: list[str] = []

    @property
    def position(self) -> float:
        way = (time.monotonic() - self.since) * self.speed
        position = (
            self.end
            if way >= abs(self.end - self.start)
            else self.start + (way if self.end > self.start else -way)
        )
        return position if self.stuck_at is None else min(position, self.stuck_at)

    @property
    def busy(self) -> bool:
        return (time.monotonic() - self.since) * self.speed < abs(self.end - self.start)

    def go(self, end: float) -> None:
        self.start, self.end, self.since = self.position, end, time.monotonic()

    def answer(self, text: str) -> tuple[str, str]:
        """OK or RJ, and the data."""
        self.heard.append(text)
        if text == "home":
            self.go(0)
            self.homed = True
        elif text.startswith("move rel "):
            target = round(self.position) + int(text.split()[2])
            if not 0 <= target <= self.limit:
                return "RJ", "BADDATA"
            self.go(target)
        elif text == "stop":
            if self.busy:
                self.flags.add("NI")
            self.start = self.end = self.position
        elif text in ("warnings", "warnings clear"):
            flags = sorted(self.flags | ({"WR", "WH"} if not self.homed else set[str]()))
            if text == "warnings clear":
                self.flags.clear()
            return "OK", " ".join((f"{len(flags):02d}", *flags))
        elif text.startswith("set "):
            self.settings[text.split()[1]] = int(text.split()[2])
        elif text == "get pos":
            return "OK", str(round(self.position))
        elif text.startswith("get "):
            return (
                ("OK", str(self.settings[text[4:]]))
                if text[4:] in self.settings
                else ("RJ", "BADCOMMAND")
            )
        elif text:
            return "RJ", "BADCOMMAND"
        return "OK", "0"


class ToyChain:
    """Toy stages on one TCP port, numbered from 1."""

    def __init__(self, *stages: ToyStage) -> None:
        self.stages = stages
        self._link: socket.socket | None = None
        self._over = threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(TimeoutError):
                self._link, _ = self._server.accept()
                self._talk(self._link)

    def _talk(self, link: socket.socket) -> None:
        with link, link.makefile("rb") as lines, contextlib.suppress(ConnectionError):
            for line in lines:
                body, _, sum_ = line.decode().strip().rpartition(":")
                assert (sum(body[1:].encode()) + int(sum_, 16)) % 256 == 0
                device, axis, message, *words = body[1:].split(" ")
                stage = self.stages[int(device) - 1]
                if stage.hang_ups:
                    stage.hang_ups -= 1
                    return
                flag, data = stage.answer(" ".join(words))
                worst = min(stage.flags | (set() if stage.homed else {"WR"}), default="--")
                answer = (
                    f"{int(device):02d} {axis} {message} {flag} {'BUSY' if stage.busy else 'IDLE'}"
                    f" {worst} {data}".encode()
                )
                reply = b"@%s:%02X\r\n" % (answer, -sum(answer) % 256)
                if stage.fault is not None:
                    reply = stage.fault(" ".join(words), reply)
                link.sendall(reply)

    def end(self) -> None:
        self._over.set()
        if self._link is not None:
            with contextlib.suppress(OSError):
                self._link.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._server.close()


@pytest.fixture
def toy_stage() -> type[ToyStage]:
    return ToyStage


@pytest.fixture
def toy_chain() -> Iterator[Callable[..., str]]:
    """Serve toy stages; returns their address."""
    chains: list[ToyChain] = []

    def start(*stages: ToyStage) -> str:
        chains.append(ToyChain(*stages))
        return chains[-1].address

    yield start
    for chain in chains:
        chain.end()


@pytest.fixture(scope="session")
def card(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is on the card of libgphoto2's virtual camera, which looks for the folder once, when it
    is first imported.
    """
    folder = tmp_path_factory.mktemp("card")
    os.environ["VCAMERADIR"] = str(folder)
    return folder


@pytest.fixture(scope="session")
def emulated_basler() -> None:
    """One camera of pylon's own emulation, which is asked for when pypylon is first imported; as an
    error its warning would end Python.
    """
    os.environ["PYLON_CAMEMU"] = "1"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        importlib.import_module("pypylon.pylon")


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + 2
    while (left := set(threading.enumerate()) - before) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert left == set()

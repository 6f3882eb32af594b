"""A child process that stops the axes that a program started when that program dies, however it
dies: killed, crashed, or out of memory; and while it is suspended.

It holds the reading end of a pipe, on which its owner says what it starts and that it lets go.
Where the system tells, it watches the owner itself: a process that the owner forked may keep the
pipe open.
"""

import base64
import contextlib
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.forked import close_in_children
from drivers.stopping import stop_axes
from flflab.bench import AxisDescription
from flflab.errors import DeviceError

STARTED, RELEASED, WATCHING = b"started ", b"released", b"watching\n"
PATIENCE_S = 5.0
START_S = 20.0
LOOK_MS = 50  # between looks whether the owner is suspended


class Sentinel:
    """The child, from the owner's side, as soon as it watches; ``close`` lets it go without a stop.

    Args:
        bench_file: for messages.
        axes: what it may have to stop, each with the address where it really is.

    Raises:
        DeviceError: it does not start.
    """

    def __init__(self, bench_file: Path, axes: Mapping[str, AxisDescription]) -> None:
        command = [sys.executable, "-P", "-c", "from drivers.sentinel import main; main()"]
        # A session of its own: what ends the owner's process group must not end its sentinel.
        self._child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
            bufsize=0,
        )  # fmt: skip
        self._file = bench_file
        self._started: set[str] = set()
        for end in (self._stdin(), self._stdout()):
            close_in_children(end)
        said: list[bytes] = []
        listener = threading.Thread(
            target=lambda: said.append(self._stdout().readline()), name="sentinel", daemon=True
        )
        listener.start()
        try:
            told = pickle.dumps((os.getpid(), str(bench_file), dict(axes)))
            with contextlib.suppress(OSError):
                self._say(base64.b64encode(told))
            listener.join(START_S)
        finally:
            if said != [WATCHING]:  # Ctrl-C, too: nothing moves yet that it would have to stop
                self._child.kill()
                listener.join()
                self.close()
        if said != [WATCHING]:
            raise DeviceError(
                f"{bench_file}: the sentinel that stops the axes when this program dies did not"
                " start; nothing moved"
            )

    def _stdin(self) -> Any:
        return self._child.stdin

    def _stdout(self) -> Any:
        return self._child.stdout

    def _say(self, message: bytes) -> None:
        line = memoryview(message + b"\n")
        while line:
            line = line[self._stdin().write(line) :]

    def watches(self) -> bool:
        """Whether it still lives."""
        return self._child.poll() is None

    def starts(self, name: str) -> None:
        """Say that an axis is about to move.

        Raises:
            DeviceError: the sentinel does not hear; nothing may move.
        """
        if name in self._started:
            return
        try:
            self._say(STARTED + name.encode())
        except OSError as error:
            raise DeviceError(
                f"{self._file}: the sentinel that stops the axes when this program dies has died"
                f" ({error}); nothing moved, try again"
            ) from error
        self._started.add(name)

    def close(self) -> None:
        """Let go: nothing is stopped."""
        with contextlib.suppress(OSError):
            self._say(RELEASED)
        self._stdin().close()
        try:
            self._child.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._stdout().close()


class _Owner:
    """The owner from the sentinel's side: what it says on standard input, and whether it lives."""

    def __init__(self) -> None:
        self._come = bytearray()
        self._open = True
        self.started: set[str] = set()
        self.released = False
        while self._open and b"\n" not in self._come:
            self._read()
        first, _, rest = bytes(self._come).partition(b"\n")
        self.knows_what_to_do = bool(first) and self._open
        if not self.knows_what_to_do:
            return
        # from the owner, which started this process
        told: tuple[int, str, dict[str, AxisDescription]] = pickle.loads(base64.b64decode(first))  # noqa: S301
        self.process, self.file, self.axes = told
        self._come = bytearray(rest)
        self._pidfd = -1
        if sys.platform == "linux":
            with contextlib.suppress(OSError):  # an old kernel: its number is looked at instead
                self._pidfd = os.pidfd_open(self.process)

    def wait(self) -> bool:
        """Hear what it says for a while; whether it is still there."""
        if sys.platform == "win32":  # nothing is forked there: the pipe ends with the owner
            self._read()
        else:
            watched = select.poll()
            watched.register(0, select.POLLIN)
            if self._pidfd >= 0:
                watched.register(self._pidfd, select.POLLIN)
            ready = {place for place, _ in watched.poll(LOOK_MS)}
            if 0 in ready:
                self._read()
            if self._pidfd in ready or os.getppid() != self.process:
                self._read_the_rest()
        self._heed()
        return self._open and not self.released

    def is_suspended(self) -> bool:
        """Whether it was stopped by a signal and sees no motion to its end; known on Linux only."""
        try:
            state = Path(f"/proc/{self.process}/stat").read_bytes()
        except OSError:
            return False
        return state.rpartition(b") ")[2][:1] == b"T"

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            more = os.read(0, 1 << 16)
            self._come += more
            self._open = bool(more)

    def _read_the_rest(self) -> None:
        """All that a dead owner said; a process that it forked may keep the pipe open."""
        os.set_blocking(0, False)
        have = -1
        while have < len(self._come):
            have = len(self._come)
            self._read()
        self._open = False

    def _heed(self) -> None:
        *lines, rest = bytes(self._come).split(b"\n")
        self._come = bytearray(rest)
        for line in lines:
            self.released |= line == RELEASED
            if line.startswith(STARTED):
                self.started.add(line.removeprefix(STARTED).decode())

    def stop(self) -> dict[str, str]:
        """Stop what it started, and nothing else: another program may drive the rest."""
        return stop_axes({name: self.axes[name] for name in self.started})


# What ends or suspends every program at once, such as the end of a service or of the machine, must
# not reach the sentinel before its owner: it ends with that.
_NOT_HEEDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGTTIN", "SIGTTOU")


def main() -> None:
    """Wait for the owner's end; stop the axes that it started unless it let go."""
    for name in _NOT_HEEDED:
        if number := getattr(signal, name, None):
            signal.signal(number, signal.SIG_IGN)
    owner = _Owner()
    if not owner.knows_what_to_do:  # the owner died before anything moved
        return
    with contextlib.suppress(OSError):  # it died meanwhile
        os.write(sys.stdout.fileno(), WATCHING)
    stopped = False
    while owner.wait():
        if owner.is_suspended():
            if not stopped:
                owner.stop()
            stopped = True
        else:
            stopped = False
    if owner.released:
        return
    faults = owner.stop()
    said = list(faults.values()) or ["every axis that it moved was stopped"]
    sys.stderr.write(
        "".join(
            f"flflab: the program that drove {owner.file} is gone; {sentence}\n"
            for sentence in said
        )
    )

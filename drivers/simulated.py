"""``address: simulated``: the instruments of a bench file served by a child process that dies with
this one.
"""

import contextlib
import hashlib
import json
import os
import stat
import subprocess
import sys
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from drivers.locks import user
from flflab.bench import Bench
from flflab.errors import CommunicationError
from flflab.waiting import wait_for

READY_S = 1200.0  # for compiling on a busy machine
SILENCE_S = 2.0


class SimulatedBench:
    """A child process that serves every instrument of a bench file on loopback; ends with ``close``
    or with this process.

    The child holds on to the pipe on its standard input and ends when that closes, which the system
    does when this process dies.

    Args:
        bench_file: the bench file.
        seed: of its errors and noise, whatever the file says.
        memory: file that keeps where everything stands from one program to the next; None: all
            begins as it was built.
        timeout: how long it may take to say its addresses, s (it starts Python and compiles what is
            not in its cache).

    Raises:
        CommunicationError: it did not start; with the last line it wrote.
    """

    def __init__(
        self, bench_file: Path, seed: int, memory: Path | None = None, timeout: float = 60.0
    ) -> None:
        command = [
            sys.executable,
            "-P",
            "-m",
            "flflab",
            "sim",
            str(bench_file),
            "--json",
            "--seed",
            str(seed),
            *(["--memory", str(memory)] if memory is not None else []),
        ]
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115 - closed in close()
        self._child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._complaints
        )
        self._file = bench_file
        self._said: list[bytes] = []
        self._started, self._ready = threading.Event(), threading.Event()
        self._listener = threading.Thread(target=self._listen, name="simulated bench", daemon=True)
        self._listener.start()
        silent = False
        try:
            silent = not wait_for(self._started, timeout)
            self.addresses: dict[str, Any] = json.loads(self._said[0])
        except (IndexError, ValueError):
            self._end()
            last = self._last_complaint()
            self._let_go()
            reason = (
                f"it said nothing for {timeout:g} s"
                if silent
                else "it ended without saying its addresses"
            )
            raise CommunicationError(
                f"{bench_file}: the simulated bench did not start, {reason}; its last words: {last}"
            ) from None
        except BaseException:  # Ctrl-C: nobody else knows of the child yet
            self.close()
            raise

    def wait_until_ready(self, timeout: float = READY_S) -> None:
        """Have all that a first frame needs compiled, and wait for it; an operator who waits is
        told why.

        Args:
            timeout: how long that may take, s.

        Raises:
            CommunicationError: it took longer, or the simulated bench ended.
        """
        with contextlib.suppress(OSError):  # it ended, which is said below
            stdin: Any = self._child.stdin
            stdin.write(b"\n")
            stdin.flush()
        if not wait_for(self._ready, min(SILENCE_S, timeout)):
            print(
                "the simulated bench compiles what draws its pictures, the first time one or two"
                " minutes",
                file=sys.stderr,
                flush=True,
            )
        if not wait_for(self._ready, max(0.0, timeout - SILENCE_S)):
            raise CommunicationError(
                f"{self._file}: the simulated bench still compiles what draws its pictures after"
                f" {timeout:g} s; see what else keeps this machine busy, then run it again: what is"
                " compiled is kept"
            )
        if not self._said[1]:
            raise CommunicationError(
                f"{self._file}: the simulated bench ended before its first frame; its last words:"
                f" {self._last_complaint()}; run it again"
            )

    def _listen(self) -> None:
        """Its addresses, then that it is ready; nothing where it ends before."""
        for told in (self._started, self._ready):
            self._said.append(self._stdout().readline())
            told.set()

    def address(self, *path: str) -> str:
        """Where an instrument is served.

        Args:
            path: as in the bench file: ``"axes", name`` or ``"camera"``.

        Raises:
            CommunicationError: the simulated bench does not serve it.
        """
        place: Any = self.addresses
        for part in (*path, "address"):
            place = place.get(part) if isinstance(place, dict) else None
        if not isinstance(place, str):
            raise CommunicationError(
                f"{'.'.join(path)}: the simulated bench does not serve it; check its driver"
            )
        return place

    def close(self) -> None:
        """End the child and reap it."""
        self._end()
        self._let_go()

    def _stdout(self) -> Any:
        return self._child.stdout

    def _end(self) -> None:
        if self._child.stdin is not None:
            self._child.stdin.close()
        for patience, end in ((2.0, self._child.terminate), (2.0, self._child.kill)):
            try:
                self._child.wait(patience)
                return
            except subprocess.TimeoutExpired:
                end()
        self._child.wait()

    def _let_go(self) -> None:
        self._listener.join()
        self._stdout().close()
        self._complaints.close()

    def _last_complaint(self) -> str:
        if self._complaints.closed:
            return "none"
        self._complaints.seek(0)
        lines = self._complaints.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "none")


def memory_of(bench: Bench) -> Path | None:
    """The file in which commands by hand keep where a simulated bench stands: another one as soon
    as the bench file, its camera file or the seed changes; None where no folder can be had that is
    this user's alone.
    """
    state = hashlib.sha256(str(bench.file.resolve()).encode())
    state.update(str(bench.description.simulated.seed).encode())
    folder = Path(tempfile.gettempdir()) / f"flflab-simulated-{user()}"
    try:
        for file in (bench.file, bench.file.parent / bench.description.optics):
            state.update(file.read_bytes())
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    if not stat.S_ISDIR(found.st_mode) or (hasattr(os, "getuid") and found.st_uid != os.getuid()):
        return None
    return folder / f"{state.hexdigest()[:24]}.json"


class SimulatedOnDemand:
    """The simulated bench, started for the first device that needs it and tried once only; any
    thread may ask.

    Args:
        bench: the bench as read.
        resources: ends it.
        memory: as ``SimulatedBench`` has it.
    """

    def __init__(self, bench: Bench, resources: ExitStack, memory: Path | None = None) -> None:
        self._bench = bench
        self._memory = memory
        self._resources = resources
        self._starting = threading.Lock()
        self._started: SimulatedBench | CommunicationError | None = None

    @property
    def fault(self) -> CommunicationError | None:
        """Why it did not start; None where it did, or was not needed."""
        return self._started if isinstance(self._started, CommunicationError) else None

    def address(self, *path: str) -> str:
        """Where an instrument is served; errors as ``SimulatedBench`` and its ``address``."""
        with self._starting:
            if self._started is None:
                try:
                    self._started = SimulatedBench(
                        self._bench.file, self._bench.description.simulated.seed, self._memory
                    )
                    self._resources.callback(self._started.close)
                except CommunicationError as fault:
                    self._started = fault
        if isinstance(self._started, CommunicationError):
            raise self._started
        return self._started.address(*path)

    def wait_until_ready(self) -> None:
        """Before a frame; errors as ``SimulatedBench.wait_until_ready``."""
        if isinstance(self._started, SimulatedBench):
            self._started.wait_until_ready()

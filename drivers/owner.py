"""One owner of a bench: who drives it holds a lock on a file and answers at a loopback port to those who want it stopped.

The system frees the lock when the owner ends, however it ends.
"""

import contextlib
import hashlib
import json
import os
import secrets
import socket
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from drivers.described import spelt
from flflab.description import read_yaml
from flflab.errors import CommunicationError, DeviceError

STOP_TIMEOUT_S = 10.0
LOCKED_BYTE = 1 << 20  # far behind what is written: a locked byte cannot be read on Windows


def lock_files(bench_file: Path) -> tuple[Path, ...]:
    """Where the owner of a bench writes its port: files of a user and bench, beside the system's temporary files.

    A bench is known by where its axes are reached, whatever file says so: a run's copy of the bench file is the same bench. Nothing else
    in the file needs to be right, so that a bench can be stopped while its file is being edited. One file is for the addresses spelt one
    way, one, where that differs, for what is written: what a link leads to is not known while a cable is out.
    """
    axes = read_yaml(bench_file)[0].get("axes")
    described = [cast(dict[str, Any], axis) for axis in (axes.values() if isinstance(axes, dict) else ()) if isinstance(axis, dict)]
    reached = [(str(axis.get("driver")), str(axis.get("address", ""))) for axis in described if axis.get("driver") != "manual"]
    reached = [(driver, address) for driver, address in reached if address not in ("", "simulated")]
    benches = {spelt(*one) for one in reached}, {address for _, address in reached}
    keys = ("|".join((str(Path.home()), *sorted(bench))) for bench in benches)
    names = dict.fromkeys(hashlib.blake2b(key.encode(), digest_size=12).hexdigest() for key in keys)
    return tuple(Path(tempfile.gettempdir()) / f"flflab-bench-{name}.lock" for name in names)


class Owner:
    """Owns a bench until closed.

    Args:
        bench_file: the bench file.

    Raises:
        DeviceError: another process owns the bench, or the lock file cannot be written.
    """

    def __init__(self, bench_file: Path) -> None:
        self._token = secrets.token_hex(16)
        self._ended = False
        self._thread: threading.Thread | None = None
        self._name = bench_file.name
        with contextlib.ExitStack() as held:
            files = [_held(file, bench_file, held) for file in lock_files(bench_file)]
            try:
                self._listener = held.enter_context(socket.create_server(("127.0.0.1", 0)))
                text = json.dumps({"process": os.getpid(), "port": self._listener.getsockname()[1], "token": self._token})
                for file in files:
                    os.ftruncate(file, 0)
                    os.write(file, text.encode())
            except OSError as error:
                raise DeviceError(
                    f"{bench_file}: it cannot be noted who drives the bench ({error}); make room in {tempfile.gettempdir()}"
                ) from error
            self._held = held.pop_all()

    def stops_with(self, stop: Callable[[], None]) -> None:
        """From now on another process that asks has every axis stopped: ``stop`` is called from a thread of this owner's."""
        self._thread = threading.Thread(target=self._listen, args=(stop,), name=f"owner of {self._name}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Own it no longer."""
        self._ended = True
        if self._thread is not None:
            with contextlib.suppress(OSError), socket.create_connection(self._listener.getsockname(), 1.0):
                pass  # wakes the thread that waits for somebody
            self._thread.join()
        self._held.close()

    def _listen(self, stop: Callable[[], None]) -> None:
        while not self._ended:
            with contextlib.suppress(OSError):
                link, _ = self._listener.accept()
                with link:
                    link.settimeout(1.0)
                    self._answer(link, stop)

    def _answer(self, link: socket.socket, stop: Callable[[], None]) -> None:
        if not secrets.compare_digest(link.recv(200).strip(), self._token.encode()):
            return
        try:
            stop()
            link.sendall(b"stopped\n")
        except DeviceError as error:
            link.sendall(str(error).encode())


def ask_owner_to_stop(bench_file: Path) -> bool:
    """Have the owner of a bench stop every axis.

    Returns:
        False where nobody owns the bench.

    Raises:
        DeviceError: the owner could not stop every axis; in its own words.
        CommunicationError: there is an owner, but it does not answer.
    """
    taken = next((file for file in lock_files(bench_file) if not _is_free(file)), None)
    if taken is None:
        return False
    owner = _read(taken)
    try:
        with socket.create_connection(("127.0.0.1", int(owner["port"])), 1.0) as link:
            link.settimeout(STOP_TIMEOUT_S)
            link.sendall(str(owner["token"]).encode() + b"\n")
            answer = b"".join(iter(lambda: link.recv(4096), b"")).decode(errors="replace")
    except (OSError, KeyError, ValueError) as error:
        who = owner.get("process", "unknown")
        raise CommunicationError(
            f"{bench_file}: process {who} drives this bench and does not answer ({error}); end it, which stops its axes, or cut their power"
        ) from error
    if answer != "stopped\n":
        raise DeviceError(answer or f"{bench_file}: its owner did not say that the axes stopped; cut their power")
    return True


def _held(file: Path, bench_file: Path, held: contextlib.ExitStack) -> int:
    """A lock file opened and locked until the end of what is held.

    Raises:
        DeviceError: another process has it, or it cannot be opened.
    """
    locked = _open_locked(file)
    if locked is None:
        who = _read(file).get("process", "unknown")
        raise DeviceError(
            f"{bench_file}: another program drives this bench (process {who}), perhaps somebody else's run; wait for its end: "
            f"`flflab bench stop --bench {bench_file}` would stop its axes and with them what it does"
        )
    held.callback(os.close, locked)
    held.callback(os.ftruncate, locked, 0)
    return locked


def _is_free(file: Path) -> bool:
    opened = _open_locked(file)
    if opened is not None:
        os.close(opened)
    return opened is not None


def _open_locked(file: Path) -> int | None:
    """The file opened and locked for this process, None where another one has it."""
    try:
        opened = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except OSError as error:
        raise DeviceError(f"{file}: cannot be opened ({error}); it says who drives the bench, make it writable") from error
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(opened, LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(opened, msvcrt.LK_NBLCK, 1)
            os.lseek(opened, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(opened)
        return None
    return opened


def _read(file: Path) -> dict[str, Any]:
    try:
        found: Any = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return cast(dict[str, Any], found) if isinstance(found, dict) else {}

"""One owner of a bench: who drives it holds a lock on a file and answers at a loopback port to
those who want it stopped.

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
from flflab.errors import DeviceError, InputError

HEARD_TIMEOUT_S = 2.0
STOP_TIMEOUT_S = 10.0
HEARD, STOPPED = b"heard\n", b"stopped\n"
LOCK = "flflab-bench-"
LOCKED_BYTE = 1 << 20  # far behind what is written: a locked byte cannot be read on Windows


def lock_files(bench_file: Path) -> dict[str, tuple[Path, ...]]:
    """Where the owner of a bench writes its port, by axis: files of a user and a line, beside the
    system's temporary files.

    A line is known by its address, whatever file says so: a run's copy of the bench file is the
    same bench, and one that names some of its axes reaches the same stages. Nothing else in the
    file needs to be right, so that a bench can be stopped while its file is being edited. One file
    is for the address spelt one way, one, where that differs, for what is written: what a link
    leads to is not known while a cable is out.
    """
    axes = read_yaml(bench_file)[0].get("axes")
    described = (
        {
            str(name): cast(dict[str, Any], axis)
            for name, axis in axes.items()
            if isinstance(axis, dict)
        }
        if isinstance(axes, dict)
        else {}
    )
    reached = {
        name: (str(axis.get("driver")), str(axis.get("address", "")))
        for name, axis in described.items()
    }
    return {
        name: tuple(dict.fromkeys(_lock_file(place) for place in (spelt(driver, address), address)))
        for name, (driver, address) in reached.items()
        if driver != "manual" and address not in ("", "simulated")
    }


def _lock_file(place: str) -> Path:
    whose = os.path.expanduser("~")  # pathlib fails where nobody knows it
    name = hashlib.blake2b(f"{whose}|{place}".encode(), digest_size=12).hexdigest()
    return Path(tempfile.gettempdir()) / f"{LOCK}{name}.lock"


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
            lines = sorted({file for files in lock_files(bench_file).values() for file in files})
            files = [_held(file, bench_file, held) for file in lines]
            try:
                self._listener = held.enter_context(socket.create_server(("127.0.0.1", 0)))
                says = {
                    "process": os.getpid(),
                    "port": self._listener.getsockname()[1],
                    "token": self._token,
                    "bench": _named(bench_file),
                }
                text = json.dumps(says)
                for file in files:
                    os.ftruncate(file, 0)
                    os.write(file, text.encode())
            except OSError as error:
                raise DeviceError(
                    f"{bench_file}: it cannot be noted who drives the bench ({error}); make room in"
                    f" {tempfile.gettempdir()}"
                ) from error
            self._held = held.pop_all()

    def stops_with(self, stop: Callable[[], None]) -> None:
        """From now on another process that asks has every axis stopped: ``stop`` is called from a
        thread of this owner's.
        """
        self._thread = threading.Thread(
            target=self._listen, args=(stop,), name=f"owner of {self._name}", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Own it no longer."""
        self._ended = True
        if self._thread is not None:
            with (
                contextlib.suppress(OSError),
                socket.create_connection(self._listener.getsockname(), 1.0),
            ):
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
        with contextlib.suppress(OSError):  # who asked may be gone: it stops all the same
            link.sendall(HEARD)
        try:
            stop()
            link.sendall(STOPPED)
        except DeviceError as error:
            link.sendall(str(error).encode())


def ask_owners_to_stop(bench_file: Path) -> dict[str, str | None]:
    """Have those who own lines of a bench, or began with its file whatever stands in it now, stop
    every axis of theirs.

    Returns:
        Of each axis that is not simulated or moved by hand, and of each further owner by process:
        None where nobody owns its line, nothing where its owner says that all stopped, else a
        sentence that says what is wrong.

    Raises:
        InputError: the file cannot be read, and nobody who drives a bench began with it.
        DeviceError: a lock file cannot be opened.
    """
    answers: dict[str, str | None] = {}
    asked: dict[str, str] = {}

    def ask(owner: dict[str, Any]) -> str:
        if str(owner) not in asked:  # one may own several lines
            asked[str(owner)] = _ask_to_stop(owner, bench_file)
        return asked[str(owner)]

    for file in Path(tempfile.gettempdir()).glob(f"{LOCK}*"):
        owner = _read(file)
        if owner.get("bench") == _named(bench_file) and not _is_free(file):
            answers[f"process {owner.get('process')}"] = ask(owner)
    try:
        lines = lock_files(bench_file)
    except InputError:
        if not asked:
            raise
        return answers
    for name, files in lines.items():
        taken = next((file for file in files if not _is_free(file)), None)
        answers[name] = None if taken is None else ask(_read(taken))
    return answers


def _named(bench_file: Path) -> str:
    return str(bench_file.resolve())


def _ask_to_stop(owner: dict[str, Any], bench_file: Path) -> str:
    """Nothing where an owner stopped, else what is wrong."""
    try:
        with socket.create_connection(("127.0.0.1", int(owner["port"])), 1.0) as link:
            link.settimeout(HEARD_TIMEOUT_S)
            link.sendall(str(owner["token"]).encode() + b"\n")
            answer = link.recv(4096)
            link.settimeout(STOP_TIMEOUT_S)
            answer += b"".join(iter(lambda: link.recv(4096), b""))
    except (OSError, KeyError, ValueError) as error:
        who = owner.get("process", "unknown")
        return (
            f"{bench_file}: process {who} drives this bench and does not answer ({error}); end it,"
            f" where it hangs by `kill -9 {who}`, which stops its axes, or cut their power"
        )
    said = answer.removeprefix(HEARD)
    if said == STOPPED:
        return ""
    return (
        said.decode(errors="replace")
        or f"{bench_file}: its owner did not say that the axes stopped; cut their power"
    )


def _held(file: Path, bench_file: Path, held: contextlib.ExitStack) -> int:
    """A lock file opened and locked until the end of what is held.

    Raises:
        DeviceError: another process has it, or it cannot be opened.
    """
    locked = _open_locked(file)
    if locked is None:
        who = _read(file).get("process", "unknown")
        raise DeviceError(
            f"{bench_file}: another program drives this bench (process {who}), perhaps somebody"
            f" else's run; wait for its end: `flflab bench stop --bench {bench_file}` would stop"
            " its axes and with them what it does"
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
        raise DeviceError(
            f"{file}: cannot be opened ({error}); it says who drives the bench, make it writable"
        ) from error
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

"""One owner of a bench: who drives it holds a lock on a file for each of its lines and answers at a
loopback port to those who want it stopped.
"""

import contextlib
import os
import secrets
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

from drivers import locks
from drivers.forked import close_in_children
from drivers.locks import lock_files
from drivers.places import spelt
from flflab.errors import DeviceError, InputError
from flflab.yaml_file import read_yaml

__all__ = ["Owner", "ask_owner", "ask_owners_to_stop", "lock_files"]

HEARD_TIMEOUT_S = 1.0
STOP_TIMEOUT_S = 10.0
NAMES_S = 5.0  # in which the numbers of hosts are found
HEARD, STOPPED = b"heard\n", b"stopped\n"
MOST_ANSWER = 1 << 28  # bytes, of a picture
MOST_SILENT = 32  # connections that say nothing; of more the oldest is let go


class _Held:
    """Open files of an owner, closed together."""

    def __init__(self) -> None:
        self.files: list[int] = []
        self.listener: socket.socket | None = None
        close_in_children(self)

    def close(self) -> None:
        """Close them, and free the locks with that."""
        for file in self.files:
            with contextlib.suppress(OSError):
                os.close(file)
        self.files = []
        if self.listener is not None:
            self.listener.close()


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
        self._files = sorted({file for files in lock_files(bench_file).values() for file in files})
        self._held = _Held()
        with contextlib.ExitStack() as undo:
            undo.callback(self._held.close)
            for file in self._files:
                self._held.files.append(_take(file, bench_file))
                undo.callback(file.unlink, missing_ok=True)
            # files of this process are locked first: of two users at once, one sees the other
            for file in self._files:
                if whose := locks.others_lock(file):
                    raise DeviceError(_driven_already(bench_file, f"of user {whose}"))
            self._listener = socket.create_server(("127.0.0.1", 0))
            self._held.listener = self._listener
            self._note(bench_file)
            undo.pop_all()

    def _note(self, bench_file: Path) -> None:
        says = {
            "process": os.getpid(),
            "port": self._listener.getsockname()[1],
            "bench": _named(bench_file),
        }
        try:
            for file, held in zip(self._files, self._held.files, strict=True):
                file.with_suffix(locks.STOP).unlink(missing_ok=True)  # meant for another owner
                key = locks.open_own(file.with_suffix(locks.KEY), create=True, secret=True)
                if key is None:
                    raise OSError(f"{file.with_suffix(locks.KEY)} cannot be used")
                try:
                    os.chmod(file.with_suffix(locks.KEY), 0o600)
                    locks.write(key, {"token": self._token})
                finally:
                    os.close(key)
                os.chmod(file, 0o644)
                locks.write(held, says)
        except OSError as error:
            raise DeviceError(
                f"{bench_file}: it cannot be noted who drives the bench ({error}); make room in"
                f" {locks.folder()}"
            ) from error

    def stops_with(
        self, stop: Callable[[], None], answers: Mapping[str, Callable[[], bytes]] | None = None
    ) -> None:
        """From now on another process that asks has every axis stopped: ``stop`` is called from a
        thread of this owner's; one that asks one of the questions in ``answers`` gets its answer,
        and nothing moves.
        """
        self._thread = threading.Thread(
            target=self._listen,
            args=(stop, answers or {}),
            name=f"owner of {self._name}",
            daemon=True,
        )
        self._thread.start()

    def told_to_stop(self) -> bool:
        """Whether somebody had this bench stopped since it was connected, perhaps while this
        process could hear nothing.
        """
        return any(
            locks.read_own(file.with_suffix(locks.STOP)).get("token") == self._token
            for file in self._files
        )

    def owns(self) -> bool:
        """Whether its files are still where others find them: who takes them away lets another
        program in.
        """
        return all(map(_is_there, self._files, self._held.files))

    def close(self) -> None:
        """Own it no longer; files that another program has put in the place of its own stay."""
        self._ended = True
        if self._thread is not None:
            with (
                contextlib.suppress(OSError),
                socket.create_connection(self._listener.getsockname(), 1.0),
            ):
                pass  # wakes the thread that waits for somebody
            self._thread.join()
        for file, held in zip(
            self._files, self._held.files, strict=False
        ):  # none in a forked child
            for kind in (locks.STOP, locks.KEY, locks.LOCK) if _is_there(file, held) else ():
                with contextlib.suppress(OSError):
                    file.with_suffix(kind).unlink(missing_ok=True)
        self._held.close()

    def _listen(self, stop: Callable[[], None], answers: Mapping[str, Callable[[], bytes]]) -> None:
        """Hear all who connect at once: who says nothing keeps nobody waiting."""
        silent: list[socket.socket] = []
        answering: list[threading.Thread] = []
        with selectors.DefaultSelector() as ready:
            ready.register(self._listener, selectors.EVENT_READ)
            while not self._ended:
                for key, _ in ready.select():
                    link = cast(socket.socket, key.fileobj)
                    if link is self._listener:
                        with contextlib.suppress(OSError):
                            silent.append(link.accept()[0])
                            ready.register(silent[-1], selectors.EVENT_READ)
                        continue
                    ready.unregister(link)
                    silent.remove(link)
                    asked = self._asked(link)
                    if asked is not None:
                        thread = threading.Thread(
                            target=_tell if asked else _answer,
                            args=(link, answers.get(asked, lambda: b"") if asked else stop),
                            daemon=True,
                        )
                        thread.start()
                        answering.append(thread)
                while len(silent) > MOST_SILENT:
                    ready.unregister(silent[0])
                    silent.pop(0).close()
        for link in silent:
            link.close()
        for thread in answering:
            thread.join()

    def _asked(self, link: socket.socket) -> str | None:
        """What one asks who may read this user's files, empty for a stop; another is let go."""
        with contextlib.suppress(OSError):
            token, _, question = link.recv(200).strip().partition(b" ")
            if secrets.compare_digest(token, self._token.encode()):
                return question.decode("ascii", "replace")
        link.close()
        return None


def _is_there(file: Path, held: int) -> bool:
    """Whether an open file is the one of that name."""
    try:
        return os.path.samestat(os.fstat(held), os.stat(file))
    except OSError:
        return False


def _answer(link: socket.socket, stop: Callable[[], None]) -> None:
    with link, contextlib.suppress(OSError):  # who asked may be gone: it stops all the same
        link.settimeout(1.0)
        with contextlib.suppress(OSError):
            link.sendall(HEARD)
        try:
            stop()
            link.sendall(STOPPED)
        except DeviceError as error:
            link.sendall(str(error).encode())


def _tell(link: socket.socket, answer: Callable[[], bytes]) -> None:
    with link, contextlib.suppress(OSError):  # who asked may be gone
        link.settimeout(STOP_TIMEOUT_S)
        link.sendall(answer())


def ask_owner(bench_file: Path, question: str) -> bytes | None:
    """What the program that drives a bench answers to a question; nothing moves. None where no
    program of this user drives it; empty where it knows no answer.

    Raises:
        InputError: the bench file cannot be read.
        DeviceError: it does not answer.
    """
    found = (
        owner
        for files in lock_files(bench_file).values()
        for file in files
        if (owner := _owner(file))
    )
    owner = next(found, None)
    if owner is None or owner.get("process") == os.getpid():
        return None
    try:
        with socket.create_connection(("127.0.0.1", int(owner["port"])), 1.0) as link:
            link.settimeout(STOP_TIMEOUT_S)
            link.sendall(f"{owner['token']} {question}\n".encode())
            answer = bytearray()
            while (more := link.recv(1 << 16)) and len(answer) < MOST_ANSWER:
                answer += more
    except (OSError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise DeviceError(
            f"{bench_file}: process {owner.get('process', 'unknown')} drives this bench and does"
            f" not answer ({error})"
        ) from error
    return bytes(answer)


def ask_owners_to_stop(bench_file: Path) -> dict[str, str | None]:
    """Have those who own lines of a bench, or began with its file whatever stands in it now, stop
    every axis of theirs; all are asked at once, and none of them moves an axis afterwards.

    Only programs of this user are asked: files of others are not opened.

    Returns:
        Of each axis that is not simulated or moved by hand, and of each further owner by process:
        None where nobody owns its line, nothing where its owner says that all rest, else a sentence
        that says what is wrong.

    Raises:
        InputError: the file cannot be read, and nobody who drives a bench began with it.
    """
    asking = _Asking(bench_file)
    for file in locks.own_files():
        owner = _owner(file)
        if owner.get("bench") == _named(bench_file):
            _latch(file, owner)
            asking.ask(f"process {owner.get('process')}", owner)
    reached: dict[str, tuple[str, str]] = {}
    try:
        reached = locks.reached(read_yaml(bench_file)[0])
    except InputError:
        if not asking.names:
            raise

    def look(name: str, driver: str, address: str) -> None:
        for place in (lambda: address, lambda: spelt(driver, address)):
            file = locks.file_of(place())
            if owner := _owner(file):
                _latch(file, owner)
                asking.ask(name, owner)

    _all_at_once(
        "look for owners", [partial(look, name, *found) for name, found in reached.items()]
    )
    return {**dict.fromkeys(reached), **asking.answers()}


class _Asking:
    """Asks owners to stop, each once and all at the same time.

    Args:
        bench_file: for messages.
    """

    def __init__(self, bench_file: Path) -> None:
        self.names: dict[str, str] = {}
        self._file = bench_file
        self._lock = threading.Lock()
        self._threads: dict[str, threading.Thread] = {}
        self._answers: dict[str, str] = {}

    def ask(self, name: str, owner: dict[str, Any]) -> None:
        """Ask an owner, known under a name, unless that was done; does not wait."""
        known = str(owner)

        def hear() -> None:
            self._answers[known] = _ask_to_stop(owner, self._file)

        with self._lock:
            self.names[name] = known
            if known not in self._threads:
                self._threads[known] = threading.Thread(
                    target=hear, name="ask an owner", daemon=True
                )
                self._threads[known].start()

    def answers(self) -> dict[str, str]:
        """What each said, by the names it is known under."""
        with self._lock:
            names, threads = dict(self.names), list(self._threads.values())
        for thread in threads:
            thread.join()
        return {name: self._answers[known] for name, known in names.items()}


def _all_at_once(what: str, tasks: Sequence[Callable[[], None]]) -> None:
    """Do all at the same time, and wait for those that end soon: a name server may say nothing."""
    threads = [threading.Thread(target=task, name=what, daemon=True) for task in tasks]
    deadline = time.monotonic() + NAMES_S
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))


def _owner(file: Path) -> dict[str, Any]:
    """Who holds a lock file of this user's; nothing where nobody does."""
    says = locks.read_own(file)
    if not says or not locks.locked(file):
        return {}
    token = locks.read_own(file.with_suffix(locks.KEY)).get("token", "")
    return {**says, "token": str(token)}


def _latch(file: Path, owner: dict[str, Any]) -> None:
    """Leave word for an owner that hears nothing now: it reads it before it moves the next time."""
    opened = locks.open_own(file.with_suffix(locks.STOP), create=True, secret=True)
    if opened is not None:
        with contextlib.suppress(OSError):
            locks.write(opened, {"token": owner["token"]})
        os.close(opened)


def _named(bench_file: Path) -> str:
    return str(bench_file.resolve())


def _ask_to_stop(owner: dict[str, Any], bench_file: Path) -> str:
    """Nothing where an owner's axes rest, else what is wrong."""
    try:
        with socket.create_connection(("127.0.0.1", int(owner["port"])), 1.0) as link:
            link.settimeout(HEARD_TIMEOUT_S)
            link.sendall(str(owner["token"]).encode() + b"\n")
            answer = link.recv(4096)
            ends = time.monotonic() + STOP_TIMEOUT_S
            link.settimeout(STOP_TIMEOUT_S)
            while (more := link.recv(4096)) and time.monotonic() < ends:
                answer += more
    except (OSError, KeyError, ValueError, TypeError, OverflowError) as error:
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


def _driven_already(bench_file: Path, who: str) -> str:
    return (
        f"{bench_file}: another program drives this bench ({who}), perhaps somebody"
        f" else's run. Wait until it finishes. `flflab bench stop --bench {bench_file}` stops its"
        " axes and ends its run"
    )


def _take(file: Path, bench_file: Path) -> int:
    """A lock file, opened and locked.

    Raises:
        DeviceError: another process has it, or it cannot be opened.
    """
    held = locks.hold(file)
    if held is None:
        who = locks.read_own(file).get("process", "unknown")
        raise DeviceError(_driven_already(bench_file, f"process {who}"))
    return held

"""Where the programs of one machine say who drives which line: files in one place that every user
finds, whatever his environment says.

A line has one file for each user who drives it, made by that user and locked while he does; the
system frees the lock when the program ends, however it ends. Files of others are only asked whether
they are locked. They lie in a folder of the system's, since whoever makes a folder of his own for
all can take others' files out of it.
"""

import contextlib
import getpass
import hashlib
import json
import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from drivers.described import spelt
from flflab.description import read_yaml
from flflab.errors import DeviceError

PLACES = ("/run/lock", "/var/lock", "/dev/shm", "/tmp")  # noqa: S108 - found sticky before use
PREFIX, LOCK, KEY, STOP = "flflab-bench-", ".lock", ".key", ".stop"
MOST_BYTES = 4096
LOCKED_BYTE = 1 << 20  # far behind what is written: a locked byte cannot be read on Windows


def folder() -> Path:
    """The one place: the first that everybody may write to and nobody may take others' files from.

    Raises:
        DeviceError: this machine has none.
    """
    if sys.platform == "win32":
        place = Path(os.environ.get("PROGRAMDATA", r"C:\ProgramData")) / "flflab"
        place.mkdir(exist_ok=True)
        return place
    for place in map(Path, PLACES):
        with contextlib.suppress(OSError):
            if place.stat().st_mode & (stat.S_ISVTX | stat.S_IWOTH) == stat.S_ISVTX | stat.S_IWOTH:
                return place.resolve()
    raise DeviceError(
        f"none of {', '.join(PLACES)} can be written by everybody (mode 1777), so nobody could see"
        " who drives a bench; make /run/lock so"
    )


def user() -> str:
    """This user, as file names have him."""
    return getpass.getuser() if sys.platform == "win32" else str(os.getuid())


def lock_files(bench_file: Path) -> dict[str, tuple[Path, ...]]:
    """This user's files of the lines of a bench, by axis.

    A line is known by its address, whatever file says so: a run's copy of the bench file is the
    same bench, and one that names some of its axes reaches the same stages. Nothing else in the
    file needs to be right, so that a bench can be stopped while its file is being edited. One file
    is for the address spelt one way, one, where that differs, for what is written: what a link
    leads to is not known while a cable is out.

    Raises:
        InputError: the file cannot be read.
    """
    return {
        name: tuple(dict.fromkeys(file_of(place) for place in (spelt(driver, address), address)))
        for name, (driver, address) in reached(read_yaml(bench_file)[0]).items()
    }


def reached(data: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Driver and address of each axis of a bench file that another program could reach."""
    axes = data.get("axes")
    named = cast(dict[Any, Any], axes if isinstance(axes, dict) else {})
    found = {
        str(name): (str(axis.get("driver")), str(axis.get("address", "")))
        for name, axis in named.items()
        if isinstance(axis, dict)
    }
    return {
        name: (driver, address)
        for name, (driver, address) in found.items()
        if driver != "manual" and address not in ("", "simulated")
    }


def file_of(place: str) -> Path:
    """This user's file of a place."""
    name = hashlib.blake2b(place.encode(errors="surrogateescape"), digest_size=12).hexdigest()
    return folder() / f"{PREFIX}{name}.{user()}{LOCK}"


def own_files() -> Iterator[Path]:
    """Every lock file of this user's."""
    yield from folder().glob(f"{PREFIX}*.{user()}{LOCK}")


def open_own(file: Path, *, create: bool = False, secret: bool = False) -> int | None:
    """Open a file of this user's, never waiting and following nothing; None where it is missing or
    anything but a small file of his own.

    Args:
        file: which.
        create: make it where it is missing.
        secret: let nobody else read it.
    """
    if not _small_and_own(file):
        return None
    how = os.O_RDWR | (os.O_CREAT if create else 0)
    how |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        opened = os.open(file, how, 0o600 if secret else 0o644)
    except OSError:
        return None
    if _is_small_and_own(os.fstat(opened)):
        return opened
    os.close(opened)
    return None


def _small_and_own(file: Path) -> bool:
    """Whether there is nothing, or a small file of this user's: looked at before it is opened."""
    try:
        return _is_small_and_own(os.lstat(file))
    except OSError:
        return True


def _is_small_and_own(found: os.stat_result) -> bool:
    own = sys.platform == "win32" or found.st_uid == os.getuid()
    return own and stat.S_ISREG(found.st_mode) and found.st_size <= MOST_BYTES


def lock(opened: int, *, shared: bool = False) -> bool:
    """Lock an open file for this process, at once or not at all."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(opened, LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(opened, msvcrt.LK_NBLCK, 1)
            os.lseek(opened, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(opened, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def locked(file: Path) -> bool:
    """Whether a program holds the lock of a file, this user's or another's."""
    how = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        if not stat.S_ISREG(os.lstat(file).st_mode):
            return False
        opened = os.open(file, how)
    except OSError:  # gone, or made by none of us: ours can be read by everybody
        return False
    try:
        return stat.S_ISREG(os.fstat(opened).st_mode) and not lock(opened, shared=True)
    finally:
        os.close(opened)


def others_lock(file: Path) -> str | None:
    """The user, by name or number, who drives the line of a file beside this one; None where nobody
    does.
    """
    stem = file.name.removesuffix(f".{user()}{LOCK}")
    for other in file.parent.glob(f"{stem}.*{LOCK}"):
        if other != file and locked(other):
            return _name_of(other.name.removeprefix(f"{stem}.").removesuffix(LOCK))
    return None


def _name_of(number: str) -> str:
    with contextlib.suppress(ImportError, KeyError, ValueError):
        import pwd

        return pwd.getpwuid(int(number)).pw_name
    return number


def read_own(file: Path) -> dict[str, Any]:
    """What a file of this user's says; nothing where there is none or it says nothing."""
    opened = open_own(file)
    if opened is None:
        return {}
    try:
        found: Any = json.loads(os.read(opened, MOST_BYTES))
    except (OSError, ValueError):
        return {}
    finally:
        os.close(opened)
    return cast(dict[str, Any], found) if isinstance(found, dict) else {}


def write(opened: int, says: dict[str, Any]) -> None:
    """Have an open file say something, and nothing else.

    Raises:
        OSError: it cannot be written.
    """
    os.ftruncate(opened, 0)
    os.lseek(opened, 0, os.SEEK_SET)
    os.write(opened, json.dumps(says).encode())


def hold(file: Path) -> int | None:
    """A lock file of this user's, opened and locked for this process; None where another process
    has it.

    Raises:
        DeviceError: it cannot be made.
    """
    while True:
        opened = open_own(file, create=True)
        if opened is None and _take_away(file):
            continue
        if opened is None:
            raise DeviceError(
                f"{file}: cannot be used to say who drives the bench: it is not a file of yours, or"
                " the folder is full; have its owner take it away, or make room"
            )
        if not lock(opened):
            os.close(opened)
            return None
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(opened), os.stat(file)):
                return opened
        os.close(opened)  # whoever had it last took it away meanwhile


def _take_away(file: Path) -> bool:
    """Whether something strange of this user's own stood in a file's place, and is gone."""
    try:
        found = os.lstat(file)
        if found.st_uid != os.getuid():
            return False
        (os.rmdir if stat.S_ISDIR(found.st_mode) else os.unlink)(file)
    except (OSError, AttributeError):
        return False
    return True

"""Files that are there whole or not at all: written beside their place, and put there after the
last byte.
"""

import contextlib
import csv
import errno
import hashlib
import io
import os
import secrets
import shutil
import sys
from collections.abc import Generator, Iterable
from pathlib import Path
from typing import Any, BinaryIO

from flflab.errors import InputError

FULL = (errno.ENOSPC, errno.EDQUOT) if hasattr(errno, "EDQUOT") else (errno.ENOSPC,)


def write_whole(file: Path, content: str | bytes | memoryview) -> None:
    """Write a file, or leave what was there as it was; a device or a pipe takes the bytes as they
    come.

    Args:
        file: is overwritten.
        content: text is written as UTF-8, its line ends as they are.

    Raises:
        InputError: the disk is full, the file or its folder cannot be written, or its text holds a
            name that is not UTF-8.
    """
    try:
        content = content.encode("utf-8") if isinstance(content, str) else content
    except UnicodeEncodeError as error:
        raise InputError(
            f"{file}: would hold a file's name that is not UTF-8; give names that are"
        ) from error
    try:
        _require_place(file)
        if _special(file):
            file.write_bytes(content)
        else:
            with (
                part_of(file.resolve()) as part,
                part.open("wb") as stream,
            ):  # the file that a link leads to, not the link
                stream.write(content)
    except OSError as error:
        raise _unwritten(file, error, len(content)) from error


def write_csv(file: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows as CSV, the first one the heads; raises as ``write_whole``."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    write_whole(file, text.getvalue())


def require_writable(file: Path) -> None:
    """Refuse, before anything is computed, a file that could not be written in the end.

    Raises:
        InputError: there is no such folder, or the file or its folder may not be written.
    """
    try:
        _require_place(file)
    except OSError as error:
        raise _unwritten(file, error, 0) from error


def make_folder(folder: Path, asked: str) -> None:
    """Make a folder, or take the one that is there.

    Args:
        folder: the folder.
        asked: what the operator gave, by which a refusal names it.

    Raises:
        InputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{asked}: the folder cannot be made ({error.strerror or error}); give another"
        ) from error


def _special(file: Path) -> bool:
    """Whether it is a device or a pipe, which nothing can take the place of."""
    return file.exists() and not file.is_file()


def _require_place(file: Path) -> None:
    folder = file.resolve().parent
    if file.is_dir():
        raise OSError(errno.EISDIR, "it is a folder")
    if file.exists() and not os.access(file, os.W_OK):  # its folder would let it be replaced
        raise OSError(errno.EACCES, "it is write-protected")
    if not _special(file) and not folder.is_dir():
        raise OSError(errno.ENOTDIR, f"there is no folder {folder}")
    if not _special(file) and not os.access(folder, os.W_OK | os.X_OK):
        raise OSError(errno.EACCES, f"the folder {folder} is write-protected")


@contextlib.contextmanager
def part_of(file: Path) -> Generator[Path]:
    """An empty file beside a file, to take its place at the end; where that fails nothing of it is
    left.

    One that a killed program left of the same file is removed before.
    """
    # as short for the longest name that a file may have
    own = f".{hashlib.blake2b(os.fsencode(file.name), digest_size=4).hexdigest()}"
    for left in file.parent.glob(f"{own}.*.part"):
        _remove_unless_held(left)
    part = file.with_name(f"{own}.{secrets.token_hex(8)}.part")
    try:
        with part.open("xb") as held:
            _hold(held)
            yield part
        if file.exists():
            shutil.copymode(file, part)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


def _remove_unless_held(part: Path) -> None:
    with contextlib.suppress(OSError), part.open("r+b") as left:
        if _hold(left):
            left.close()
            part.unlink()


def _hold(part: BinaryIO) -> bool:
    """Keep a part from others' removal until it is closed, however this program ends; False where
    another one keeps it, or none can.
    """
    if sys.platform == "win32":
        return True  # what is open cannot be removed there
    import fcntl

    try:
        fcntl.flock(part, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False  # or a disk on the network that knows no locks
    return True


def _unwritten(file: Path, error: OSError, needed: int) -> InputError:
    if error.errno in FULL:
        return InputError(
            f"{file}: the disk is full, {needed / 1e6:.3g} MB are needed; make room, or give a"
            " place on another disk"
        )
    return InputError(
        f"{file}: cannot be written ({error.strerror or error}); give a place you may write in"
    )

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
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

from flflab.errors import InputError
from flflab.file_lock import try_lock

FULL = (errno.ENOSPC, errno.EDQUOT) if hasattr(errno, "EDQUOT") else (errno.ENOSPC,)


def write_whole(file: Path, content: str | bytes | memoryview) -> None:
    """Write a file, or leave what was there as it was; a device or a pipe takes the bytes as they
    come, and of a link the file that it leads to is written.

    Args:
        file: is overwritten.
        content: text is written as UTF-8, its line ends as they are.

    Raises:
        InputError: the disk is full, the file or its folder cannot be written, or its text holds a
            name that is not UTF-8.
    """
    content = _in_bytes(file, content)
    try:
        _require_place(file)
        if _special(file):
            file.write_bytes(content)
        else:
            _put(file.resolve(), content)
    except OSError as error:
        raise _unwritten(file, error, len(content)) from error


def write_together(contents: Mapping[Path, str | bytes | memoryview]) -> None:
    """Write the files of one result: all of them, or, where one cannot be written or the program
    is interrupted, none.

    Args:
        contents: by file; each is overwritten.

    Raises:
        InputError: as ``write_whole``.
    """
    with contextlib.ExitStack() as parts:
        for file, content in contents.items():
            whole = _in_bytes(file, content)
            try:
                _require_place(file)
                part = parts.enter_context(part_of(file.resolve()))
                part.write_bytes(whole)
            except OSError as error:
                raise _unwritten(file, error, len(whole)) from error


def write_own(file: Path, content: str | bytes) -> None:
    """Write a file of a run's folder, whole or not at all. A link in its place is replaced and not
    followed: the folder may be somebody else's, and its links may lead anywhere.

    Args:
        file: is overwritten.
        content: text is written as UTF-8, its line ends as they are.

    Raises:
        InputError: as ``write_whole``.
    """
    whole = _in_bytes(file, content)
    try:
        if not file.is_symlink():
            _require_place(file)
        _put(file, whole)
    except OSError as error:
        raise _unwritten(file, error, len(whole)) from error


def open_own(file: Path, mode: str) -> IO[Any]:
    """Open a file of a run's folder for writing, which has to be no link (see ``write_own``); text
    in UTF-8, bytes without a buffer.

    Raises:
        OSError: it is a link, or cannot be opened.
    """
    if file.is_symlink():
        raise OSError(errno.ELOOP, f"{file} is a link, and links are not written through")
    no_follow = getattr(os, "O_NOFOLLOW", 0)
    binary = "b" in mode
    return open(
        file,
        mode,
        buffering=0 if binary else -1,
        encoding=None if binary else "utf-8",
        newline=None if binary else "\n",
        opener=lambda path, flags: os.open(path, flags | no_follow, 0o666),
    )


def _put(file: Path, content: bytes | memoryview) -> None:
    with part_of(file) as part, part.open("wb") as stream:
        stream.write(content)


def _in_bytes(file: Path, content: str | bytes | memoryview) -> bytes | memoryview:
    try:
        return content.encode("utf-8") if isinstance(content, str) else content
    except UnicodeEncodeError as error:
        raise InputError(
            f"{file}: would hold a file's name that is not UTF-8; give names that are"
        ) from error


def write_csv(file: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows as CSV, the first one the heads; raises as ``write_whole``."""
    write_whole(file, in_csv(rows))


def in_csv(rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV, the first one the heads."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


def require_writable(file: Path) -> None:
    """Refuse, before anything is computed, a file that could not be written in the end.

    Raises:
        InputError: there is no such folder, or the file or its folder may not be written.
    """
    try:
        _require_place(file)
    except OSError as error:
        raise _unwritten(file, error, 0) from error


def require_own_writable(file: Path) -> None:
    """As ``require_writable``, of a file of a run's folder (``write_own``)."""
    require_writable(file.parent / "any" if file.is_symlink() else file)


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
            try_lock(held)  # from removal by others; one that cannot be locked nobody removes
            yield part
        if file.exists() and not file.is_symlink():
            shutil.copymode(file, part)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


def _remove_unless_held(part: Path) -> None:
    with contextlib.suppress(OSError), part.open("r+b") as left:
        if try_lock(left) == "by us":
            left.close()
            part.unlink()


def _unwritten(file: Path, error: OSError, needed: int) -> InputError:
    if error.errno in FULL:
        return InputError(
            f"{file}: the disk is full, {needed / 1e6:.3g} MB are needed; make room, or give a"
            " place on another disk"
        )
    return InputError(
        f"{file}: cannot be written ({error.strerror or error}); give a place you may write in"
    )

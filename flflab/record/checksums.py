"""CRC-32 of every frame, kept in its event, and SHA-256 of the folder's files, kept in
``SHA256SUMS`` as ``sha256sum -c`` reads it.

The descriptions have theirs from the beginning, the documents once the run has ended. A frame's sum
is to name a disk or memory that failed, thousands of times a run: CRC-32 sees every burst of up to
32 bits and takes 3 ms for 10 megapixels, SHA-256 11.
"""

import hashlib
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, RecordError
from flflab.whole_file import write_own

SUMS = "SHA256SUMS"


def checksum(picture: npt.NDArray[np.uint16]) -> str:
    """CRC-32 (as zlib's) of a picture's pixels, row by row, 16 bits little-endian, as 8 hexadecimal
    digits.
    """
    pixels: Any = np.ascontiguousarray(picture, dtype="<u2")
    return f"{zlib.crc32(pixels):08x}"


def write_sums(folder: Path, names: Iterable[str]) -> None:
    """Write the sums of those files that are there.

    Raises:
        RecordError: the folder cannot be written.
    """
    lines = [f"{_of_file(folder / name)}  {name}\n" for name in names if (folder / name).is_file()]
    try:
        write_own(folder / SUMS, "".join(lines))
    except InputError as error:
        raise RecordError(f"{error}; the record is whole but for its sums") from error


def verify_sums(folder: Path) -> None:
    """Compare the files of a folder with their sums; nothing where there are none.

    Raises:
        RecordError: a file is not what was recorded, or is missing; it is named.
    """
    file = folder / SUMS
    if not file.is_file():
        return
    for line in file.read_text(encoding="utf-8").splitlines():
        digest, _, name = line.partition("  ")
        if not (folder / name).is_file():
            raise RecordError(
                f"{folder / name}: is missing, and was there when recorded; take it from a copy, or"
                f" delete {SUMS} where that is meant"
            )
        if _of_file(folder / name) != digest:
            raise RecordError(
                f"{folder / name}: not as it was recorded (its SHA-256 is not the one in {SUMS});"
                f" take it from a copy, or delete {SUMS} where the change is meant"
            )


def _of_file(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

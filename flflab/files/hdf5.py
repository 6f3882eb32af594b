"""HDF5 files read as somebody else's: nothing outside the file is opened, whatever it names.

An HDF5 file may keep its numbers in other files (external storage, external links, virtual
datasets). From a stranger that is a way to any file that the reader may read.
"""

import contextlib
import io
import os
import re
from collections.abc import Generator
from pathlib import Path
from typing import Any, NamedTuple, cast

import h5py

from flflab.errors import InputError


@contextlib.contextmanager
def opened_hdf5(file: Path) -> Generator[h5py.File]:
    """An HDF5 file to be read, without a lock: what is written here is never in an unreadable
    state, and some disks know no locks. What a file cut short lacks at its end reads as zeros.

    Raises:
        OSError: it is missing, damaged, or may not be read.
    """
    short = cut_short(file)
    if short is None:
        with h5py.File(file, "r", locking=False) as opened:
            yield opened
        return
    with _Padded(file, short.whole) as stream, h5py.File(cast(Any, stream), "r") as opened:
        yield opened


class CutShort(NamedTuple):
    """Bytes of a file that is cut short: there, and as it should be."""

    there: int
    whole: int


def cut_short(file: Path) -> CutShort | None:
    """How much of a file is there, where its end is missing; None where it is whole, or no HDF5
    file.
    """
    try:
        with h5py.File(file, "r", locking=False):
            return None
    except OSError as error:
        whole = re.search(r"stored_eof = (\d+)", str(error))
        return CutShort(file.stat().st_size, int(whole[1])) if whole else None


def require_own_numbers(dataset: h5py.Dataset, file: Path) -> h5py.Dataset:
    """Return a dataset whose numbers lie in its own file.

    Raises:
        InputError: they lie elsewhere.
    """
    if dataset.external is not None or dataset.is_virtual:
        raise InputError(
            f"{file}: keeps {dataset.name} in other files, which are not opened; give a file that"
            " holds its own numbers"
        )
    return dataset


def member(group: h5py.Group, name: str, file: Path) -> h5py.Dataset:
    """A dataset of a file, by a link that stays in it.

    Raises:
        InputError: it lies in another file.
        KeyError: there is none of that name.
    """
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise InputError(
            f"{file}: {name} is a link, and links are not followed; give a file that holds its own"
            " numbers"
        )
    found = group[name]
    if not isinstance(found, h5py.Dataset):
        raise KeyError(name)
    return require_own_numbers(found, file)


class _Padded(io.FileIO):
    """A file with zeros after its end, up to a size."""

    def __init__(self, file: Path, size: int) -> None:
        super().__init__(file, "r")
        self._size = size

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Place the next read, counted from the size where it is counted from the end."""
        return (
            super().seek(self._size + offset)
            if whence == os.SEEK_END
            else super().seek(offset, whence)
        )

    def readinto(self, buffer: Any, /) -> int:
        """Fill a buffer."""
        view = memoryview(buffer).cast("B")
        have = super().readinto(view) or 0
        view[have:] = bytes(len(view) - have)
        return len(view)

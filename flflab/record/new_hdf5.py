"""An HDF5 file that is there whole or not at all, on a full disk too.

HDF5 does not survive a disk that takes no more: what it holds back it writes when it closes, with a
page of complaints and now and then the end of the program. So it writes into a stream that swallows
the fault and keeps it for who writes.
"""

import contextlib
import io
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import h5py

from flflab.record.durable import force_data
from flflab.whole_file import part_of


class _Stream(io.FileIO):
    """A file that takes everything, and keeps why it could not."""

    fault: OSError | None = None

    def write(self, content: Any, /) -> int:
        """Write all of it, until there is a fault."""
        left = memoryview(content).cast("B")
        while len(left) and self.fault is None:
            try:
                left = left[super().write(left) :]
            except OSError as error:
                self.fault = error
        return memoryview(content).nbytes

    def truncate(self, size: int | None = None, /) -> int:
        """Change the size, unless that cannot be."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.fault = self.fault or error
            return size or 0

    def raise_fault(self) -> None:
        """Raise what could not be written."""
        if self.fault is not None:
            raise self.fault


@contextlib.contextmanager
def new_hdf5(file: Path) -> Generator[tuple[h5py.File, Callable[[], None]]]:
    """A new HDF5 file, put in its place when it is on the disk, and what to call now and then: it
    raises what the disk did not take.

    Raises:
        OSError: the disk does not take it; what was in the file's place is there still.
    """
    with part_of(file) as part, _Stream(part, "r+") as stream:
        with h5py.File(stream, "w") as into:
            yield into, stream.raise_fault
        stream.raise_fault()
        force_data(stream.fileno())

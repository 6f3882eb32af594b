"""Forcing what was written to the disk, so that it survives a loss of power."""

import os
import sys
from pathlib import Path


def force_data(descriptor: int) -> None:
    """Force the bytes of an open file to the disk, and of its metadata what reading them needs.

    Raises:
        OSError: the disk does not take them.
    """
    # macOS's own fsync leaves them in the drive's cache, as fdatasync would: Python has no better
    getattr(os, "fdatasync", os.fsync)(descriptor)


def force_to_disk(place: Path) -> None:
    """Force a file, or the list of what is in a folder, to the disk.

    Raises:
        OSError: the disk does not take it.
    """
    if sys.platform == "win32" and place.is_dir():
        return  # folders cannot be opened there; its file system keeps a journal of names
    descriptor = os.open(place, os.O_RDONLY if sys.platform != "win32" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

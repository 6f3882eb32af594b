"""Forcing what was written to the disk, so that it survives a loss of power."""

import errno
import os
import sys
from pathlib import Path

UNABLE = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


def force_data(descriptor: int) -> bool:
    """Force the bytes of an open file to the disk, and of its metadata what reading them needs.

    Returns:
        Whether the disk can be asked to: some of a network or in user space cannot.

    Raises:
        OSError: the disk does not take them.
    """
    try:
        # macOS's own fsync leaves them in the drive's cache, as fdatasync would: Python has no
        # better
        getattr(os, "fdatasync", os.fsync)(descriptor)
    except OSError as error:
        if error.errno not in UNABLE:
            raise
        return False
    return True


def force_to_disk(place: Path) -> bool:
    """Force a file, or the list of what is in a folder, to the disk.

    Returns:
        Whether the disk can be asked to.

    Raises:
        OSError: the disk does not take it.
    """
    if sys.platform == "win32" and place.is_dir():
        return True  # folders cannot be opened there; its file system keeps a journal of names
    descriptor = os.open(place, os.O_RDONLY if sys.platform != "win32" else os.O_RDWR)
    try:
        return force_data(descriptor)
    finally:
        os.close(descriptor)

"""A lock on an open file that the system lets go when its program ends, however it ends.

Some disks know no locks: network file systems without a lock service, some mounts in user space.
"""

import os
import sys
from typing import IO, Any, Literal

BEYOND = 2**31 - 2  # a locked byte cannot be read on Windows: one that no file here reaches

Held = Literal["by us", "by another", "unknown"]


def try_lock(stream: IO[Any]) -> Held:
    """Lock an open file for this program, without waiting.

    Args:
        stream: a file open for writing; the lock lasts until it is closed.

    Returns:
        Who holds the lock; ``unknown`` where the disk knows no locks.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            here = stream.tell()
            stream.seek(BEYOND)
            try:
                msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
            finally:
                stream.seek(here, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return "by another"
    except OSError:
        return "unknown"
    return "by us"

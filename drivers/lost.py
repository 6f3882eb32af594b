"""Whether the counter of an axis can be trusted: said to every later program of this machine, since
a counter of steps agrees with itself after a stall.

A file says that the place is lost, its age against that of the files beside it whether that still
holds; nobody's file is opened.
"""

import contextlib
import os
from pathlib import Path

from drivers import locks

LOST, FOUND = ".lost", ".found"


class Trust:
    """Whether what an axis counts is where it stands.

    Args:
        place: what tells the axis from every other one of this machine; empty for one that no other
            program can reach.
    """

    def __init__(self, place: str = "") -> None:
        self._file = locks.file_of(place) if place else None
        self.lost = self._newest() == LOST

    def lose(self) -> None:
        """From now on it may be anywhere in its travel."""
        self.lost = True
        self._touch(LOST)

    def find(self) -> None:
        """Its reference was found."""
        if self.lost and self._file is not None:
            with contextlib.suppress(OSError):
                self._file.with_suffix(LOST).unlink(missing_ok=True)
            if self._newest() == LOST:  # of another user, who may not see that it was found
                self._touch(FOUND)
        self.lost = False

    def _newest(self) -> str:
        if self._file is None:
            return ""
        stem = self._file.name.removesuffix(f"{locks.user()}{locks.LOCK}")
        ages: dict[str, int] = {}
        for kind in (LOST, FOUND):
            for file in self._file.parent.glob(f"{stem}*{kind}"):
                with contextlib.suppress(OSError):
                    ages[kind] = max(ages.get(kind, 0), os.lstat(file).st_mtime_ns)
        return max(ages, key=ages.__getitem__) if ages else ""

    def _touch(self, kind: str) -> None:
        if self._file is None:
            return
        file: Path = self._file.with_suffix(kind)
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
            os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644))

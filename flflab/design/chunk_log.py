"""What chunks of a search found, and their log: one JSON line a chunk, so that an interrupted
search goes on where it was.
"""

import contextlib
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

import numpy as np

from flflab.design.front import Front, merged
from flflab.design.requirements import Requirements
from flflab.errors import InputError
from flflab.whole_file import write_whole

Chunk = tuple[int, int]


@dataclass(frozen=True)
class Found:
    """What a search, or one chunk of it, found.

    Attributes:
        front: of the configurations that meet every demand.
        chunks: which were searched: first number, number after the last.
        built: of them with a real gap within its range.
        met: of them that meet every demand.
    """

    front: Front
    chunks: tuple[Chunk, ...]
    built: int
    met: int

    @property
    def tried(self) -> int:
        """How many configurations were numbered."""
        return sum(last - first for first, last in self.chunks)

    def with_more(self, other: "Found") -> "Found":
        """Both together."""
        front = merged(self.front, other.front.numbers, other.front.values)
        return Found(
            front, self.chunks + other.chunks, self.built + other.built, self.met + other.met
        )


def fingerprint(wanted: Requirements) -> str:
    """A name for these requirements: equal ones share it."""
    return hashlib.blake2b(wanted.model_dump_json().encode(), digest_size=12).hexdigest()


class ChunkLog:
    """The log of a search; without a file it remembers nothing."""

    def __init__(self, file: Path | None, search: str) -> None:
        """Read what is there already.

        Raises:
            InputError: the log belongs to other requirements, or is no log.
        """
        self.done: list[Found] = []
        self._file, self._search = file, search
        self._stream: TextIO | None = None
        if file is not None and file.exists():
            self._read(file)

    def __enter__(self) -> "ChunkLog":
        if self._file is not None:
            try:
                self._stream = self._file.open("a", encoding="utf-8")
            except OSError as error:
                raise _unwritten(self._file, error) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._stream is not None:
            with contextlib.suppress(
                OSError
            ):  # every line was flushed, or was told not to be on the disk
                self._stream.close()

    def add(self, part: Found) -> None:
        """Write one chunk's result; it is on the disk before the next is awaited.

        Raises:
            InputError: the disk does not take it.
        """
        if self._file is None or self._stream is None:
            return
        row = {
            "search": self._search,
            "chunks": part.chunks,
            "built": part.built,
            "met": part.met,
            "epsilon": part.front.epsilon,
            "numbers": part.front.numbers.tolist(),
            "values": part.front.values.tolist(),
        }
        try:
            self._stream.write(json.dumps(row) + "\n")
            self._stream.flush()
        except OSError as error:
            raise _unwritten(self._file, error) from error

    def _read(self, file: Path) -> None:
        text = file.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            write_whole(file, whole)  # without a line that was being written when the search ended
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                row: dict[str, Any] = json.loads(line)
                search, front = (
                    row["search"],
                    Front(
                        np.array(row["numbers"], dtype=np.int64),
                        np.array(row["values"]),
                        row["epsilon"],
                    ),
                )
                chunks = tuple((int(first), int(last)) for first, last in row["chunks"])
                found = Found(front, chunks, row["built"], row["met"])
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(
                    f"{file}:{number}: this is no log of a search; give another --out, or delete it"
                ) from error
            if search != self._search:
                raise InputError(
                    f"{file}:{number}: this log is of a search with other requirements; give"
                    " another --out, or delete it"
                )
            self.done.append(found)


def _unwritten(file: Path, error: OSError) -> InputError:
    return InputError(
        f"{file}: the log of the search cannot be written ({error.strerror or error}); make room,"
        " or give another --out, and start again: what the log holds is not searched again"
    )

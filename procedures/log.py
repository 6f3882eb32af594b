"""The log of a run: everything that is logged meanwhile, in its folder, in UTC."""

import contextlib
import logging
from collections.abc import Generator
from datetime import UTC, datetime

from flflab.errors import RecordError
from flflab.printable import printable
from flflab.record import Recording
from flflab.whole_file import open_own


class UtcFormatter(logging.Formatter):
    """Lines of a log, ``2024-10-27 01:30:00,123 UTC INFO drivers.axis: ...``, without characters
    that a terminal would obey.
    """

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:  # noqa: N802
        """The moment of a record, in UTC."""
        moment = datetime.fromtimestamp(record.created, UTC)
        return moment.strftime("%Y-%m-%d %H:%M:%S,") + f"{moment.microsecond // 1000:03d} UTC"

    def format(self, record: logging.LogRecord) -> str:
        """The whole line, a traceback's lines below it."""
        return printable(super().format(record))


@contextlib.contextmanager
def logged(recording: Recording) -> Generator[None, None, None]:
    """The log of everything meanwhile, in the run's folder, in UTC as all times of a record."""
    try:
        stream = open_own(recording.folder / "log.txt", "a")
    except OSError as error:
        raise RecordError(
            f"{recording.folder}: its log.txt cannot be written ({error.strerror or error}); remove"
            " it, or give another folder"
        ) from error
    handler = logging.StreamHandler(stream)
    handler.setFormatter(UtcFormatter())
    root, level = logging.getLogger(), logging.getLogger().level
    root.addHandler(handler)
    root.setLevel(min(level, logging.INFO) or logging.INFO)
    try:
        yield
    finally:
        root.setLevel(level)
        root.removeHandler(handler)
        handler.close()
        stream.close()

"""Turns on a line that several axes share, in the order in which they were asked for. No lock of
Python's promises an order: one who asks without a pause may keep all others from the line.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Generator


class Turns:
    """One at a time, first come, first served; who is urgent goes before all who wait."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._busy = False
        self._waiting: deque[object] = deque()

    @contextlib.contextmanager
    def take(self, *, urgent: bool = False) -> Generator[None]:
        """Wait for a turn, and have it."""
        ticket = object()
        with self._changed:
            (self._waiting.appendleft if urgent else self._waiting.append)(ticket)
            try:
                self._changed.wait_for(lambda: not self._busy and self._waiting[0] is ticket)
                self._busy = True
            finally:  # an interrupt, too, makes room for the next
                self._waiting.remove(ticket)
                self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._busy = False
                self._changed.notify_all()

"""A connection that is opened anew after it was lost, and a message that is sure to have gone over the present one."""

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from drivers.transport import LostError, Wire
from flflab.errors import CommunicationError


class Closable(Protocol):
    """What a line leads over."""

    def close(self) -> object:
        """Let go of it."""
        ...


Link = TypeVar("Link", bound=Closable)


class Line(Generic[Link]):
    """The way to an instrument: open from the start; after a loss (a plug pulled) the next who needs it opens it anew.

    So a stop can still arrive. Any thread may use it.

    Args:
        opener: opens the way.

    Raises:
        CommunicationError: it cannot be opened.
    """

    def __init__(self, opener: Callable[[], Link]) -> None:
        self._opener = opener
        self._opening = threading.Lock()
        self._link: Link | None = None
        self.get()

    def get(self) -> Link:
        """The way as it is open now.

        Raises:
            CommunicationError: it was lost and cannot be opened.
        """
        with self._opening:
            if self._link is None:
                self._link = self._opener()
            return self._link

    def lose(self, link: Link) -> None:
        """Let go of what turned out to be lost; nothing happens where it has been opened anew already."""
        with self._opening:
            link.close()
            self._link = None if self._link is link else self._link

    def close(self) -> None:
        """Let go of it."""
        if self._link is not None:
            self.lose(self._link)


def tell_surely(line: Line[Wire], message: bytes, listens: Callable[[], object]) -> None:
    """Write a message at once, past whoever waits, and see that the instrument listens; written again where the line was lost meanwhile.

    Args:
        line: the line.
        message: such as a stop: one that may be told twice.
        listens: asks the instrument something.

    Raises:
        CommunicationError: it does not listen.
    """
    for last in (False, True):
        wire = line.get()
        try:
            try:
                wire.write(message)
            except LostError:
                line.lose(wire)
                raise
            listens()
            if line.get() is wire:
                return
            raise LostError(f"{wire.address}: lost and opened anew while the axis was told to stop; check the cable")
        except CommunicationError:
            if last:
                raise

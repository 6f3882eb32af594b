"""A connection that is opened anew after it was lost, and a stop that is sure to have gone over the
present one.
"""

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
    """The way to an instrument: open from the start; after a loss (a plug pulled) the next who
    needs it opens it anew.

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
        self._over = False
        self.get()

    def get(self, asked: str = "") -> Link:
        """The way as it is open now.

        Args:
            asked: who needs it and for what, as the error is to begin.

        Raises:
            CommunicationError: it was lost and cannot be opened, or was let go of.
        """
        with self._opening:
            if self._link is None and not self._over:
                try:
                    self._link = self._opener()
                except CommunicationError as error:
                    raise CommunicationError(f"{asked}{error}") from error
            if self._over:  # meanwhile: nobody else would close what was just opened
                self._let_go()
            if self._link is None:
                raise CommunicationError(f"{asked}the line was let go of; connect again")
            return self._link

    def lose(self, link: Link) -> None:
        """Let go of what turned out to be lost; nothing happens where it has been opened anew
        already.
        """
        with self._opening:
            link.close()
            self._link = None if self._link is link else self._link

    def close(self) -> None:
        """Let go of it for good; waits for nobody who just opens it."""
        self._over = True
        self._let_go()

    def _let_go(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()


def stop_surely(line: Line[Wire], name: str, message: bytes, listens: Callable[[], object]) -> None:
    """Write a stop at once, past whoever waits, and see that the instrument listens; written again
    where the line was lost meanwhile.

    Args:
        line: the line.
        name: of the axis, for messages.
        message: the stop.
        listens: asks the instrument something.

    Raises:
        CommunicationError: it does not listen.
    """
    told = f"{name}: told to stop, "
    for last in (False, True):
        wire = line.get(told)
        try:
            try:
                wire.write(message)
            except LostError as error:
                line.lose(wire)
                raise LostError(f"{told}{error}") from error
            listens()
            if line.get(told) is wire:
                return
            raise LostError(
                f"{told}{wire.address} was lost and opened anew meanwhile; check the cable"
            )
        except CommunicationError:
            if last:
                raise

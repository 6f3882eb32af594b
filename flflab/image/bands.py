"""Bands of rows of a picture, worked through on all cores, and given up where nobody waits for
the picture any more.
"""

import contextlib
import os
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar

BANDS = 2  # for each core, so that none waits long for another


class GivenUpError(Exception):
    """Nobody waits for the picture any more."""


_given_up: ContextVar[Callable[[], bool]] = ContextVar("given_up", default=lambda: False)


@contextlib.contextmanager
def given_up_when(asked: Callable[[], bool]) -> Generator[None]:
    """Pictures that this thread forms meanwhile end with ``GivenUpError`` once ``asked`` says so.

    Args:
        asked: called after each piece of work, from any thread.
    """
    token = _given_up.set(asked)
    try:
        yield
    finally:
        _given_up.reset(token)


def go_on() -> None:
    """Between pieces of work.

    Raises:
        GivenUpError: see ``given_up_when``.
    """
    if _given_up.get()():
        raise GivenUpError


def in_bands(work: Callable[[int, int], Iterable[None]], rows: int) -> None:
    """Do the work of all bands.

    Args:
        work: called with the first row and the row after the last of each band; yields after each
            piece. Pixels must not depend on how rows are shared out.
        rows: of the picture.

    Raises:
        GivenUpError: see ``given_up_when``.
    """
    cores = os.cpu_count() or 1
    height = max(1, -(-rows // (BANDS * cores)))
    asked, left = _given_up.get(), threading.Event()

    def band(start: int) -> None:
        for _ in work(start, min(start + height, rows)):
            if left.is_set() or asked():
                raise GivenUpError

    with ThreadPoolExecutor(cores) as pool:
        try:
            for _ in pool.map(band, range(0, rows, height)):
                pass
        finally:  # an interruption ends the other bands, too
            left.set()

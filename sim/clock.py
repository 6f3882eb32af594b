"""Simulated time: real time at a rate, or stepped by hand."""

import threading
import time
from typing import Protocol

POLL = 0.005  # s of real time between looks at the clock while waiting


class Clock(Protocol):
    """What the simulated instruments read: seconds since 1970-01-01 UTC, never falling."""

    def now(self) -> float:
        """The simulated time, s."""
        ...

    def wait_until(self, instant: float, given_up: threading.Event) -> bool:
        """Wait until the simulated time ``instant``; True then, False as soon as ``given_up`` is
        set.
        """
        ...


class RunningClock:
    """Real time from the moment of its making on, times a rate."""

    def __init__(self, rate: float = 1.0) -> None:
        """Start now.

        Args:
            rate: simulated seconds per real second, above 0.
        """
        self.rate = rate
        self._epoch = time.time()
        self._start = time.monotonic()

    def now(self) -> float:
        """The simulated time, s."""
        return self._epoch + self.rate * (time.monotonic() - self._start)

    def wait_until(self, instant: float, given_up: threading.Event) -> bool:
        """Wait until the simulated time ``instant``; True then, False as soon as ``given_up`` is
        set.
        """
        while (rest := instant - self.now()) > 0:
            if given_up.wait(rest / self.rate):
                return False
        return not given_up.is_set()


class SteppedClock:
    """Time that stands still until somebody steps it; for tests that want exact instants."""

    def __init__(self, start: float = 0.0) -> None:
        """Stand at ``start`` seconds."""
        self._now = start

    def now(self) -> float:
        """The simulated time, s."""
        return self._now

    def step(self, seconds: float) -> None:
        """Let so many seconds pass at once."""
        self._now += seconds

    def wait_until(self, instant: float, given_up: threading.Event) -> bool:
        """Wait until somebody steps past ``instant``; True then, False as soon as ``given_up`` is
        set.
        """
        while self._now < instant:
            if given_up.wait(POLL):
                return False
        return not given_up.is_set()

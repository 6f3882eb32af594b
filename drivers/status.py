"""The promise of something that takes time: a thread completes it, anyone may wait for it."""

import threading
import time
from collections.abc import Callable

from flflab.errors import DeviceError
from flflab.waiting import wait_for


class Status:
    """Something under way, completed once by whoever does it; satisfies bluesky's ``Status``
    protocol.

    Args:
        task: what is under way, as an operator would say it: ``array_stage to 12.5 mm``.
    """

    def __init__(self, task: str) -> None:
        self.task = task
        self._finished = threading.Event()
        self._changing = threading.Lock()
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[Status], None]] = []

    def __repr__(self) -> str:
        state = (
            "under way" if not self.done else "done" if self.success else f"failed: {self._error}"
        )
        return f"<{self.task}: {state}>"

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._finished.is_set()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._error is None

    def complete(self, error: BaseException | None = None) -> None:
        """End it, well or with an error; only the first call counts."""
        with self._changing:
            if self.done:
                return
            self._error = error
            self._finished.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)

    def add_callback(self, callback: Callable[["Status"], None]) -> None:
        """Call this with the status when it ends, at once if it has ended."""
        with self._changing:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Why it failed, None if it ended well.

        Args:
            timeout: how long to wait for its end, s; None waits for ever.

        Raises:
            TimeoutError: it has not ended.
        """
        if not wait_for(self._finished, timeout):
            raise TimeoutError(
                f"{self.task}: still under way after {timeout:g} s; wait longer or stop it"
            )
        return self._error

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end; raise what it failed with.

        Args:
            timeout: how long to wait, s; None waits for ever.

        Raises:
            DeviceError: it failed; the class says how.
            TimeoutError: it has not ended.
        """
        error = self.exception(timeout)
        if error is not None:
            raise error


def wait_all(*statuses: Status, timeout: float | None = None) -> None:
    """Wait for several at once.

    Args:
        statuses: what is under way.
        timeout: how long to wait for all of them together, s; None waits for ever.

    Raises:
        DeviceError: at least one failed; the sentences of all that did. A single failure is raised
            as it is.
        TimeoutError: at least one has not ended.
    """
    ends = None if timeout is None else time.monotonic() + timeout
    errors = [
        error
        for status in statuses
        if (error := status.exception(None if ends is None else max(0.0, ends - time.monotonic())))
    ]
    if len(errors) == 1:
        raise errors[0]
    if errors:
        raise DeviceError("\n".join(str(error) for error in errors))

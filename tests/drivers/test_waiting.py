"""Who waits for a device can be interrupted, and is told in time."""

import threading
import time

import pytest

from drivers.status import Status
from flflab.waiting import STRETCH_S, wait_for


class Watched(threading.Event):
    """An event that knows how long it was waited for at once."""

    def __init__(self) -> None:
        super().__init__()
        self.waits: list[float | None] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.waits.append(timeout)
        return super().wait(timeout)


@pytest.mark.parametrize("timeout", [None, 10.0])
def test_no_wait_is_longer_than_a_stretch_for_on_windows_none_can_be_interrupted(
    timeout: float | None,
) -> None:
    event = Watched()
    threading.Timer(3 * STRETCH_S, event.set).start()
    assert wait_for(event, timeout)
    assert len(event.waits) >= 2
    assert all(wait is not None and wait <= STRETCH_S for wait in event.waits)


def test_a_wait_ends_at_its_timeout() -> None:
    began = time.monotonic()
    assert not wait_for(threading.Event(), 2.5 * STRETCH_S)
    assert time.monotonic() - began >= 2.5 * STRETCH_S
    assert not wait_for(threading.Event(), 0.0)


def test_a_stage_that_is_waited_for_is_waited_for_in_stretches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    events: list[Watched] = []
    monkeypatch.setattr(threading, "Event", lambda: events.append(Watched()) or events[-1])
    status = Status("array_stage to 12.5 mm")
    monkeypatch.undo()
    timer = threading.Timer(2 * STRETCH_S, status.complete)
    timer.start()
    status.wait()
    timer.join()
    assert all(wait is not None and wait <= STRETCH_S for wait in events[0].waits)

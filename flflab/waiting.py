"""Waiting that Ctrl-C ends on every system."""

import math
import threading
import time

STRETCH_S = 0.05


def wait_for(event: threading.Event, timeout: float | None = None) -> bool:
    """Wait for an event in short stretches: on Windows the main thread hears no signal within one
    wait, and a stage would go on.

    Args:
        event: what is waited for.
        timeout: how long, s; None waits for ever.

    Returns:
        Whether it has happened.
    """
    ends = math.inf if timeout is None else time.monotonic() + timeout
    while not event.wait(min(STRETCH_S, max(0.0, ends - time.monotonic()))):
        if time.monotonic() >= ends:
            return False
    return True

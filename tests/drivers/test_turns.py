"""Who shares a line has his turn on it."""

import threading
import time

from drivers.turns import Turns


def test_who_asks_without_a_pause_keeps_nobody_else_from_the_line() -> None:
    turns, ended = Turns(), threading.Event()
    taken: list[None] = []

    def ask_on_and_on() -> None:
        while not ended.is_set():
            with turns.take():
                taken.append(None)
                time.sleep(0.005)

    busy = threading.Thread(target=ask_on_and_on)
    busy.start()
    try:
        for _ in range(20):
            before = len(taken)
            with turns.take():
                assert len(taken) - before <= 3
    finally:
        ended.set()
        busy.join()


def test_turns_come_in_the_order_asked_for_and_an_urgent_one_first() -> None:
    turns = Turns()
    order: list[str] = []

    def ask(name: str, urgent: bool) -> None:
        with turns.take(urgent=urgent):
            order.append(name)

    threads = [
        threading.Thread(target=ask, args=(name, name == "stop"))
        for name in ("first", "second", "stop")
    ]
    with turns.take():
        for thread in threads:
            thread.start()
            time.sleep(0.05)
    for thread in threads:
        thread.join()
    assert order == ["stop", "first", "second"]


def test_a_turn_that_ends_in_an_error_is_over() -> None:
    turns = Turns()
    try:
        with turns.take():
            raise RuntimeError
    except RuntimeError:
        pass
    with turns.take():
        pass

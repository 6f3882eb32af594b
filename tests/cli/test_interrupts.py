"""Ctrl-C at any moment: exit 130 and a sentence, no traceback, and nobody is kept waiting."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from flflab.cli.command import again_if_an_interruption
from flflab.cli.ending import is_interruption
from flflab.verdict.evaluation import measuring_threads


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """Interrupts are heard, though a shell tells jobs in the background to ignore them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


REPORT = """
import os, signal, sys, threading, time
from flflab.cli import main
started = threading.Event()
sys.setprofile(lambda frame, event, what: started.set() if frame.f_code.co_name == "{function}" and event == "call" else None)
threading.Thread(target=lambda: (started.wait(), time.sleep(0.05), os.kill(os.getpid(), signal.SIGINT)), daemon=True).start()
sys.argv = ["flflab", *{arguments}]
main()
"""  # noqa: E501


@pytest.mark.skipif(
    sys.platform == "win32", reason="an interrupt cannot be sent to one process alone there"
)
@pytest.mark.parametrize(
    "function", ["get_command", "expect_all"]
)  # while a command loads, and while it computes
def test_a_command_says_that_it_was_interrupted(function: str, root: Path) -> None:
    study = str(root / "examples" / "studies" / "first.yaml")
    source = REPORT.format(function=function, arguments=["plan", study])
    ended = subprocess.run(
        [sys.executable, "-P", "-c", source],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (130, "flflab: interrupted")
    assert "Traceback" not in ended.stderr


def test_an_interrupt_where_python_drops_errors_comes_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Dropped:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(sys, "unraisablehook", again_if_an_interruption)
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        one = Dropped()
        del one
        time.sleep(5)


def test_an_interrupt_in_the_middle_of_a_class_is_one() -> None:
    class Interrupts:
        def __set_name__(self, owner: type, name: str) -> None:
            signal.raise_signal(signal.SIGINT)

    # Python 3.11 wraps it in a RuntimeError, 3.12 does not
    with pytest.raises(BaseException) as raised:  # noqa: PT011
        type("Loaded", (), {"field": Interrupts()})
    assert is_interruption(raised.value)
    assert not is_interruption(RuntimeError("of another reason"))


def test_who_interrupts_does_not_wait_for_what_is_being_measured() -> None:
    measured, release = threading.Event(), threading.Event()
    with pytest.raises(KeyboardInterrupt), measuring_threads() as pool:  # noqa: PT012
        for _ in range(100):
            pool.submit(release.wait, 60)
        pool.submit(measured.set)
        signal.raise_signal(signal.SIGINT)
    release.set()
    pool.shutdown()
    assert not measured.is_set()

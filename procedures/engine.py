"""Runs a plan with bluesky: rehearsed first, recorded as it goes, ended by Ctrl-C or a fault with
every axis told to stop.
"""

import asyncio
import contextlib
import io
import logging
import signal
import threading
import time
from collections.abc import Generator
from typing import Any

from bluesky import Msg, RunEngine
from bluesky import plan_stubs as bps
from bluesky import preprocessors as bpp
from bluesky.simulators import check_limits
from bluesky.utils import DuringTask, FailedStatus, RunEngineInterrupted

from drivers.bench import ConnectedBench
from flflab.errors import DeviceError, FlflabError
from flflab.record import Recording
from flflab.waiting import wait_for
from procedures.log import logged

Plan = Generator[Msg, Any, Any]
BY_OPERATOR = "interrupted by the operator"
LOOK_S = 0.05
HEARD = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)
)  # the last is Windows' own


class RunInterruptedError(FlflabError):
    """The operator asked for the end of a run; every axis was told to stop and what was recorded so
    far is intact.
    """


def perform(
    plan: Plan,
    rehearsal: Plan,
    metadata: dict[str, Any],
    bench: ConnectedBench,
    recording: Recording,
) -> None:
    """Rehearse a plan without moving, then run it, and close the record; Ctrl-C is heard in the
    main thread only.

    Args:
        plan: what to do.
        rehearsal: the same once more, to be looked through for limits.
        metadata: what the run's start document says.
        bench: whose axes are stopped when the plan does not end well.
        recording: gets every document; closed at the end.

    Raises:
        RunInterruptedError: SIGINT or SIGTERM arrived; every axis was told to stop. Where the run
            had not begun its record is gone.
        LimitError: the rehearsal found something out of limits; nothing moved.
        FlflabError: a device, a measurement or the disk failed; every axis was told to stop.
    """
    failure: Exception | None = None
    with (
        signals_heard() as asked,
        contextlib.closing(recording),
        logged(recording),
        running_engine() as engine,
    ):
        if recording.remark:
            logging.getLogger(__name__).warning(recording.remark)
        try:
            check_limits(rehearsal)
        except FlflabError:
            recording.discard()
            raise
        engine.subscribe(recording.document)
        try:
            with interrupting(engine, bench, asked):
                if not asked.is_set():
                    engine(as_run(plan, metadata, asked))
        except RunEngineInterrupted:
            # It prints what it does, and fails with the motions that were told to stop.
            with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(FailedStatus):
                if engine.state != "idle":  # the plan ended just then
                    engine.abort()
        except Exception as error:
            failure = sentence(error, stop(bench))
        if asked.is_set() and recording.empty:
            recording.discard()
            raise RunInterruptedError("interrupted before anything was recorded")
    if asked.is_set():
        raise RunInterruptedError(f"interrupted; recorded so far is in {recording.folder}")
    if failure is not None:  # raised here: what the engine wrapped round it is in the log
        raise failure


def as_run(plan: Plan, metadata: dict[str, Any], asked: threading.Event) -> Plan:
    """A plan as one recorded run, whose stop document says in a sentence why it did not end well;
    ``asked`` to, or by a fault.
    """

    def end(error: Exception) -> Plan:
        if asked.is_set():
            yield from bps.close_run(exit_status="abort", reason=BY_OPERATOR)
        else:
            yield from bps.close_run(exit_status="fail", reason=str(sentence(error)))

    yield from bps.open_run(metadata)
    yield from bpp.contingency_wrapper(plan, except_plan=end, else_plan=bps.close_run)


def sentence(error: Exception, further: str = "") -> Exception:
    """What a plan failed with: of a failed status what the device said, with what came on top; of a
    fault of ours the fault.
    """
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, FlflabError):
        cause = cause.__cause__
    if cause is None:
        return error
    return type(cause)(f"{cause}; {further}") if further else cause


def stop(bench: ConnectedBench) -> str:
    """Stop every axis; returns which did not stop, in words, empty where all did."""
    try:
        bench.stop()
    except DeviceError as error:
        logging.getLogger(__name__).error("not every axis stopped: %s", error)
        return "not every axis stopped: cut the power of the stages if they still move"
    return ""


@contextlib.contextmanager
def interrupting(
    engine: RunEngine, bench: ConnectedBench, asked: threading.Event
) -> Generator[None, None, None]:
    """While this lasts a thread waits to be asked: it stops every axis and pauses the engine, each
    without waiting for the other.
    """
    over = threading.Event()

    def wait() -> None:
        while not asked.wait(LOOK_S):
            if over.is_set():
                return
        stopping = threading.Thread(target=stop, args=(bench,), name="stop the bench", daemon=True)
        stopping.start()
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it does
            while not over.is_set():
                with contextlib.suppress(RuntimeError):  # it begins or ends just now
                    engine.request_pause(defer=False)
                    break
                time.sleep(LOOK_S)
        stopping.join()

    waiting = threading.Thread(target=wait, name="wait for an interruption", daemon=True)
    waiting.start()
    try:
        yield
    finally:
        over.set()
        waiting.join()


@contextlib.contextmanager
def signals_heard() -> Generator[threading.Event, None, None]:
    """An event that Ctrl-C, Ctrl-Break and SIGTERM set meanwhile; in another thread than the main
    one nothing does.
    """
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    previous = {number: signal.signal(number, lambda *_: asked.set()) for number in HEARD}
    try:
        yield asked
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


class PatientLoop(asyncio.SelectorEventLoop):
    """An event loop that may be told of a device's end after its own: nobody listens any more then,
    and the log is told at most.
    """

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """What a task failed with that nobody waited for; asyncio's would print it below the
        sentence an operator gets.
        """
        logging.getLogger(__name__).info(
            "left by the engine: %s", context["message"], exc_info=context.get("exception")
        )

    def call_soon_threadsafe(
        self, callback: Any, *args: Any, context: Any = None
    ) -> asyncio.Handle:
        """As asyncio's, or nothing after the end."""
        try:
            return super().call_soon_threadsafe(callback, *args, context=context)
        except RuntimeError:
            return asyncio.Handle(callback, args, self, context)


class Blocking(DuringTask):
    """The main thread hears signals while it waits, on every system."""

    def block(self, blocking_event: threading.Event) -> None:
        """Wait for the engine."""
        wait_for(blocking_event)


@contextlib.contextmanager
def running_engine() -> Generator[RunEngine, None, None]:
    """A bluesky engine without its own handling of Ctrl-C, and no thread of it afterwards."""
    loop = PatientLoop()
    try:
        yield RunEngine({}, loop=loop, context_managers=[], during_task=Blocking())
    finally:
        loop.call_soon_threadsafe(loop.stop)
        while loop.is_running():
            time.sleep(0.001)
        loop.close()

"""One command from its words to its exit code."""

import _thread
import os
import signal
import sys
import threading

from flflab.cli.ending import (
    INTERRUPTED,
    end_with_one_sentence,
    end_without_output,
    is_interruption,
    lost_output,
)
from flflab.cli.saying import replace_what_the_terminal_lacks
from flflab.errors import FlflabError
from flflab.house import stranger_among_packages
from flflab.kernel_cache import remove_temporary_kernels


def run() -> None:
    """Run one command; exit 0 done, 1 could not be done, 2 usage, 3 the comparison rejects the
    model, 130 interrupted.
    """
    if (
        signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    ):  # so starts a shell a job in the background; who moves hears an interrupt
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.unraisablehook = again_if_an_interruption
    replace_what_the_terminal_lacks()
    try:
        code = _command()
        if sys.stdout is not None:  # None where it was closed beforehand
            # what is left may find the disk full; Python, ending, tells that with a traceback
            sys.stdout.flush()
    except BaseException as error:
        if is_interruption(error):
            sys.stderr.write("\nflflab: interrupted\n")
            sys.stderr.flush()
            remove_temporary_kernels()
            # threads may still measure; they hold nothing, and an operator does not wait for them
            os._exit(INTERRUPTED)
        lost = lost_output() if isinstance(error, OSError) else None
        if lost is None:
            raise
        code = end_without_output(lost)
    sys.exit(code)


def _command() -> int | str | None:
    """Run one command and say how it ended."""
    try:
        stranger = stranger_among_packages()
        if stranger:
            raise FlflabError(stranger)
        from flflab.cli.app import app  # inside, so that Ctrl-C while it loads is heard as one

        app(standalone_mode=True)
    except FlflabError as error:
        return end_with_one_sentence(error)
    except MemoryError as error:
        why = f" ({error})" if str(error) else ""
        return end_with_one_sentence(
            FlflabError(f"not enough memory{why}; ask for less at once, or close other programs")
        )
    except SystemExit as ending:
        if is_interruption(ending):  # typer makes such an ending of Ctrl-C while a command loads
            raise
        return ending.code
    return 0


def again_if_an_interruption(lost: "sys.UnraisableHookArgs") -> None:
    """An interrupt that came where Python drops errors, a callback from compiled code, comes again
    a moment later.
    """
    if is_interruption(lost.exc_value):
        threading.Timer(0.02, _interrupt).start()
    else:
        sys.__unraisablehook__(lost)


def _interrupt() -> None:
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        os.kill(os.getpid(), signal.SIGINT)  # wakes who waits, too

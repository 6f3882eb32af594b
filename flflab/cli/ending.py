"""How a command ends: one sentence for the operator, the chain of causes for the log."""

import contextlib
import logging
import os
import sys
from collections.abc import Generator

from flflab.cli.saying import say
from flflab.errors import FlflabError

LOG = logging.getLogger(__name__)
INTERRUPTED = 130


class InterruptedCommandError(Exception):
    """A command was ended by Ctrl-C; under this name it passes through what prints or hides a
    KeyboardInterrupt.
    """


def is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C is the reason of an error; Python wraps it in another one where it comes in
    the middle of an import.
    """
    while error is not None:
        if isinstance(error, (KeyboardInterrupt, InterruptedCommandError)):
            return True
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return False


def end_with_one_sentence(error: FlflabError) -> int:
    """Print the error for the operator, log its causes, and return exit code 1."""
    say(f"flflab: {error}")
    told: list[BaseException] = [error]
    while (cause := told[-1].__cause__) is not None and cause not in told:
        LOG.info("caused by %s: %s", type(cause).__name__, cause)
        told.append(cause)
    return 1


def lost_output() -> OSError | None:
    """Why standard output takes nothing more; None where it does, or where there is none."""
    if sys.stdout is None:
        return None
    try:
        sys.stdout.write("\n")  # what it did not take before may be gone from its buffer
        sys.stdout.flush()
    except OSError as error:
        return error
    return None


def end_without_output(lost: OSError) -> int:
    """Say that standard output takes nothing more, but not to who closed the pipe, as ``head``
    does; return exit code 1.
    """
    if not isinstance(lost, BrokenPipeError):
        sys.stderr.write(
            f"flflab: standard output cannot be written ({lost.strerror or lost}); send it to a"
            " place with room\n"
        )
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())  # Python flushes it once more when it ends
    os.close(nowhere)
    return 1


@contextlib.contextmanager
def reader_may_go() -> Generator[None]:
    """What is printed in it may find that its reader has gone, as ``head`` does; the command's
    answer, its exit code, stays.
    """
    try:
        yield
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError as error:
        end_without_output(error)
    except SystemExit:  # rich makes one of a broken pipe, and has sent the rest nowhere
        pass

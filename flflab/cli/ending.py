"""How a command ends: one sentence for the operator, the chain of causes for the log."""

import json
import logging
import sys
from typing import Any

from flflab.errors import FlflabError

LOG = logging.getLogger(__name__)
INTERRUPTED = 130


class InterruptedCommandError(Exception):
    """A command was ended by Ctrl-C; under this name it passes through what prints or hides a KeyboardInterrupt."""


def is_interruption(error: BaseException | None) -> bool:
    """Whether Ctrl-C is the reason of an error; Python wraps it in another one where it comes in the middle of an import."""
    while error is not None:
        if isinstance(error, (KeyboardInterrupt, InterruptedCommandError)):
            return True
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return False


def end_with_one_sentence(error: FlflabError) -> int:
    """Print the error for the operator, log its causes, and return exit code 1."""
    sys.stderr.write(f"flflab: {error}\n")
    told: list[BaseException] = [error]
    while (cause := told[-1].__cause__) is not None and cause not in told:
        LOG.info("caused by %s: %s", type(cause).__name__, cause)
        told.append(cause)
    return 1


def print_json(result: dict[str, Any]) -> None:
    """Print one JSON object on standard output; nan and infinity have no place in it."""
    sys.stdout.write(json.dumps(result, allow_nan=False) + "\n")

"""How a command ends: one sentence for the operator, the chain of causes for the log."""

import json
import logging
import sys
from typing import Any

from flflab.errors import FlflabError

LOG = logging.getLogger(__name__)


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

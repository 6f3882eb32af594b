"""The first thing that ``flflab bench stop`` does, before the rest of the command is loaded: to ask
who drives the bench to stop.
"""

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path

from flflab.errors import FlflabError

HEARD_S = 0.03  # in which an owner that lives has heard it; loading would keep the thread waiting


def ask_to_stop_early(arguments: Sequence[str]) -> None:
    """Where these words are ``bench stop``, ask in a thread of its own; what comes of it is told
    by the command, which asks again.
    """
    if list(arguments[:2]) != ["bench", "stop"]:
        return
    words = [word for given in arguments for word in given.split("=", 1)]
    if "--bench" not in words[:-1]:
        return
    try:
        from drivers.owner import ask_owners_to_stop  # loads a tenth of what the command does
    except ImportError:  # another project's `drivers`, as the command will say
        return
    file = Path(words[words.index("--bench") + 1])

    def ask() -> None:
        with contextlib.suppress(FlflabError, OSError):
            ask_owners_to_stop(file)

    asking = threading.Thread(target=ask, name="ask owners early", daemon=True)
    asking.start()
    asking.join(HEARD_S)

"""What a command that says nothing for a while tells an operator: that it is still at work, at
what, and for how long.
"""

import contextlib
import threading
from collections.abc import Generator

from numba.core.event import install_recorder
from rich.progress import Progress, TextColumn, TimeElapsedColumn

from flflab.cli.terminal import Terminal

SILENCE_S = 2.0
WORDS = "still at work"
# with the time before it, 80 columns hold it
COMPILING = "still at work: compiling, as before each first picture of a kind"


@contextlib.contextmanager
def told_at_work() -> Generator[None]:
    """Says on a terminal, once it has lasted two seconds, that it goes on, and for how long;
    elsewhere standard error is for errors.
    """
    ended = threading.Event()
    console = Terminal(stderr=True)
    if not console.is_terminal:
        yield
        return
    columns = TimeElapsedColumn(), TextColumn("{task.description}", markup=False)
    recorder = install_recorder("numba:compile")
    with (
        recorder as compiled,
        Progress(*columns, console=console, transient=True, auto_refresh=False) as shown,
    ):
        task = shown.add_task(WORDS, visible=False)

        def tell() -> None:
            if ended.wait(SILENCE_S):
                return
            while not ended.wait(1.0):
                begun = sum(1 if one.is_start else -1 for _, one in list(compiled.buffer))
                shown.update(
                    task, description=COMPILING if begun else WORDS, visible=True, refresh=True
                )

        teller = threading.Thread(target=tell, name="at work")
        teller.start()
        try:
            yield
        finally:
            ended.set()
            teller.join()

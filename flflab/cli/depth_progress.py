"""How far a depth map is, and how long it still takes, on a terminal."""

import contextlib
from collections.abc import Callable, Generator

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from flflab.cli.terminal import Terminal

# share of the whole time at which a step begins and ends
STEPS = {"reading": (0.0, 0.02), "microlenses": (0.02, 0.1), "sweep": (0.1, 0.85)}
LAST = (0.85, 1.0)


@contextlib.contextmanager
def depth_progress(before: str = "") -> Generator[Callable[[str, float], None]]:
    """A bar with the time left; nothing where standard error is no terminal.

    Args:
        before: what stands before the step's name.
    """
    console = Terminal(stderr=True)
    if not console.is_terminal:
        yield lambda step, share: None
        return
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task(before, total=1.0)

        def tell(step: str, share: float) -> None:
            begin, end = STEPS.get(step, LAST)
            shown.update(task, description=before + step, completed=begin + share * (end - begin))

        yield tell

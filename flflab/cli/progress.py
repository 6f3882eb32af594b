"""How far a command is, in one line of a terminal whose columns stay where they are."""

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

ROOMY = 72  # columns of a terminal that has room for a wide bar
COUNT, ELAPSED, LEFT = 9, 7, 16  # columns of ``12/53``, ``0:03:12`` and ``~3 h 20 min left``


class Count(ProgressColumn):
    """How many are done, of how many: ``12/53``."""

    def render(self, task: Task) -> Text:
        """Nothing of how many as long as that is not known."""
        return Text("" if task.total is None else f"{task.completed:.0f}/{task.total:.0f}")


def counted_progress(console: Console, *, disable: bool = False) -> Progress:
    """A bar, a count, the time it has taken and still takes (the field ``left``), and what is done
    (the description), cut to the terminal's width.
    """
    return Progress(
        BarColumn(bar_width=20 if console.width >= ROOMY else 6),
        Count(Column(width=COUNT, justify="right", no_wrap=True)),
        TimeElapsedColumn(Column(width=ELAPSED, no_wrap=True)),
        TextColumn(
            "{task.fields[left]}", markup=False, table_column=Column(width=LEFT, no_wrap=True)
        ),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"),
        ),
        console=console,
        transient=True,
        expand=True,
        disable=disable,
    )

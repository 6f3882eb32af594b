"""What commands print on: words of devices and files are shown as they are, never obeyed."""

from typing import Any

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from flflab.printable import printable

WIDEST = 10_000  # columns: wider than any table


class Terminal(Console):
    """A console of rich to which brackets are brackets, and an escape sequence is its letters.

    Args:
        stderr: whether it is standard error.
        piped: columns of a line where no terminal folds it; rich's 80 without it.
        soft_wrap: whether lines are left to the terminal to fold.
    """

    def __init__(
        self, *, stderr: bool = False, piped: int | None = None, soft_wrap: bool = False
    ) -> None:
        width = None if piped is None or Console(stderr=stderr).is_terminal else piped
        super().__init__(stderr=stderr, width=width, soft_wrap=soft_wrap, markup=False, emoji=False)

    def print_table(self, table: Table) -> None:
        """Print a table whose numbers stay whole: without its margins where the terminal is
        narrower than it, and as its rows one below the other where that is not enough.
        """
        if self._holds(table):
            self.print(table)
            return
        table.pad_edge, table.padding, table.show_edge = False, (0, 1, 0, 0), False
        if self._holds(table):
            self.print(table)
            return
        if table.title:
            self.print(table.title, style="italic", highlight=False)
        heads = [
            " ".join(str(column.header).replace("-\n", "").split()) for column in table.columns
        ]
        for cells in zip(*(column.cells for column in table.columns), strict=True):
            row = Table.grid(padding=(0, 2, 0, 0))
            for _ in range(2):
                row.add_column(overflow="fold")
            for head, cell in zip(heads, cells, strict=True):
                if head:
                    row.add_row(head, cell)
                else:  # what the row is about
                    self.print(cell, style="bold", highlight=False)
            self.print(row, "")

    def _holds(self, table: Table) -> bool:
        boundless = self.options.update(max_width=WIDEST)
        return Measurement.get(self, boundless, table).maximum <= self.width

    def render_str(self, text: str, **how: Any) -> Text:
        """A string as what is shown of it."""
        return super().render_str(printable(text), **how)

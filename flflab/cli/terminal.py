"""What commands print on: words of devices and files are shown as they are, never obeyed."""

from typing import Any

from rich.console import Console
from rich.text import Text

from flflab.printable import printable


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

    def render_str(self, text: str, **how: Any) -> Text:
        """A string as what is shown of it."""
        return super().render_str(printable(text), **how)

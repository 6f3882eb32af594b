"""What a child process that this one forks must not keep open: the sentinel would not see its owner
die, nor the next program find the lines and their locks free.
"""

import contextlib
import os
import weakref
from typing import Protocol


class Closable(Protocol):
    """Something that holds files open; to close them says nothing over them."""

    def close(self) -> object:
        """Close them."""
        ...


# one for the process, as what it is given to is: a fork copies every open file
_KEPT_FROM_CHILDREN: "weakref.WeakSet[Closable]" = weakref.WeakSet()


def close_in_children(held: Closable) -> None:
    """Have it closed in every child that this process forks, as long as it exists here."""
    _KEPT_FROM_CHILDREN.add(held)


def _close_all() -> None:
    for held in list(_KEPT_FROM_CHILDREN):
        with contextlib.suppress(Exception):  # a child has nobody to tell
            held.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_all)

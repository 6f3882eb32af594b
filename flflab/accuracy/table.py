"""Rows of figures as a file."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from flflab.whole_file import write_csv


def write_table(rows: Sequence[Any], file: Path, also: tuple[str, ...] = ()) -> None:
    """Write rows as CSV.

    Args:
        rows: at least one, all of one dataclass: a column a field.
        file: is overwritten.
        also: further attributes to write, by name.
    """
    names = [*(field.name for field in fields(rows[0])), *also]
    write_csv(file, [names, *([getattr(row, name) for name in names] for row in rows)])

"""Rows of figures as a file."""

import csv
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any


def write_table(rows: Sequence[Any], file: Path, also: tuple[str, ...] = ()) -> None:
    """Write rows as CSV.

    Args:
        rows: at least one, all of one dataclass: a column a field.
        file: is overwritten.
        also: further attributes to write, by name.
    """
    names = [*(field.name for field in fields(rows[0])), *also]
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(names)
        writer.writerows([getattr(row, name) for name in names] for row in rows)

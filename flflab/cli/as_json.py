"""What commands print for programs: one JSON object on standard output."""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

import typer

AsJson = Annotated[
    bool, typer.Option("--json", help="one JSON object on standard output instead of tables")
]


def print_json(result: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; nan and infinity have no place in it."""
    print(
        json.dumps(result, allow_nan=False)
    )  # a standard output that was closed beforehand takes nothing and says nothing


def plain(value: Any) -> Any:
    """A result as JSON holds it: dataclasses as objects, paths as text, null for what is not
    finite.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {
            str(key): plain(inner) for key, inner in cast(Mapping[object, object], value).items()
        }
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(inner) for inner in cast(Sequence[object], value)]
    if isinstance(value, float):  # numpy's, too
        return float(value) if math.isfinite(value) else None
    return value

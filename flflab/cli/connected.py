"""What the commands of ``flflab bench`` have in common: the bench connected, an axis by its name, where it stands."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flflab.errors import InputError

if TYPE_CHECKING:
    from drivers.base import Axis
    from drivers.bench import ConnectedBench

BenchFile = Annotated[Path, typer.Option("--bench", help="bench file (YAML)")]
AxisName = Annotated[str, typer.Argument(help="name of an axis in the bench file")]


@contextmanager
def connected_bench(bench: Path) -> Generator["ConnectedBench", None, None]:
    """The bench connected; Ctrl-C and any fault stop every axis before it is let go."""
    from drivers.bench import connect  # devices are loaded by those who use them

    with connect(bench) as connected:
        yield connected


def axis_named(bench: "ConnectedBench", name: str) -> "Axis":
    """One axis.

    Raises:
        InputError: there is none of that name.
    """
    try:
        return bench.axes[name]
    except KeyError:
        raise InputError(f"there is no axis {name} on this bench; its axes are {', '.join(bench.axes)}") from None


def place(axis: "Axis") -> str:
    """Where an axis is, as a sentence."""
    return f"{axis.name} is at {axis.coordinate.show(axis.position(), '.4f')}"

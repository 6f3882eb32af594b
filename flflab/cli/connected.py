"""What the commands of ``flflab bench`` have in common: the bench connected, an axis by its name,
where it stands.
"""

import re
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from flflab.errors import InputError

if TYPE_CHECKING:
    from drivers.base import Axis
    from drivers.bench import ConnectedBench

BenchFile = Annotated[Path, typer.Option("--bench", help="bench file (YAML)")]
AxisName = Annotated[str, typer.Argument(help="name of an axis in the bench file")]


class TakesReadings(TyperCommand):
    """A command that takes ``-1 mm`` for the reading it is: what begins with a minus and a digit is
    no option's name.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """A space before a reading keeps it from looking like an option; quantities may begin with
        one.
        """
        return super().parse_args(
            ctx, [f" {given}" if re.match(r"-\.?\d", given) else given for given in args]
        )


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
        raise InputError(
            f"there is no axis {name} on this bench; its axes are {', '.join(bench.axes)}"
        ) from None


def say_places(bench: "ConnectedBench", *names: str) -> None:
    """Say where axes are, and of axes that are simulated for this command alone that they forget
    it.
    """
    for name in names:
        axis = bench.axes[name]
        typer.echo(f"{name} is at {axis.coordinate.show(axis.position(), '.4f')}")
    if any(bench.described.description.axes[name].address == "simulated" for name in names):
        typer.echo(
            "this bench was simulated for this command alone and forgets it; `flflab sim"
            f" {bench.described.file} --write-bench served.yaml` serves one that stays, for --bench"
            " served.yaml",
            err=True,
        )

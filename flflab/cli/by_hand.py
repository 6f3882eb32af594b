"""``flflab bench set`` and ``go``: turn the iris, show a target, go to places of the world."""

import re
from typing import Annotated

import typer

from flflab.cli.connected import BenchFile, connected_bench
from flflab.errors import InputError


def set_(
    what: Annotated[str, typer.Argument(metavar="iris|target", help="what to change")],
    value: Annotated[str, typer.Argument(help="f-number as 'f/4' or '4', or a target's kind")],
    bench: BenchFile,
) -> None:
    """Turn the iris to an f-number, or show a target, and wait until it is there."""
    if what not in ("iris", "target"):
        raise InputError(
            f"there is no {what} to set; give iris or target, axes go by `go` or `move`"
        )
    with connected_bench(bench) as connected:
        if what == "iris":
            connected.iris.set(_f_number(value)).wait()
            typer.echo(f"iris is at f/{connected.iris.value():g}")
        else:
            connected.target.set(value).wait()
            typer.echo(f"target is {connected.target.value()}")


def go(
    places: Annotated[
        list[str],
        typer.Argument(
            metavar="WHAT PLACE...",
            help="what to move and where to in the world: sensor.z '61.15 mm', array.roll '1 deg'",
        ),
    ],
    bench: BenchFile,
) -> None:
    """Go to places of the world and wait until all are there; several in an order in which their
    gaps hold.
    """
    from flflab.bench import ANGLE, LENGTH  # help waits for none of it
    from procedures.by_hand import go as go_to
    from procedures.by_hand import moved_by_name, where

    if len(places) % 2:
        raise InputError(f"{places[-1]}: a place is due after each name: sensor.z '61.15 mm'")
    wanted = dict(zip(places[::2], places[1::2], strict=True))
    with connected_bench(bench) as connected:
        go_to(connected, wanted)
        moved = [moved_by_name(name) for name in wanted]
        for name, at in where(connected).items():
            if name in moved and at is not None:
                show = (LENGTH if name.endswith(".z") else ANGLE).show
                typer.echo(f"{name} is at {show(at, '.4f')}")


def _f_number(given: str) -> float:
    """An f-number.

    Raises:
        InputError: it is none.
    """
    found = re.fullmatch(r"\s*(?:[fF]/)?(\d+\.?\d*|\.\d+)\s*", given)
    if found is None:
        raise InputError(f"iris {given!r}: an f-number is due, as f/4 or 5.6")
    return float(found[1])

"""``flflab bench ...``: look at a bench and move it by hand."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from flflab.cli.as_json import AsJson, print_json
from flflab.cli.by_hand import go, set_
from flflab.cli.connected import (
    AxisName,
    BenchFile,
    TakesReadings,
    axis_named,
    connected_bench,
    say_places,
)
from flflab.cli.looking import scan, snap
from flflab.cli.saying import say
from flflab.cli.trial import try_out
from flflab.errors import CommunicationError, DeviceError, InputError
from flflab.units import parse_quantity

if TYPE_CHECKING:
    from rich.table import Table

    from drivers.survey import Identity
    from flflab.bench import Bench

ELSEWHERE = (
    "axes behind a network: no lock keeps programs on other computers from them; approaches look"
    " at their neighbours again on the way, homing and tilting cannot"
)
PIPED = 400  # columns that any line may take where no terminal folds it

app = typer.Typer(
    help=(
        "Look at a bench and move it by hand; every command refuses what is out of limits or brings"
        " array and sensor too near."
    ),
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.command(short_help="Ask every device who it is, where it stands, what it warns of.")
def check(
    bench: BenchFile,
    pin: Annotated[
        bool,
        typer.Option(
            "--pin",
            help="jog each axis, ask whether the right one moved, write the serial numbers",
        ),
    ] = False,
    replace: Annotated[
        bool, typer.Option("--replace", help="with --pin: over other numbers, too")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Ask every device, all lines at once, who it is, where it stands and what it warns of; all
    faults in one run. With --pin each axis is moved by 1 mm or 1 degree and back, and the bench
    file keeps the serial numbers that a person confirmed.
    """
    from drivers.described import one_instrument
    from drivers.survey import SILENT, survey
    from flflab.cli.described import described_bench
    from flflab.missing_light import missing_light  # numpy, which a stop does not need

    if pin and as_json:
        raise InputError("bench check: --pin asks a person, --json answers a program; give one")
    described = described_bench(bench)
    if pin:
        from flflab.cli.pin import pin as pin_serials

        pin_serials(bench, described, replace=replace)
        return
    if warning := missing_light(described):
        say(f"flflab: {warning}")
    rows = survey(described)
    if as_json:
        devices = [_device_of(row, described) for row in rows]
        print_json({"devices": devices, "warning": warning})
    else:
        _print_devices(rows, described)
    if any(not row.address.startswith(("/", "COM", "sim")) for row in rows if row.position):
        typer.echo(ELSEWHERE, err=True)
    if twice := one_instrument({row.name: (row.driver, row.serial) for row in rows}):
        raise DeviceError("\n".join(twice))
    if silent := [row.state for row in rows if row.identity == SILENT]:
        raise CommunicationError("\n".join(dict.fromkeys(silent)))


@app.command(short_help="Say where every axis and its element stand.")
def where(bench: BenchFile, as_json: AsJson = False) -> None:
    """Say where every axis stands between its limits, where its element is in the world, and how
    the array is turned.
    """
    from drivers.answers import ask_where, standing_of
    from flflab.cli.described import described_bench

    described = described_bench(bench)
    if (driven := ask_where(bench)) is not None:
        _say_places(described, driven, as_json, driven=True)
        typer.echo(f"as the program that drives this bench says: {_doing(driven)}", err=True)
        return
    with connected_bench(bench) as connected:
        _say_places(described, standing_of(connected), as_json, driven=False)


@app.command(short_help="Say whether a program drives the bench, and what it does.")
def status(bench: BenchFile) -> None:
    """Say whether a program of yours drives the bench, what it does, and which axes move; it goes
    on undisturbed.
    """
    from drivers.answers import ask_where

    driven = ask_where(bench)
    if driven is None:
        typer.echo("No program of yours drives this bench.")
        return
    typer.echo(f"A program drives this bench: {_doing(driven)}.")
    moving = [name for name, axis in driven["axes"].items() if axis["moving"]]
    typer.echo(f"Moving: {', '.join(moving)}." if moving else "Nothing moves.")


def _doing(driven: dict[str, Any]) -> str:
    return driven["doing"] or "no procedure's step"


def _device_of(row: "Identity", described: "Bench") -> dict[str, Any]:
    """What one device answered, for a program."""
    from drivers.survey import SILENT

    axis = described.description.axes.get(row.name)
    return row._asdict() | {
        "answers": row.identity != SILENT,
        "unit": None if axis is None else axis.coordinate.unit,
    }


def _print_devices(rows: "list[Identity]", described: "Bench") -> None:
    """What every device answered, one line each."""
    from drivers.survey import SILENT

    table = _table("device", "position", "identity", "state")
    for row in rows:
        axis = described.description.axes.get(row.name)
        answers = row.identity != SILENT
        position = ""
        if axis is not None and answers:
            show = axis.coordinate.show
            position = "not homed" if row.position is None else show(row.position, ".4f")
        table.add_row(row.name, position, row.identity, row.state if answers else "")
    _print(table)


def _say_places(described: "Bench", stands: dict[str, Any], as_json: bool, *, driven: bool) -> None:
    """Where everything stands, for people or as JSON."""
    if not as_json:
        _print_places(described, stands)
        return
    axes = {
        name: stands["axes"][name]
        | {
            "unit": axis.coordinate.unit,
            "limits": list(axis.limits),
            "moves": axis.moves,
            "world": None if (reading := stands["axes"][name]["reading"]) is None
            else axis.world(reading),
        }
        for name, axis in described.description.axes.items()
    }  # fmt: skip
    print_json(stands | {"axes": axes, "driven_by_a_program": driven})


def _print_places(described: "Bench", stands: dict[str, Any]) -> None:
    """Where every axis stands, between which limits, and where its element is in the world."""
    from flflab.cli.terminal import Terminal

    table = _table("axis", "reading", "limits", "moves", "in the world")
    for name, axis in described.description.axes.items():
        show, reading = axis.coordinate.show, stands["axes"][name]["reading"]
        table.add_row(
            name,
            "not homed" if reading is None else show(reading, ".4f"),
            f"{show(axis.limits[0], 'g')} to {show(axis.limits[1], 'g')}",
            axis.moves,
            "unknown" if reading is None else show(axis.world(reading), ".4f"),
        )
    Terminal(piped=PIPED).print_table(table)


@app.command(short_help="Look for the reference of every axis, or of the ones named.")
def home(
    bench: BenchFile,
    axes: Annotated[
        list[str] | None, typer.Argument(help="axes to home; all when none is named")
    ] = None,
) -> None:
    """Look for the reference of every axis, or of the ones named: array and sensor first, away from
    each other.
    """
    with connected_bench(bench) as connected:
        connected.home(*axes or ())
        say_places(connected, *axes or connected.axes)


@app.command(cls=TakesReadings)
def move(
    axis: AxisName,
    position: Annotated[str, typer.Argument(help="reading with its unit: '12.5 mm', '1.5 deg'")],
    bench: BenchFile,
) -> None:
    """Move an axis to a reading and wait until it is there."""
    with connected_bench(bench) as connected:
        moved = axis_named(connected, axis)
        moved.move_to(parse_quantity(position, moved.coordinate.dimension)).wait()
        say_places(connected, axis)


@app.command(cls=TakesReadings)
def jog(
    axis: AxisName,
    distance: Annotated[str, typer.Argument(help="with its unit: '100 um', '-0.5 mm', '0.1 deg'")],
    bench: BenchFile,
) -> None:
    """Move an axis by a distance and wait until it is there."""
    with connected_bench(bench) as connected:
        moved = axis_named(connected, axis)
        moved.move_by(parse_quantity(distance, moved.coordinate.dimension)).wait()
        say_places(connected, axis)


@app.command(short_help="Stop every axis.")
def stop(bench: BenchFile) -> None:
    """Stop every axis and wait until each reads at rest: the program that drives the bench is asked
    to, and the lines are opened past it at the same time. It moves nothing any more.
    """
    from drivers.stopping import stop_bench

    try:
        stopped = stop_bench(bench)
    except InputError as unreadable:
        raise InputError(
            f"{unreadable}\nno axis was stopped: no running program began with {bench}, and what is"
            " in it does not say how to reach the stages; stop them by hand, by the emergency stop"
            " or by their power, then correct the file"
        ) from unreadable
    if stopped.faults:
        raise DeviceError("\n".join(stopped.faults))
    for remark in stopped.remarks:
        typer.echo(remark, err=True)
    typer.echo("All axes stopped.")


app.command("test", short_help="Put the whole bench through what every bench promises.")(try_out)
app.command(short_help="Take one picture, or one after the other with a figure of focus.")(snap)
app.command(
    short_help="Take a picture at each reading of an axis; show the sharpest.", cls=TakesReadings
)(scan)


app.command("set", short_help="Turn the iris, or show a target.")(set_)
app.command(short_help="Go to places of the world.", cls=TakesReadings)(go)


def _table(*headings: str) -> "Table":
    """A table that 80 columns hold: what a device says of itself goes over as many lines as it
    takes, nothing is cut.
    """
    from rich import box  # a stop waits for nothing that only tables need
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in headings:
        number = heading in ("position", "reading", "in the world")
        table.add_column(
            heading,
            justify="right" if number else "left",
            no_wrap=heading not in ("identity", "state"),
            overflow="fold",
        )
    return table


def _print(table: "Table") -> None:
    from flflab.cli.terminal import Terminal

    Terminal(piped=PIPED).print(table)

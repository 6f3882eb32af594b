"""``flflab bench ...``: look at a bench and move it by hand."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import cv2
import typer
from rich import box
from rich.console import Console
from rich.table import Table

from flflab.bench import LENGTH, read_bench
from flflab.errors import CommunicationError, InputError, RecordError
from flflab.units import parse_quantity

if TYPE_CHECKING:
    from drivers.base import Axis
    from drivers.bench import ConnectedBench

app = typer.Typer(
    help="Look at a bench and move it by hand; every command refuses what is out of limits or brings array and sensor too near.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)
BenchFile = Annotated[Path, typer.Option("--bench", help="bench file (YAML)")]
AxisName = Annotated[str, typer.Argument(help="name of an axis in the bench file")]


@app.command()
def check(bench: BenchFile) -> None:
    """Ask every device, all lines at once, who it is, where it stands and what it warns of; all faults in one run."""
    from drivers.survey import SILENT, survey

    described = read_bench(bench)
    rows = survey(described)
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("device", "driver", "address", "identity", "position", "limits", "state"):
        table.add_column(heading, justify="right" if heading == "position" else "left")
    for row in rows:
        axis = described.description.axes.get(row.name)
        show = LENGTH.show if axis is None else axis.coordinate.show
        answers = row.identity != SILENT
        position = "" if axis is None or not answers else "not homed" if row.position is None else show(row.position, ".4f")
        limits = "" if axis is None else f"{show(axis.limits[0], 'g')} to {show(axis.limits[1], 'g')}"
        table.add_row(row.name, row.driver, row.address, row.identity, position, limits, row.state if answers else "")
    _print(table)
    if silent := [row.state for row in rows if row.identity == SILENT]:
        raise CommunicationError("\n".join(dict.fromkeys(silent)))


@app.command()
def where(bench: BenchFile) -> None:
    """Say where every axis stands, where its element is in the world, and how the array is turned."""
    with _connected(bench) as connected:
        table = Table(box=box.SIMPLE_HEAD)
        for heading in ("axis", "reading", "moves", "in the world"):
            table.add_column(heading, justify="left" if heading in ("axis", "moves") else "right")
        for name, axis in connected.axes.items():
            element = connected.described.description.axes[name].moves
            homed = axis.is_homed()
            show = axis.coordinate.show
            reading, world = (show(axis.position(), ".4f"), show(connected.world(element), ".4f")) if homed else ("not homed", "unknown")
            table.add_row(name, reading, element, world)
        _print(table)


@app.command()
def home(bench: BenchFile, axes: Annotated[list[str] | None, typer.Argument(help="axes to home; all when none is named")] = None) -> None:
    """Look for the reference of every axis, or of the ones named: array and sensor first, away from each other."""
    from drivers.base import wait_all  # devices are loaded by those who use them
    from procedures.steps import home_steps

    with _connected(bench) as connected:
        named = [_axis(connected, name).name for name in axes or connected.axes]
        for step in home_steps(connected.described):
            wait_all(*[connected.axes[name].home() for name in step.axes if name in named])
        for name in named:
            typer.echo(_place(connected.axes[name]))


@app.command()
def move(
    axis: AxisName, position: Annotated[str, typer.Argument(help="reading with its unit: '12.5 mm', '1.5 deg'")], bench: BenchFile
) -> None:
    """Move an axis to a reading and wait until it is there."""
    with _connected(bench) as connected:
        moved = _axis(connected, axis)
        moved.move_to(parse_quantity(position, moved.coordinate.dimension)).wait()
        typer.echo(_place(moved))


@app.command()
def jog(
    axis: AxisName,
    distance: Annotated[str, typer.Argument(help="with its unit: '100 um', '0.1 deg'; after --: '-0.5 mm'")],
    bench: BenchFile,
) -> None:
    """Move an axis by a distance and wait until it is there."""
    with _connected(bench) as connected:
        moved = _axis(connected, axis)
        moved.move_by(parse_quantity(distance, moved.coordinate.dimension)).wait()
        typer.echo(_place(moved))


@app.command()
def stop(bench: BenchFile) -> None:
    """Stop every axis: the program that drives the bench is told to, or this one opens the ports itself."""
    from drivers.owner import ask_owner_to_stop

    if not ask_owner_to_stop(bench):
        with _connected(bench) as connected:
            connected.stop()
    typer.echo("every axis took the stop")


@app.command()
def snap(
    bench: BenchFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="picture to write: .png or .tiff, 16 bits")],
    exposure: Annotated[str, typer.Option(help="exposure time with its unit")] = "10 ms",
) -> None:
    """Take one picture of whatever stands before the camera."""
    seconds = parse_quantity(exposure, "time")
    if output.suffix.lower() not in (".png", ".tiff", ".tif"):
        raise InputError(f"{output}: a picture is written as .png or .tiff; give such a name")
    with _connected(bench) as connected:
        connected.camera.prepare(seconds, 1.0)
        frame = connected.camera.grab()
        saturated = int((frame.picture >= connected.camera.full_scale).sum())
    written, data = cv2.imencode(output.suffix, frame.picture)
    try:
        output.write_bytes(data.tobytes() if written else b"")
    except OSError as error:
        raise RecordError(f"{output}: cannot be written ({error}); give a file in a folder that exists") from error
    typer.echo(f"{output}: {frame.picture.shape[1]} x {frame.picture.shape[0]} pixels, {frame.exposure_s:g} s, {saturated} saturated")


@contextmanager
def _connected(bench: Path) -> Generator["ConnectedBench", None, None]:
    """The bench connected; Ctrl-C and any fault stop every axis before it is let go."""
    from drivers.bench import connect

    with connect(bench) as connected:
        yield connected


def _place(axis: "Axis") -> str:
    return f"{axis.name} is at {axis.coordinate.show(axis.position(), '.4f')}"


def _axis(bench: "ConnectedBench", name: str) -> "Axis":
    try:
        return bench.axes[name]
    except KeyError:
        raise InputError(f"there is no axis {name} on this bench; its axes are {', '.join(bench.axes)}") from None


def _print(table: Table) -> None:
    Console(width=None if Console().is_terminal else 160).print(table)

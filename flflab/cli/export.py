"""``flflab export RUN --nexus [FILE]``: a run as one file for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from flflab.errors import InputError
from flflab.record import export_nexus, read_run


def export(
    run: Annotated[Path, typer.Argument(help="folder of a run")],
    nexus: Annotated[bool, typer.Option("--nexus", help="a NeXus file: frames, readings, curves and provenance")] = False,
    file: Annotated[Path | None, typer.Argument(help="the file to write; RUN/NAME.nxs without one")] = None,
) -> None:
    """Write a recorded run as one file that other programs open, such as silx view or h5web."""
    if not nexus:
        raise InputError("export: in which format? there is --nexus")
    place = file or run / f"{run.resolve().name}.nxs"
    export_nexus(read_run(run), place)
    typer.echo(f"{place}")

"""``flflab export RUN --nexus [FILE]``: a run as one file for other programs; ``--pack`` makes its
own frames smaller.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.errors import InputError


def export(
    run: Annotated[Path, typer.Argument(help="folder of a run")],
    nexus: Annotated[
        bool, typer.Option("--nexus", help="a NeXus file: frames, readings, curves and provenance")
    ] = False,
    pack: Annotated[
        bool,
        typer.Option(
            "--pack", help="compress the run's own frames, two to five times smaller, in place"
        ),
    ] = False,
    file: Annotated[
        Path | None, typer.Argument(help="the file to write; RUN/NAME.nxs without one")
    ] = None,
) -> None:
    """Write a recorded run as one file that other programs open, such as silx view or h5web."""
    from flflab.record import export_nexus, read_run  # help waits for none of it
    from flflab.record import pack as pack_frames

    if not (nexus or pack):
        raise InputError("export: give --nexus or --pack")
    recorded = read_run(run)
    if pack and not recorded.complete:
        raise InputError(
            f"{run}: not taken to its end, so its frames are not packed yet; `flflab resume {run}`"
            " continues it"
        )
    if pack:
        pack_frames(recorded)
    if nexus:
        place = file or run / f"{run.resolve().name}.nxs"
        export_nexus(recorded, place)
        typer.echo(f"{place}")

"""``flflab sweep``: take every frame of a study on a bench; nothing is compared."""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import Kind, built_in
from flflab.cli.run import progress_shown, run_study
from flflab.cli.terminal import Terminal
from flflab.record import Run


def sweep(
    study: Annotated[Path, typer.Argument(help="study file (YAML)")],
    bench: Annotated[
        Path | None,
        typer.Option(help="bench file (YAML); the built-in simulated bench without one"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="folder of the run, new or empty; runs/<UTC>-<study> without one"),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="of the simulated bench, instead of its file's")
    ] = None,
) -> None:
    """Home and take every frame of a study; an interrupted run is gone on with by resume."""
    with progress_shown() as tell:
        run = run_study(study, bench or built_in(Kind.BENCH), out, seed, tell, "sweep")
    tell_of(run)


def tell_of(run: Run) -> None:
    """Say what a run holds, and which points are less sure than was asked for."""
    console = Terminal()
    configurations = {
        frame.configuration for frame in run.frames if frame.configuration is not None
    }
    console.print(
        f"{len(run.frames)} frames of {len(configurations)} configurations in {run.folder}; `flflab"
        f" report {run.folder}` compares them with the model.",
        highlight=False,
        soft_wrap=True,
    )
    last = {one.configuration: one for one in run.accuracy}
    for one in last.values():
        if not one.enough:
            console.print(
                f"configuration {one.configuration}: {one.frames} frames, the most allowed, leave"
                f" the MTF uncertain by {one.mtf_standard_uncertainty:.2g}, more than asked for",
                highlight=False,
                soft_wrap=True,
            )

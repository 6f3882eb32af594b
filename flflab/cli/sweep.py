"""``flflab sweep``: take every frame of a study on a bench; nothing is compared."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flflab.built_in import simulated_bench
from flflab.cli.as_json import AsJson, plain, print_json
from flflab.digits import two_digits

if TYPE_CHECKING:
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
    as_json: AsJson = False,
) -> None:
    """Home and take every frame of a study; continue an interrupted run with `flflab resume`."""
    from flflab.cli.run import progress_shown, run_study  # help waits for none of it

    with progress_shown() as tell:
        run = run_study(study, bench or simulated_bench(), out, seed, tell, "sweep")
    if as_json:
        print_json(numbers_of(run))
    else:
        tell_of(run)


def numbers_of(run: "Run") -> dict[str, Any]:
    """What a run holds, for a program."""
    last = {one.configuration: one for one in run.accuracy}
    return {
        "run": str(run.folder.resolve()),
        "study": run.start.get("study"),
        "complete": run.complete,
        "frames": len(run.frames),
        "configurations": len({frame.configuration for frame in run.frames} - {None}),
        "accuracy": [plain(one) for one in last.values()],
    }


def tell_of(run: "Run") -> None:
    """Say what a run holds, and which points are less certain than requested."""
    from flflab.cli.terminal import Terminal

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
                f" an MTF uncertainty of {two_digits(one.mtf_standard_uncertainty)}, more than"
                " requested",
                highlight=False,
                soft_wrap=True,
            )

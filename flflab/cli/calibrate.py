"""``flflab calibrate``: where the stages' zeros and the optics really are, by white and dot
pictures at several settings.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import Kind, built_in, simulated_bench
from flflab.cli.as_json import AsJson


def calibrate(
    study: Annotated[
        Path | None, typer.Argument(help="study file (YAML); the built-in calibration without one")
    ] = None,
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
    """Find zeros and scales of the stages, focal lengths, apertures and centre, and say what the
    pictures do not determine.
    """
    from flflab.cli.calibrated import conclude  # help waits for none of it
    from flflab.cli.run import progress_shown, run_study

    with progress_shown() as tell:
        run = run_study(
            study or built_in(Kind.CALIBRATION),
            bench or simulated_bench(),
            out,
            seed,
            tell,
            "calibrate",
        )
    conclude(run, as_json)

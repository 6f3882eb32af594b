"""``flflab validate``: the main job. Home, sweep, capture, measure, compare with the model,
report.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import Kind, built_in, simulated_bench


def validate(
    study: Annotated[
        Path | None, typer.Argument(help="study file (YAML); the built-in first study without one")
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
    as_json: Annotated[
        bool, typer.Option("--json", help="print verdict.json instead of tables")
    ] = False,
    junit: Annotated[
        Path | None, typer.Option(help="write the verdicts as JUnit XML too, for CI")
    ] = None,
) -> None:
    """Run a study on a bench and say whether the camera does what its model says (exit 0), or not
    (exit 3).
    """
    from flflab.cli.run import progress_shown, run_study  # help waits for none of it
    from flflab.cli.verdict import conclude
    from flflab.whole_file import require_own_writable

    if junit is not None:
        require_own_writable(junit)  # before hours on the bench
    with progress_shown() as tell:
        run = run_study(
            study or built_in(Kind.STUDY),
            bench or simulated_bench(),
            out,
            seed,
            tell,
            "validate",
        )
    conclude(run, as_json=as_json, junit=junit)

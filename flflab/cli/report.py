"""``flflab report RUN...``: measure and compare recorded runs again; many of them on all cores or
on a Dask cluster.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.errors import InputError


def report(
    runs: Annotated[list[Path], typer.Argument(help="folder of a run, or of several")],
    bench: Annotated[
        Path | None,
        typer.Option(help="judge one run by this bench file instead, into report-NAME.html"),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="address of a Dask scheduler whose workers share several runs"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="folder for table and page of one run; the run's own without it"),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="print one run's verdict.json instead of tables")
    ] = False,
    junit: Annotated[
        Path | None, typer.Option(help="write one run's verdicts as JUnit XML too, for CI")
    ] = None,
) -> None:
    """Measure and compare recorded runs again and rewrite their tables and reports."""
    from flflab.cli.many_runs import report_runs  # help waits for none of it
    from flflab.cli.verdict import REJECTED, conclude
    from flflab.record import read_run
    from flflab.whole_file import make_folder

    if len(runs) == 1 and scheduler is None:
        if out is not None:
            make_folder(out, f"--out {out}")
        conclude(read_run(runs[0]), bench, out, as_json, junit)
        return
    if bench is not None or out is not None or as_json or junit is not None:
        raise InputError(
            "report: --bench, --out, --json and --junit are for one run; give one run, without"
            " --scheduler"
        )
    if not report_runs(runs, scheduler):
        raise typer.Exit(REJECTED)

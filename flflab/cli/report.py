"""``flflab report RUN...``: measure and compare recorded runs again; many of them on all cores or
on a Dask cluster.
"""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich import box
from rich.progress import Progress
from rich.table import Table

from flflab.cli.ending import reader_may_go
from flflab.cli.terminal import Terminal
from flflab.cli.validate import REJECTED, conclude
from flflab.errors import FlflabError, InputError
from flflab.record import read_run
from flflab.whole_file import make_folder
from flflab.workers import results
from procedures.validate import judged


class Analysed(NamedTuple):
    """What became of a run: its place among those asked for, folder, sentences of its verdicts,
    whether the model was accepted.
    """

    number: int
    folder: Path
    sentences: tuple[str, ...]
    accepted: bool


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
    with Progress(transient=True, console=Terminal(stderr=True)) as progress:
        bar = progress.add_task("runs", total=len(runs))
        found: list[Analysed] = []
        for one in results(
            analyse, [(number, folder.resolve()) for number, folder in enumerate(runs)], scheduler
        ):
            found.append(one)
            progress.update(bar, advance=1)
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("run", overflow="fold")
    table.add_column("verdict", overflow="fold")
    for one in sorted(found):
        table.add_row(str(one.folder), "; ".join(one.sentences))
    with reader_may_go():
        Terminal(piped=140).print(table)
    if not all(one.accepted for one in found):
        raise typer.Exit(REJECTED)


def analyse(number: int, folder: Path) -> Analysed:
    """Evaluate a recorded run and write its table and page; a run that cannot be evaluated says why
    and counts as not accepted.
    """
    try:
        comparison = judged(read_run(folder))[0].comparison
    except FlflabError as error:
        return Analysed(number, folder, (str(error),), False)
    return Analysed(
        number,
        folder,
        tuple(verdict.sentence for verdict in comparison.verdicts),
        comparison.accepted,
    )

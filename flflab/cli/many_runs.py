"""Several recorded runs measured and compared again, on all cores or on a Dask cluster."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rich import box
from rich.progress import Progress
from rich.table import Table

from flflab.cli.ending import reader_may_go
from flflab.cli.terminal import Terminal
from flflab.errors import FlflabError
from flflab.record import read_run
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


def report_runs(runs: Sequence[Path], scheduler: str | None) -> bool:
    """Measure and compare runs again and print a line for each; whether all models are accepted."""
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
    return all(one.accepted for one in found)


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

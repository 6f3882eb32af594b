"""What a command does to take a study on a bench: connect, begin the record, home and sweep, say how far it is."""

import contextlib
import sys
import tempfile
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING

import typer
import yaml
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from flflab.bench import read_bench
from flflab.description import read_yaml
from flflab.errors import FlflabError
from flflab.record import Run, claim_folder, keep_descriptions, new_folder, read_run
from flflab.study import read_study

if TYPE_CHECKING:
    from procedures.sweep import Progress as Step
    from procedures.sweep import Tell


def run_study(study_file: Path, bench_file: Path, folder: Path | None, seed: int | None, tell: "Tell") -> Run:
    """Take every frame of a study on a bench and read the record back.

    Args:
        study_file: the study.
        bench_file: the bench.
        folder: the run's folder, which holds no run yet; None makes ``runs/<UTC>-<study>``.
        seed: instead of the bench file's ``simulated.seed``.
        tell: called when a step begins.

    Raises:
        typer.Exit: with code 130, interrupted by the operator, after one sentence.
        InputError: study or bench are wrong, or do not fit together.
        DeviceError: an instrument failed; every axis was told to stop and the record is intact.
        MeasurementError: no exposure fits.
        RecordError: the folder holds a run already, or cannot be written.
    """
    # The engine and the drivers are loaded here, so that commands without a bench start fast.
    from drivers.bench import connect
    from procedures.engine import RunInterruptedError
    from procedures.steps import steps
    from procedures.validate import begin_recording, validate

    with seeded(bench_file, seed) as file:
        bench = read_bench(file)
        study = read_study(study_file, bench.optics)
        steps(study, bench)  # refused here, before anything connects
        if folder is not None:
            claim_folder(folder)
        with connect(file) as connected:
            place = folder or new_folder(study.description.name)
            keep_descriptions(place, bench, study_file)
            failure: FlflabError | None = None
            try:
                validate(connected, study, begin_recording(connected, study, place), tell)
            except FlflabError as error:
                failure = error  # raised below: every axis was told to stop, and what goes wrong in leaving must not hide why
    if isinstance(failure, RunInterruptedError):
        sys.stderr.write(f"flflab: {failure}\n")
        raise typer.Exit(130)
    if failure is not None:
        raise failure
    return read_run(place)


@contextlib.contextmanager
def seeded(bench_file: Path, seed: int | None) -> Generator[Path, None, None]:
    """A bench file with another seed for its simulated errors and noise; the file itself where no seed is given.

    Raises:
        InputError: the bench file cannot be read.
    """
    if seed is None:
        yield bench_file
        return
    data, _ = read_yaml(bench_file)
    data["simulated"] = (data.get("simulated") or {}) | {"seed": seed}
    data["optics"] = str((bench_file.parent / str(data.get("optics", ""))).resolve())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / bench_file.name
        file.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True), encoding="utf-8")
        yield file


@contextlib.contextmanager
def progress_shown() -> Generator["Tell", None, None]:
    """Shows on standard error how far a procedure is: a bar on a terminal, one line a recorded point elsewhere."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("connect", total=None)

        def tell(step: "Step") -> None:
            left = f"about {step.seconds_left:.0f} s left" if step.done else ""
            now = step.step.partition(":")[0]
            bar.update(task, total=step.total, completed=step.done, description=f"{now}  [dim]{step.last}  {left}[/dim]")

        yield tell


def _lines() -> Callable[["Step"], None]:
    told: list[str] = []

    def tell(step: "Step") -> None:
        if step.last and told != [step.last]:
            told[:] = [step.last]
            sys.stderr.write(f"{step.done}/{step.total} {step.last}, about {step.seconds_left:.0f} s left\n")

    return tell

"""What a command does to take a study on a bench: connect, begin the record, home and sweep, say
how far it is.
"""

import contextlib
import math
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import typer

from flflab.bench import Bench, read_bench, seeded
from flflab.cli.described import described_bench
from flflab.cli.ending import INTERRUPTED
from flflab.cli.progress import counted_progress
from flflab.cli.saying import say
from flflab.cli.terminal import Terminal
from flflab.errors import CommunicationError, FlflabError, InputError
from flflab.missing_light import missing_light
from flflab.record import (
    ContinuedRecording,
    Recording,
    Run,
    read_run,
    run_folder,
)
from flflab.study import read_study
from flflab.wheel import unlike_the_wheel

if TYPE_CHECKING:
    from procedures.sweep import Progress as Step
    from procedures.sweep import Tell


def run_study(
    study_file: Path,
    bench_file: Path,
    folder: Path | None,
    seed: int | None,
    tell: "Tell",
    name: str,
) -> Run:
    """Take every frame of a study on a bench and read the record back.

    Args:
        study_file: the study.
        bench_file: the bench.
        folder: the run's folder, which holds no run yet; None makes ``runs/<UTC>-<study>``.
        seed: instead of the bench file's ``simulated.seed``.
        tell: called when a step begins.
        name: of the procedure: ``sweep`` or ``validate``.

    Raises:
        typer.Exit: with code 130, interrupted by the operator, after one sentence.
        InputError: study or bench are wrong, or do not fit together.
        DeviceError: an instrument failed; every axis was told to stop and the record is intact.
        MeasurementError: no exposure fits.
        RecordError: the folder holds a run already, or cannot be written.
    """
    # The engine and the drivers are loaded here, so that commands without a bench start fast.
    from drivers.bench import connect_described
    from procedures.descriptions import with_descriptions
    from procedures.steps import steps
    from procedures.study import begin_recording, take_study

    bench = seeded(described_bench(bench_file), seed)
    study = read_study(study_file, bench.optics)
    steps(study, bench)  # refused here, before anything connects
    for sentence in (*unlike_the_wheel(study, bench), missing_light(bench, study)):
        if sentence:
            say(f"flflab: {sentence}")
    with run_folder(folder, study.description.name) as place, connect_described(bench) as connected:
        recording = with_descriptions(
            begin_recording(connected, study, place), bench, study_file, study
        )
        say_remark(recording)
        failure = failure_of(place, lambda: take_study(connected, study, recording, tell, name))
    return ended(place, failure)


def resume_run(folder: Path, bench_file: Path | None, tell: "Tell") -> Run:
    """Go on with a run that was cut short and read the whole record back.

    Args:
        folder: the run's.
        bench_file: the same bench at other addresses; None takes the one recorded.
        tell: called when a step begins.

    Raises:
        InputError: there is nothing to go on with, or the bench is another one; and as
            ``run_study``.
    """
    from drivers.bench import connect
    from procedures.resume import require_unfinished, rest_of, resume

    run = read_run(folder)
    require_unfinished(run)
    recorded = read_bench(folder / "bench.yaml")
    file = recorded.file if bench_file is None else bench_file
    require_same_bench(recorded, described_bench(file))
    study = read_study(folder / "study.yaml", recorded.optics)
    rest = rest_of(run, study, recorded)
    try:
        connected = connect(file)
    except CommunicationError as error:
        if bench_file is not None:
            raise
        there = (
            f"the same bench at other addresses is given with `flflab resume {folder} --bench FILE`"
        )
        raise CommunicationError(f"{error}\n{there}") from error

    def go_on() -> None:
        recording = ContinuedRecording(folder)
        say_remark(recording)
        resume(connected, study, run, rest, recording, tell)

    if run.lost:
        say(f"flflab: {folder}: {run.loss}; what was lost is taken again")
    with connected:
        failure = failure_of(folder, go_on)
    return ended(folder, failure)


def say_remark(recording: Recording) -> None:
    """Say what the disk of a record cannot promise."""
    if recording.remark:
        say(f"flflab: {recording.remark}")


def require_same_bench(recorded: Bench, given: Bench) -> None:
    """Refuse to go on with another bench than the recorded one; addresses may have changed.

    Raises:
        InputError: a field differs; it is named.
    """
    before, now = (
        _without_addresses(bench.description.model_dump()) for bench in (recorded, given)
    )
    different = [
        field
        for field in before
        if before[field] != now.get(field) and field not in ("optics", "simulated")
    ]
    different += [] if recorded.optics == given.optics else ["optics"]
    if different:
        raise InputError(
            f"{given.file}: {' and '.join(different)} are not as in {recorded.file}, with which"
            " this run began; only addresses may differ"
        )


def _without_addresses(value: object) -> Any:
    if isinstance(value, dict):
        return {
            key: _without_addresses(inner)
            for key, inner in cast(dict[str, object], value).items()
            if key not in ("address", "driver")
        }
    return value


def failure_of(folder: Path, doing: Callable[[], None]) -> FlflabError | None:
    """What a run failed with, raised after the bench was left, so that what goes wrong in leaving
    does not hide why.

    How to go on is said at once: an operator may not wait for the bench to be left.
    """
    try:
        doing()
    except FlflabError as error:
        if (folder / "documents.jsonl").exists():
            sys.stderr.write(f"flflab: `flflab resume {folder}` continues this run\n")
        return error
    return None


def ended(folder: Path, failure: FlflabError | None) -> Run:
    """The record of a run that was taken to its end; else why it ended.

    Raises:
        typer.Exit: with code 130, interrupted by the operator.
        FlflabError: what it failed with.
    """
    from procedures.engine import RunInterruptedError

    if isinstance(failure, RunInterruptedError):
        say(f"flflab: {failure}")
        raise typer.Exit(INTERRUPTED)
    if failure is not None:
        raise failure
    return read_run(folder)


@contextlib.contextmanager
def measuring(run: Run, command: str) -> Generator[Callable[[int, int], None]]:
    """Says what it is at, of how many configurations as far as it is told; at Ctrl-C, with which
    command the run is measured again.
    """
    console = Terminal(stderr=True)
    console.print(
        f"{'all recorded' if run.complete else 'not recorded to its end'}; measuring and comparing",
        highlight=False,
    )
    if run.lost:
        sys.stderr.write(
            f"flflab: {run.loss}; what was lost is left out, `flflab resume {run.folder}` takes it"
            " again\n"
        )
    try:
        with counted_progress(console, disable=not console.is_terminal) as bar:
            task = bar.add_task("measure", total=None, left="")

            def tell(done: int, total: int) -> None:
                doing = "configurations measured" if done < total else "compare with the model"
                bar.update(task, total=total, completed=done, description=doing)

            yield tell
    except KeyboardInterrupt:
        sys.stderr.write(
            f"flflab: what was recorded is kept, `flflab {command} {run.folder}` measures it\n"
        )
        raise


@contextlib.contextmanager
def progress_shown() -> Generator["Tell", None, None]:
    """Shows on standard error how far a procedure is: a bar on a terminal, one line a recorded
    point elsewhere.
    """
    console = Terminal(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    with counted_progress(console) as bar:
        task = bar.add_task("connect", total=None, left="")
        shows = ""

        def tell(step: "Step") -> None:
            nonlocal shows
            now = step.step.partition(":")[0]
            bar.update(
                task,
                total=step.total,
                completed=step.done,
                description=f"{now}; {step.last}" if step.last else now,
                left=time_left(step.seconds_left) if step.last else "",
            )
            if step.shows and step.shows != shows:
                bar.console.print(step.shows, style="dim", highlight=False)
            shows = step.shows

        yield tell


def in_words(seconds: float) -> str:
    """A duration as people say it: ``40 s``, ``12 min``, ``3 h 20 min``."""
    minutes = round(seconds / 60)
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"


def time_left(seconds: float) -> str:
    """The time that is left, in the room that the progress has for it; nothing while nobody
    knows.
    """
    return f"~{in_words(seconds)} left" if math.isfinite(seconds) else ""


def _lines() -> Callable[["Step"], None]:
    last, shows = "", ""

    def tell(step: "Step") -> None:
        nonlocal last, shows
        if step.last and step.last != last:
            left = time_left(step.seconds_left)
            sys.stderr.write(f"{step.done}/{step.total}{f', {left}' * bool(left)}: {step.last}\n")
        if step.shows and step.shows != shows:
            sys.stderr.write(f"{step.shows}\n")
        last, shows = step.last, step.shows

    return tell

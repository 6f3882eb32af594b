"""Run a study on a bench and say whether the camera does what its model says."""

from dataclasses import dataclass
from pathlib import Path

from flflab.bench import read_bench, seeded
from flflab.built_in import Kind, built_in, simulated_bench
from flflab.errors import InputError
from flflab.record import Run, read_run, run_folder
from flflab.study import read_study
from flflab.verdict.budget import write_budgets
from flflab.verdict.comparison import write_rows
from flflab.verdict.evaluation import Evaluation, Tell, evaluate, tell_nobody
from flflab.whole_file import require_own_writable, write_own


@dataclass(frozen=True)
class Validation:
    """What a validation gave.

    Attributes:
        run: the record.
        evaluation: measured beside predicted, with the verdicts.
        page: the report, HTML.
    """

    run: Run
    evaluation: Evaluation
    page: Path

    @property
    def accepted(self) -> bool:
        """Whether the camera does what its model says."""
        return self.evaluation.comparison.accepted


def validate(
    study: str | Path | None = None,
    bench: str | Path | None = None,
    out: str | Path | None = None,
    seed: int | None = None,
) -> Validation:
    """Run a study on a bench, measure, compare with the model and write the report.

    Args:
        study: study file; the built-in first study without one.
        bench: bench file; the built-in simulated bench without one.
        out: folder of the run, new or empty; ``runs/<UTC>-<study>`` without one.
        seed: of the simulated bench, instead of its file's.

    Raises:
        InputError: study or bench are wrong, or do not fit together; nothing moved.
        LimitError: a step is not possible on this bench; nothing moved.
        DeviceError: an instrument failed; every axis was told to stop and the record is intact.
        MeasurementError: no exposure fits, or the frames do not show what they should.
        RecordError: the folder holds a run already, or cannot be written.
        RunInterruptedError: Ctrl-C; every axis stands, ``flflab resume`` goes on.
    """
    from drivers.bench import connect_described  # bluesky; who judges a record needs none
    from procedures.descriptions import with_descriptions
    from procedures.study import begin_recording, take_study, tell_nobody

    described = seeded(read_bench(Path(bench or simulated_bench())), seed)
    study_file = Path(study or built_in(Kind.STUDY))
    read = read_study(study_file, described.optics)
    with (
        run_folder(None if out is None else Path(out), read.description.name) as folder,
        connect_described(described) as connected,
    ):
        recording = with_descriptions(
            begin_recording(connected, read, folder), described, study_file, read
        )
        take_study(connected, read, recording, tell_nobody, "validate")
    run = read_run(folder)
    return Validation(run, *judged(run))


def judged(
    run: Run, bench_file: Path | None = None, tell: Tell = tell_nobody, out: Path | None = None
) -> tuple[Evaluation, Path]:
    """Evaluate a run and write its table and page.

    Args:
        run: the record.
        bench_file: the bench to hold it against, a calibrated one for instance; the recorded one
            without it.
        tell: called with how many configurations are measured, of how many.
        out: folder for table and page; the run's own without it.

    Returns:
        What was found, and the page.

    Raises:
        FlflabError: there is no study in it, a description is wrong, a frame is missing or cannot
            be measured.
    """
    from flflab.report import verdict_text, write_report  # draws; loaded by those who draw

    if not (run.folder / "study.yaml").exists():
        raise InputError(
            f"{run.folder}: a run of {run.start.get('plan_name', 'something else')} without a study"
            " has nothing to compare"
        )
    besides = f"-{bench_file.stem}" if bench_file else ""
    place = out or run.folder
    table, page = place / f"comparison{besides}.csv", place / f"report{besides}.html"
    numbers, budget = place / f"verdict{besides}.json", place / f"budget{besides}.csv"
    # before the pictures are measured, which takes its time
    for file in (table, page, numbers, budget):
        require_own_writable(file)
    bench = read_bench(bench_file or run.folder / "bench.yaml")
    study = read_study(run.folder / "study.yaml", read_bench(run.folder / "bench.yaml").optics)
    evaluation = evaluate(run, study, bench, tell=tell)
    write_rows(evaluation.comparison.rows, table)
    write_budgets(evaluation.budgets, budget)
    write_own(numbers, verdict_text(evaluation, run))
    write_report(evaluation, run, study, bench, page)
    return evaluation, page

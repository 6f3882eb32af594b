"""What a validation ends with: table, page, files, and the verdict on the terminal."""

from pathlib import Path

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from flflab.cli.ending import reader_may_go
from flflab.cli.run import measuring
from flflab.cli.terminal import Terminal
from flflab.property_names import PROPERTY_NAMES
from flflab.record import Run, frames_said
from flflab.report import junit_text, verdict_text
from flflab.report.facts import following
from flflab.verdict.comparison import Comparison, percent, rule
from flflab.verdict.diagnosis import heading, likeliest
from flflab.verdict.evaluation import Evaluation
from flflab.whole_file import require_own_writable, write_own
from procedures.validate import judged

REJECTED = 3

ROOMY = 72  # columns of a terminal that shows every column of the verdicts
WHOLE = 50  # and of one where names are folded, never a p-value


def conclude(
    run: Run,
    bench_file: Path | None = None,
    out: Path | None = None,
    as_json: bool = False,
    junit: Path | None = None,
) -> None:
    """Evaluate a run, write its table, page and ``verdict.json`` (into ``out``, or the run's
    folder) and JUnit XML where it is asked for, print the verdict; exit 3 where the model is
    rejected.
    """
    if junit is not None:
        require_own_writable(junit)
    with measuring(run, "report") as tell:
        evaluation, page = judged(run, bench_file, tell, out)
    if junit is not None:
        write_own(junit, junit_text(evaluation, run))
    with reader_may_go():
        if as_json:
            print(verdict_text(evaluation, run), end="")
        else:
            _tell(evaluation, run, page)
    if not evaluation.comparison.accepted:
        raise typer.Exit(REJECTED)


def _tell(evaluation: Evaluation, run: Run, page: Path) -> None:
    """Print tables, verdict, what would explain it, what to do next, and where the page is."""
    console = Terminal()
    console.print(configuration_table(evaluation, console.width))
    console.print(verdict_table(evaluation.comparison, console.width))
    console.print(rule(evaluation.comparison.verdicts), highlight=False)
    console.print(frames_said(run.frames), highlight=False)
    for sentence in evaluation.repeats.sentences if evaluation.repeats else ():
        console.print(sentence, highlight=False)
    accepted = evaluation.comparison.accepted
    console.print(
        (
            "The camera does what its model says."
            if accepted
            else "The camera does not do what its model says."
        ),
        style="bold",
    )
    if not accepted:
        suspects = likeliest(evaluation.suspects)
        console.print(heading(suspects), highlight=False)
        for suspect in suspects:
            sentence = f"{suspect.sentence[0].upper()}{suspect.sentence[1:]}."
            console.print(f"- {sentence}", highlight=False)
    step = following(evaluation, run)
    console.print(f"Next: {step.what}", highlight=False)
    console.print(f"    {step.command}", highlight=False, soft_wrap=True)
    console.print(f"Report: {page}", highlight=False, soft_wrap=True)


def verdict_table(comparison: Comparison, width: int) -> Table:
    """One line a property, with its p-value and verdict; narrow terminals show these alone."""
    roomy = width >= ROOMY
    table = Table(box=box.SIMPLE, title="Verdicts", pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("", overflow="fold")
    if roomy:
        table.add_column("values", justify="right", no_wrap=True)
    table.add_column("p-value", justify="right", overflow="fold", no_wrap=width >= WHOLE)
    if roomy:
        table.add_column("reject below", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True, min_width=len("rejected"))
    for one in comparison.verdicts:
        values, limit = [str(one.rows)] * roomy, [percent(one.threshold)] * roomy
        table.add_row(
            PROPERTY_NAMES.get(one.quantity, one.quantity),
            *values,
            one.p_words,
            *limit,
            "agrees" if one.accepted else Text("rejected", style="bold"),
        )
    return table


def configuration_table(evaluation: Evaluation, width: int) -> Table:
    """One line a configuration: where it stood, views measured and predicted, how well the contrast
    agrees; narrow terminals show what agrees alone.
    """
    roomy = width >= ROOMY
    table = Table(
        box=box.SIMPLE, title="Measured against predicted", pad_edge=False, padding=(0, 1, 0, 0)
    )
    place = ("target mm", "sensor mm") if roomy else ()
    for head in ("", "F/", *place, "views seen", "model", "MTF points", "MTF rms z"):
        table.add_column(head, justify="right", overflow="fold")
    for one, model in zip(evaluation.measured, evaluation.predicted, strict=True):
        scores = [
            row.z
            for row in evaluation.comparison.rows
            if row.quantity == "mtf" and row.configuration == one.configuration.index
        ]
        where = (f"{model.distance:.2f}", f"{model.camera.sensor.distance:.4f}") if roomy else ()
        table.add_row(
            str(one.configuration.index),
            f"{one.configuration.f_number:g}",
            *where,
            " ".join(str(dot.views) for dot in one.dots),
            " ".join(str(count) for count in model.views),
            str(len(scores)),
            f"{(sum(z * z for z in scores) / len(scores)) ** 0.5:.2f}" if scores else "",
        )
    return table

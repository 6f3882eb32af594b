"""What a calibration ends with: the bench fitted to a run, its table, its files."""

import math
from pathlib import Path

from rich import box
from rich.table import Table

from flflab.bench import read_bench
from flflab.bench_calibration import (
    Calibration,
    calibrate_run,
    calibration_numbers,
    require_unwritten,
    state_calibration,
    write_calibration,
)
from flflab.cli.as_json import print_json
from flflab.cli.run import measuring
from flflab.cli.terminal import Terminal
from flflab.digits import plus_minus
from flflab.record import Run
from flflab.study import read_study

WHOLE_NAMES = 100  # columns of a terminal that shows a parameter's name in one line
LONG = 22  # characters of a name that narrower ones show in two
DESCRIBED = 66  # and what it was described as
TITLE = (
    "Calibrated values (zeros and scales as corrections); last column: share of the information"
    " that came from the pictures"
)


def conclude(run: Run, as_json: bool = False) -> Calibration:
    """Fit a bench to a run, print the table and what is not determined, and leave files to go on
    with.
    """
    require_unwritten(run.folder)  # before the pictures are measured, which takes its time
    bench = read_bench(run.folder / "bench.yaml")
    with measuring(run, "resume"):
        found = calibrate_run(run, read_study(run.folder / "study.yaml", bench.optics), bench)
    (say_numbers if as_json else say_words)(found, write_calibration(found, bench, run.folder))
    return found


def say_numbers(found: Calibration, files: tuple[Path, ...]) -> None:
    """Print the calibration as JSON, with the run and the names of its files."""
    place = {"run": str(files[0].parent.resolve()), "files": [file.name for file in files]}
    print_json(calibration_numbers(found) | place)


def say_words(found: Calibration, files: tuple[Path, ...]) -> None:
    """Print the table and what is not determined, and where the files are."""
    console = Terminal(piped=140)
    console.print(table_of(found, console.width))
    for sentence in state_calibration(found):
        console.print(sentence, highlight=False)
    console.print(
        f"Written: {', '.join(str(file) for file in files)}", highlight=False, soft_wrap=True
    )


def table_of(found: Calibration, width: int) -> Table:
    """One line a parameter; below WHOLE_NAMES columns long names break at their last dot, below
    DESCRIBED what was described is left out.
    """
    fit = found.fit
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, title=TITLE)
    described = width >= DESCRIBED
    for head in ("", *["described"] * described, "calibrated", "pictures"):
        table.add_column(head, justify="right" if head else "left", overflow="fold")
    for name, nominal, prior, value, u, share in zip(
        fit.names, fit.nominal, fit.prior, fit.values, fit.uncertainty, fit.by_pictures, strict=True
    ):
        table.add_row(
            name if width >= WHOLE_NAMES else _in_two(name),
            *[_with_doubt(name, nominal, prior)] * described,
            _with_doubt(name, value, u),
            f"{100 * share:.0f} %",
        )
    return table


def _in_two(name: str) -> str:
    """A long name with its last part on a line of its own."""
    return ".\n  ".join(name.rsplit(".", 1)) if len(name) > LONG else name


def _with_doubt(name: str, value: float, u: float) -> str:
    """A parameter and its standard uncertainty where there is one: ``-1.31 ± 0.70 um``; ``-`` for
    what is not determined.
    """
    if not math.isfinite(value):
        return "-"
    of_stages = {
        "scale": (100.0, "+.4f", "%"),
        "zero": (1e3, "+.2f", "um"),
        "x": (1e3, "+.2f", "um"),
        "y": (1e3, "+.2f", "um"),
    }
    times, form, unit = of_stages.get(name.rpartition(".")[2], (1.0, ".5f", "mm"))
    if math.isfinite(u) and u > 0:
        return f"{plus_minus(times * value, times * u, '+' * form.startswith('+'))} {unit}"
    return f"{times * value:{form}} {unit}"

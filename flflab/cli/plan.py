"""``flflab plan STUDY``: what would be done, in which order and how long it takes; nothing connects, nothing moves."""

from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from flflab.bench import read_bench
from flflab.cli.new import Kind, built_in
from flflab.study import read_study


def plan(
    study: Annotated[Path, typer.Argument(help="study file (YAML)")],
    bench: Annotated[Path | None, typer.Option(help="bench file (YAML); by default the built-in simulated one")] = None,
) -> None:
    """Print every step with its expected duration; refuse what the bench cannot reach."""
    from procedures.steps import durations, most_frames, steps  # the engine is loaded by those who use it

    described = read_bench(bench or built_in(Kind.BENCH))
    to_do = steps(read_study(study, described.optics), described)
    lasting = durations(to_do, described)
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("step", justify="right")
    table.add_column("what")
    table.add_column("s", justify="right")
    for number, (step, seconds) in enumerate(zip(to_do, lasting, strict=True), start=1):
        table.add_row(str(number), str(step), f"{seconds:.1f}")
    frames = most_frames(to_do)
    columns, rows = described.optics.sensor.resolution
    console = Console(width=None if Console().is_terminal else 140)
    console.print(table)
    console.print(
        f"{len(to_do)} steps, at most {frames} frames ({frames * columns * rows * 2 / 1e9:.2f} GB), "
        f"about {sum(lasting) / 60:.1f} min at the stages' own speed; within limits, and the gap holds on the way."
    )

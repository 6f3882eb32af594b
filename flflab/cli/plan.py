"""``flflab plan STUDY``: what would be done, how long it takes and how sure it will be; nothing
connects, nothing moves.
"""

from pathlib import Path
from typing import Annotated

import typer

from flflab.built_in import simulated_bench
from flflab.cli.as_json import AsJson, print_json


def plan(
    study: Annotated[Path, typer.Argument(help="study file (YAML)")],
    bench: Annotated[
        Path | None, typer.Option(help="bench file (YAML); by default the built-in simulated one")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="table of what each configuration is expected to give (CSV)")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="address of a Dask scheduler whose workers share the simulation"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Print every step, the duration and the expected uncertainty of each configuration; refuse
    what the bench cannot reach.
    """
    from flflab.cli.described import described_bench  # help waits for none of it
    from flflab.cli.planned import (
        expectations,
        expected_table,
        in_bench_file,
        numbers_of,
        proposed_order,
        steps_table,
        write_expected,
    )
    from flflab.cli.run import in_words
    from flflab.cli.saying import say
    from flflab.cli.terminal import Terminal
    from flflab.missing_light import missing_light
    from flflab.study import read_study
    from flflab.whole_file import require_writable
    from procedures.durations import Expected, durations
    from procedures.steps import most_frames, steps

    described = described_bench(bench or simulated_bench())
    read = read_study(study, described.optics)
    to_do = steps(read, described)
    if out is not None:
        require_writable(out)
    if warning := missing_light(described, read):
        say(f"flflab: {warning}")
    expected = expectations(read, described, scheduler)
    if out is not None:
        write_expected(expected, read, out)
    frames = {one.configuration: one.looks[-1].frames for one in expected if one.looks}
    lasting = durations(
        to_do, described, Expected({one.configuration: one.exposure_s for one in expected}, frames)
    )
    proposed = proposed_order(described, read)
    most = most_frames(to_do)
    columns, rows = described.optics.sensor.resolution
    megabytes = most * columns * rows * 2 / 1e6
    if as_json:
        print_json(
            {
                "steps": [
                    {"what": str(step), "seconds": seconds}
                    for step, seconds in zip(to_do, lasting, strict=True)
                ],
                "seconds": sum(lasting),
                "most_frames": most,
                "most_megabytes": megabytes,
                "warning": warning,
                "model_uncertainty": {one.lens: one.shares for one in proposed},
                "configurations": [numbers_of(one, read) for one in expected],
            }
        )
        return
    console = Terminal(piped=140)
    console.print(steps_table([str(step) for step in to_do], lasting))
    console.print(expected_table(expected, read, console.width))
    console.print(
        f"{len(to_do)} steps, at most {most} frames ({megabytes:.0f} MB), about"
        f" {in_words(sum(lasting))} at the stages' own speed; within limits, and the gap is kept on"
        " the way."
    )
    for one in proposed:
        console.print(in_bench_file(one))

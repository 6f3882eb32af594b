"""``flflab plan STUDY``: what would be done, how long it takes and how sure it will be; nothing
connects, nothing moves.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.table import Table

from flflab.bench import Bench
from flflab.built_in import simulated_bench
from flflab.cli.as_json import AsJson, plain, print_json
from flflab.cli.described import described_bench
from flflab.cli.progress import counted_progress
from flflab.cli.run import in_words
from flflab.cli.saying import say
from flflab.cli.terminal import Terminal
from flflab.digits import two_digits
from flflab.expectation import Expectation, expect_all
from flflab.missing_light import missing_light
from flflab.study import Study, read_study
from flflab.whole_file import require_writable, write_csv

ROOMY = 72  # columns of a terminal that shows where every stage stands


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
    from procedures.durations import Expected, durations  # the engine is loaded by those who use it
    from procedures.steps import most_frames, steps

    described = described_bench(bench or simulated_bench())
    read = read_study(study, described.optics)
    to_do = steps(read, described)
    if out is not None:
        require_writable(out)
    if warning := missing_light(described, read):
        say(f"flflab: {warning}")
    expected = _expectations(read, described, scheduler)
    if out is not None:
        _write(expected, read, out)
    frames = {one.configuration: one.looks[-1].frames for one in expected if one.looks}
    lasting = durations(
        to_do, described, Expected({one.configuration: one.exposure_s for one in expected}, frames)
    )
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
                "configurations": [_numbers_of(one, read) for one in expected],
            }
        )
        return
    console = Terminal(piped=140)
    console.print(_steps_table([str(step) for step in to_do], lasting))
    console.print(expected_table(expected, read, console.width))
    console.print(
        f"{len(to_do)} steps, at most {most} frames ({megabytes:.0f} MB), about"
        f" {in_words(sum(lasting))} at the stages' own speed; within limits, and the gap is kept on"
        " the way."
    )


def _steps_table(steps: list[str], lasting: Sequence[float]) -> Table:
    """One line a step with its duration."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("step", justify="right")
    table.add_column("what", overflow="fold")
    table.add_column("s", justify="right")
    for number, (step, seconds) in enumerate(zip(steps, lasting, strict=True), start=1):
        table.add_row(str(number), step, f"{seconds:.2f}")
    return table


def _expectations(study: Study, bench: Bench, scheduler: str | None) -> list[Expectation]:
    with counted_progress(Terminal(stderr=True)) as progress:
        bar = progress.add_task("drawing and measuring", total=len(study.configurations), left="")
        found: list[Expectation] = []
        for one in expect_all(study, bench, scheduler):
            found.append(one)
            progress.update(bar, advance=1)
    return sorted(found, key=lambda one: one.configuration)


def expected_table(expected: list[Expectation], study: Study, width: int) -> Table:
    """One line a configuration: exposure, frames of the bars, how sure the MTF will be by noise,
    and how far the stages leave it open; narrow terminals show no stages.
    """
    roomy = width >= ROOMY
    wanted = study.description.mtf_standard_uncertainty
    asked = "" if wanted is None else f" ({wanted:g} requested)"
    table = Table(
        box=box.SIMPLE_HEAD,
        title=(
            f"Expected standard uncertainty of the MTF{asked}: from frame noise and the"
            " measurement's floor, and from stage errors (add in quadrature)"
        ),
    )
    places = ("target", "array", "sensor") if roomy else ("target",)
    for head in ("", "F/", *(f"{name}\nmm" for name in places), "exposure\nms", "frames"):
        table.add_column(head, justify="right", overflow="fold")
    table.add_column("u,\nnoise", overflow="fold")
    table.add_column("u,\nstages", justify="right")
    besides = any(setting.besides for setting in study.configurations)
    if besides:
        table.add_column("set besides", overflow="fold")
    for one in expected:
        setting = study.configurations[one.configuration]
        last = one.looks[-1] if one.looks else None
        said = f"not measurable: {one.why}" if last is None else two_digits(last.uncertainty)
        if last is not None and wanted is not None and last.uncertainty > wanted:
            said += f": not reached with {last.frames} frames"
        stages = "" if last is None else two_digits(one.by_stages)
        frames = "" if last is None else str(last.frames)
        place = [f"{setting.f_number:g}", f"{setting.distance:g}"]
        place += [f"{setting.array:g}", f"{setting.sensor:.4f}"] * roomy
        table.add_row(
            str(one.configuration),
            *place,
            f"{1e3 * one.exposure_s:.3g}",
            frames,
            said,
            stages,
            *([setting.besides] if besides else []),
        )
    return table


def _numbers_of(one: Expectation, study: Study) -> dict[str, Any]:
    """What a configuration is expected to give, for a table or a program; None where nothing is."""
    setting = study.configurations[one.configuration]
    look = one.looks[-1] if one.looks else None
    return plain(
        {
            "configuration": setting.index,
            "f_number": setting.f_number,
            "distance_mm": setting.distance,
            "array_mm": setting.array,
            "sensor_mm": setting.sensor,
            "exposure_s": one.exposure_s,
            "frames": None if look is None else look.frames,
            "mtf_standard_uncertainty": None if look is None else look.uncertainty,
            "mtf_uncertainty_by_stages": None if look is None else one.by_stages,
            "besides": setting.besides,
            "why": one.why,
        }
    )


def _write(expected: list[Expectation], study: Study, file: Path) -> None:
    numbers = [_numbers_of(one, study) for one in expected]
    columns = [name for name in numbers[0] if name != "why"]
    rows: list[list[object]] = [
        ["" if one[name] is None else _cell(one[name]) for name in columns] for one in numbers
    ]
    write_csv(file, [list(columns), *rows])


def _cell(value: object) -> object:
    return f"{value:.10g}" if isinstance(value, float) else value

"""What a plan says: steps with their durations, and what each configuration is expected to give."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from flflab.accuracy.proposed import Proposal, glass_of, proposals
from flflab.bench import Bench
from flflab.cli.as_json import plain
from flflab.cli.progress import counted_progress
from flflab.cli.terminal import Terminal
from flflab.digits import two_digits
from flflab.study import Study
from flflab.verdict.expectation import Expectation, expect_all
from flflab.whole_file import write_csv


def steps_table(steps: list[str], lasting: Sequence[float]) -> Table:
    """One line a step with its duration."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("step", justify="right")
    table.add_column("what", overflow="fold")
    table.add_column("s", justify="right")
    for number, (step, seconds) in enumerate(zip(steps, lasting, strict=True), start=1):
        table.add_row(str(number), step, f"{seconds:.2f}")
    return table


MOST_STATED = 0.5  # a share that a bench file may state
ROOMY = 72  # columns of a terminal that shows where every stage stands


def expectations(study: Study, bench: Bench, scheduler: str | None) -> list[Expectation]:
    """What each configuration is expected to give; shows how far it is."""
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


def numbers_of(one: Expectation, study: Study) -> dict[str, Any]:
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


def write_expected(expected: list[Expectation], study: Study, file: Path) -> None:
    """Write what each configuration is expected to give as a table."""
    numbers = [numbers_of(one, study) for one in expected]
    columns = [name for name in numbers[0] if name != "why"]
    rows: list[list[object]] = [
        ["" if one[name] is None else _cell(one[name]) for name in columns] for one in numbers
    ]
    write_csv(file, [list(columns), *rows])


def _cell(value: object) -> object:
    return f"{value:.10g}" if isinstance(value, float) else value


def proposed_order(bench: Bench, study: Study) -> tuple[Proposal, ...]:
    """What exact rays propose as ``model_uncertainty`` in the settings of a study; nothing where
    the camera file gives no radius and index of its microlenses.
    """
    microlens = glass_of(bench.file.parent / bench.description.optics)
    if microlens is None:
        return ()
    used = ((one.camera(bench.optics), one.distance) for one in study.configurations)
    return proposals(microlens, used)


def in_bench_file(proposal: Proposal) -> str:
    """The line to copy, and for which main lens it holds."""
    shares = ", ".join(f"{name}: {value:g}" for name, value in proposal.shares.items())
    stated = "model_uncertainty: {" + shares + "}"
    if max(proposal.shares.values()) < MOST_STATED:
        return (
            f"Exact rays through these microlenses, main lens like the {proposal.lens}: `{stated}`"
        )
    return (
        f"Exact rays through these microlenses, main lens like the {proposal.lens}, differ from"
        f" first order by more than a bench file may state: {shares}; the model does not hold for"
        " them"
    )

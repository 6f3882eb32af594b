"""Writes the report of a run: one HTML file that needs nothing else, readable on screen and on
paper.
"""

import math
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined, Template

from flflab.bench import Bench
from flflab.optics import airy
from flflab.property_names import PROPERTY_NAMES
from flflab.record import Run, frames_said
from flflab.report import budgets, charts, facts, frames, tables
from flflab.report.drawn import drawn_table
from flflab.report.field_chart import field_chart
from flflab.report.overview import overview_chart, property_name
from flflab.study import Study
from flflab.verdict.comparison import percent, rule
from flflab.verdict.diagnosis import heading, likeliest
from flflab.verdict.evaluation import Evaluation
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.whole_file import write_own

ELSEWHERE = (
    "time",
    "devices",
    "software",
    "configurations",
    "simulated_light",
)  # what the start document holds that the page shows in its place


MOST_NAMED = 3  # properties that disagree, in the headline
LEAST_REMOVED = 0.5  # of the misfit, by a change that is named beside the best


@dataclass(frozen=True)
class Panel:
    """One configuration's pictures; a frame or chart that there is not is None."""

    index: int
    title: str
    dots: frames.MarkedFrame | None
    bars: frames.MarkedFrame | None
    mtf: str | None
    mtf_y: str | None
    field: str | None
    ratio: str | None
    counts: str
    missed: int
    extra: int


def write_report(evaluation: Evaluation, run: Run, study: Study, bench: Bench, file: Path) -> None:
    """Write the page.

    Args:
        evaluation: the run measured, predicted and compared.
        run: its record; frames are read from it.
        study: as recorded with it.
        bench: as recorded with it.
        file: the HTML file to write, replaced where it exists.

    Raises:
        RecordError: a frame cannot be read.
        InputError: the page cannot be written; one that was there stays.
    """
    exact, dots = facts.exact_counts(evaluation.comparison.rows)
    recorded = facts.recorded_bench(run, bench) or bench
    local, devices = facts.simulated_devices(recorded)
    suspects = likeliest(evaluation.suspects)
    warnings = facts.notes(evaluation, run, study, bench)
    wanted = study.description.mtf_standard_uncertainty
    shown = facts.pictured(evaluation, study.description.reference)
    pairs = [
        pair
        for pair in zip(evaluation.measured, evaluation.predicted, strict=True)
        if pair[0].configuration.index in shown
    ]
    text = _template().render(
        study=study.description.name,
        folder=run.folder.name,
        began=facts.moment(run.start.get("time")),
        comparison=evaluation.comparison,
        headline=headline(evaluation),
        rejected=[property_name(one) for one in evaluation.comparison.verdicts if not one.accepted],
        most_named=MOST_NAMED,
        names=PROPERTY_NAMES,
        rule=rule(evaluation.comparison.verdicts),
        percent=percent,
        exact=exact,
        dots=dots,
        simulated=f"{len(local)} of {devices} devices" if local else "",
        devices_count=devices,
        calibrated=facts.calibration(bench, run),
        step=facts.following(evaluation, run),
        said=[
            frames_said(run.frames),
            *(evaluation.repeats.sentences if evaluation.repeats else ()),
        ],
        overview=overview_chart(evaluation),
        curve_of=curve_of,
        contents=_contents(
            evaluation, accuracy=bool(run.accuracy and wanted is not None), warned=bool(warnings)
        ),
        notes=warnings,
        statistics=tables.statistics_table(evaluation),
        wavelength=bench.description.mean_wavelength,
        diffraction=diffraction_sentence(evaluation, bench.description.mean_wavelength),
        panels=[_panel(evaluation, one, model, run, study) for one, model in pairs],
        configuration_count=len(evaluation.measured),
        suspects_heading=heading(suspects),
        suspects=[suspect.sentence for suspect in suspects],
        next_suspects=[
            suspect.in_short
            for suspect in evaluation.suspects
            if suspect not in suspects and suspect.removed > LEAST_REMOVED
        ][:3],
        budget=budgets.summary_table(evaluation),
        visible=tables.visible_table(evaluation),
        budgets=budgets.budget_tables(evaluation),
        planes=tables.planes_table(evaluation),
        properties_chart=charts.properties_chart(evaluation),
        views_chart=charts.views_chart(evaluation),
        difference_chart=charts.difference_chart(evaluation),
        residual_chart=charts.residual_chart(evaluation),
        accuracy_chart=(
            charts.accuracy_chart(run, wanted) if run.accuracy and wanted is not None else None
        ),
        reference=study.description.reference,
        colours=charts.DOTS,
        configurations=[
            tables.settings_table(
                study, evaluation, bench.description.mean_wavelength or airy.WAVELENGTH
            ),
            tables.micro_image_table(evaluation, run),
        ],
        rows=tables.comparison_tables(evaluation.comparison.rows),
        bench=[
            tables.axes_table(bench, run),
            tables.parts_table(bench, study),
            tables.exposures_table(run),
        ],
        devices=tables.devices_table(run),
        truth=(
            tables.simulated_table(bench)
            if "simulated" in bench.description.model_fields_set
            else None
        ),
        drawn=drawn_table(run),
        provenance=_provenance(run, study, bench),
        draws=study.description.draws,
        light=bench.description.light_uncertainty,
        significance=study.description.significance,
    )
    write_own(file, text)


def _template() -> Template:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(
        files("flflab.report").joinpath("page.html.jinja").read_text(encoding="utf-8")
    )


def curve_of(quantity: str) -> str:
    """The place of the page that shows a property."""
    return {"mtf": "curves", "views": "views"}.get(quantity, "properties")


def _contents(evaluation: Evaluation, *, accuracy: bool, warned: bool) -> list[tuple[str, str]]:
    """Places of the page and their titles."""
    found = [("causes", "possible causes")] if not evaluation.comparison.accepted else []
    found += [("warnings", "warnings")] if warned else []
    found += [("verdicts", "verdicts"), ("curves", "contrast (MTF)")]
    found += [("properties", "fields, light, depth")]
    found += [("views", "number of views")] if any(one.dots for one in evaluation.measured) else []
    if len(evaluation.measured) > 1:
        found.append(("differences", "differences and ratios"))
    found += [("uncertainties", "uncertainties"), ("visible", "what this run can show")]
    found += [("frames", "frames")]
    found += [("accuracy", "accuracy on the bench")] if accuracy else []
    return [
        *found, ("configurations", "configurations"), ("values", "all values"),
        ("bench", "on the bench"), ("reading", "how to read"), ("provenance", "provenance"),
    ]  # fmt: skip


def headline(evaluation: Evaluation) -> str:
    """The verdict in one sentence, with the names of a few properties that disagree."""
    rejected = [property_name(one) for one in evaluation.comparison.verdicts if not one.accepted]
    if not rejected:
        return "The camera does what its model says."
    verb, count = "disagrees" if len(rejected) == 1 else "disagree", len(rejected)
    names = (
        ", ".join(rejected)
        if count <= MOST_NAMED
        else f"{count} of {len(evaluation.comparison.verdicts)} properties"
    )
    return f"The camera does not do what its model says: {names} {verb}."


def diffraction_sentence(evaluation: Evaluation, wavelength: float | None) -> str:
    """Airy diameter against the pixel, what diffraction leaves of the contrast at the highest
    frequency compared, and whether it counts.
    """
    light = wavelength or airy.WAVELENGTH
    diameters, left = list[float](), list[float]()
    for one, model in zip(evaluation.measured, evaluation.predicted, strict=True):
        diameters.append(
            airy.airy_diameter(model.camera, model.distance, light) / model.camera.sensor.pixel
        )
        left += [
            float(
                airy.diffraction_contrast(
                    model.camera, model.distance, curve.cycles_per_px.max(), light
                )
            )
            for curve in one.curves.values()
        ]
    low, high = min(diameters), max(diameters)
    span = f"{low:.2f}" if math.isclose(low, high, rel_tol=5e-3) else f"{low:.2f} to {high:.2f}"
    sentence = f"At {1e6 * light:g} nm the Airy diameter on the sensor is {span} pixels"
    verb = (
        "more than the one pixel of blur that the depth of field allows"
        if high > 1
        else "within one pixel"
    )
    counted = (
        "The predicted contrast holds it, and dots whose edges show it are fitted by waves."
        if wavelength
        else (
            "Where the sensor sees that, the contrast measured at high frequencies must lie below"
            " the prediction: add light: {wavelength: 550 nm} to the bench file"
            " to include diffraction."
        )
    )
    if not left:
        return f"{sentence}, {verb}."
    return (
        f"{sentence}, {verb}; at the highest frequency compared a lens limited by diffraction alone"
        f" keeps {100 * min(left):.0f} % of the contrast. {counted}"
    )


def _panel(
    evaluation: Evaluation, one: Measured, model: Predicted, run: Run, study: Study
) -> Panel:
    index = one.configuration.index
    title = (
        f"{index}: F/{one.configuration.f_number:g}, D = {model.distance:.1f} mm, gap b ="
        f" {model.camera.gap:.4f} mm"
    )
    title += f", {one.configuration.besides}" if one.configuration.besides else ""
    first = {frame.target: frame for frame in reversed(run.frames) if frame.configuration == index}
    shown, ruled = first.get(study.dots.kind), first.get(study.bars.kind)
    dots = frames.dots_frame(run.picture(shown), one, model, study.dots) if shown else None
    agreements = [mark.agreement for mark in dots.marks] if dots else []
    rows = evaluation.comparison.rows
    ratio = any(row.quantity == "ratio_mtf" and row.configuration == index for row in rows)
    return Panel(
        index=index,
        title=title,
        dots=dots,
        bars=frames.bars_frame(run.picture(ruled), one, model) if ruled and one.curve else None,
        mtf=(
            charts.mtf_chart(index, one.curve, model.contrast_draws, rows, title)
            if one.curve
            else None
        ),
        mtf_y=(
            charts.mtf_chart(index, one.curve_y, model.contrast_y_draws, (), f"{title}, along y")
            if one.curve_y
            else None
        ),
        field=field_chart(one, model.camera, title),
        ratio=(
            charts.ratio_chart(rows, index, f"{index} over {study.description.reference}")
            if ratio
            else None
        ),
        counts=", ".join(
            f"dot {dot.dot}: {dot.views} ({model.views[dot.dot]})" for dot in one.dots
        ),
        missed=agreements.count("missed"),
        extra=agreements.count("extra"),
    )


def _provenance(run: Run, study: Study, bench: Bench) -> list[tables.Table]:
    stop = run.stop or {}
    description = study.description
    about = {
        "folder": str(run.folder.resolve()),
        "began": facts.moment(run.start.get("time")),
        "ended": facts.moment(stop.get("time")),
        "exit status": stop.get("exit_status", "never ended"),
        "frames recorded": len(run.frames),
        "study": description.name,
        "bench file": bench.file.name,
        "seed of the simulated bench": bench.description.simulated.seed,
        "draws of the stage errors": description.draws,
        "significance, shared by the verdicts": description.significance,
    }
    start = {name: value for name, value in run.start.items() if name not in ELSEWHERE}
    return [
        tables.facts_table("The run", about),
        tables.facts_table("Versions", run.start.get("software", {})),
        tables.facts_table("Start of the record", start),
    ]

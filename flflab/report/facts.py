"""Numbers that the report states beside the comparison: exact counts, pooled z, notes before
signing.
"""

import math
from dataclasses import dataclass
from datetime import UTC, date, datetime

import numpy as np

from flflab.bench import Bench, read_bench
from flflab.missing_light import missing_light
from flflab.record import Run, frames_said, not_used
from flflab.simulated_light import is_simulated
from flflab.study import Study
from flflab.targets import Texture
from flflab.verdict.comparison import Row
from flflab.verdict.diagnosis import likeliest
from flflab.verdict.evaluation import Evaluation
from flflab.verdict.next_step import NextStep, next_step
from flflab.verdict.properties.measured import Measured
from flflab.wheel import unlike_the_wheel

WORST_MISFIT = 0.02  # of the light
WORST_CHI2 = 1.5  # per pixel: above, the picture holds something that the fit does not know
PICTURED = 12  # configurations; a page of more is not read


@dataclass(frozen=True)
class ZStatistics:
    """Standardised differences of one quantity, pooled over all configurations.

    ``beyond_two`` is a share; ``largest`` the row with the largest absolute value; ``unlimited``
    counts rows without any uncertainty that differ, which the other figures leave out.
    """

    quantity: str
    rows: int
    mean: float
    deviation: float
    beyond_two: float
    unlimited: int
    largest: Row


def z_statistics(rows: tuple[Row, ...]) -> tuple[ZStatistics, ...]:
    """Statistics of every quantity, in the order of first appearance."""
    found: list[ZStatistics] = []
    for quantity in dict.fromkeys(row.quantity for row in rows):
        members = [row for row in rows if row.quantity == quantity]
        z = np.array([row.z for row in members])
        finite = z[np.isfinite(z)]
        known = len(finite) > 1
        found.append(
            ZStatistics(
                quantity=quantity,
                rows=len(members),
                mean=float(finite.mean()) if known else math.nan,
                deviation=float(finite.std(ddof=1)) if known else math.nan,
                beyond_two=float(np.mean(np.abs(z) > 2)),
                unlimited=len(z) - len(finite),
                largest=members[int(np.argmax(np.abs(z)))],
            )
        )
    return tuple(found)


def exact_counts(rows: tuple[Row, ...]) -> tuple[int, int]:
    """How many dots have exactly the predicted number of views, and how many dots there are."""
    views = [row for row in rows if row.quantity == "views"]
    return sum(row.measured == row.predicted for row in views), len(views)


def simulated_devices(bench: Bench) -> tuple[list[str], int]:
    """Names of the devices at a simulated or loopback address, and the number of all devices."""
    description = bench.description
    devices = {
        **description.axes,
        "camera": description.camera,
        "iris": description.iris,
        "target": description.target,
    }
    local = [name for name, device in devices.items() if is_simulated(device.address)]
    return local, len(devices)


def recorded_bench(run: Run, otherwise: Bench | None = None) -> Bench | None:
    """The bench that a run was recorded with, whatever it is judged by; else the one given."""
    file = run.folder / "bench.yaml"
    return read_bench(file) if file.exists() else otherwise


def calibration(bench: Bench, run: Run) -> str:
    """When the bench was calibrated, and how long before the run."""
    day, began = bench.description.calibrated, run.start.get("time")
    if day is None:
        return "none stated in the bench file"
    if began is None:
        return day
    since = (datetime.fromtimestamp(began, UTC).date() - date.fromisoformat(day)).days
    return f"{day}, {counted(since, 'day')} before this run" if since >= 0 else day


def following(evaluation: Evaluation, run: Run) -> NextStep:
    """What to do after a run's verdict."""
    bench = recorded_bench(run)
    return next_step(
        evaluation.comparison.accepted,
        likeliest(evaluation.suspects),
        run.folder,
        simulated=bench is not None and bool(simulated_devices(bench)[0]),
    )


def notes(evaluation: Evaluation, run: Run, study: Study, bench: Bench) -> list[str]:
    """What a reader should know before signing; empty where nothing is amiss."""
    found: list[str] = [parts(run)] if run.resumed else []
    if run.stop is None:
        found += _lost(run) or [
            "The run has no stop document: it never ended properly, and is reported as far as it"
            " was recorded."
        ]
    elif run.stop.get("exit_status", "success") != "success":
        reason = run.stop.get("reason") or "no reason given"
        found.append(f"The run ended with status {run.stop['exit_status']}: {reason}.")
    if not_used(run.frames):
        found.append(frames_said(run.frames))
    found += _unmeasured(evaluation, study)
    found += [
        f"{sentence[0].upper()}{sentence[1:]}." for sentence in unlike_the_wheel(study, bench)
    ]
    if warning := missing_light(bench, study):
        found.append(f"{warning[0].upper()}{warning[1:]}.")
    found += _wrong_targets(evaluation.measured, study)
    found += _saturation(evaluation.measured)
    where: dict[str, list[int]] = {}
    for one in evaluation.measured:
        for sentence in _notes_on(one):
            where.setdefault(sentence, []).append(one.configuration.index)
    found += [
        f"Configuration{'s' if len(places) > 1 else ''} {listed(places)}: {sentence}"
        for sentence, places in where.items()
    ]
    missing = sum(row.uncertainty <= 0 for row in evaluation.comparison.rows)
    if missing:
        have = "has" if missing == 1 else "have"
        found.append(
            f"{counted(missing, 'row')} of the comparison {have} no uncertainty: z is 0 or infinite"
            " there."
        )
    return found


def _lost(run: Run) -> list[str]:
    """What a loss of power took from the end of a record."""
    left = "what was lost is left out, and `flflab resume` takes it again."
    return [f"{run.loss[0].upper()}{run.loss[1:]}; {left}"] if run.lost else []


def _unmeasured(evaluation: Evaluation, study: Study) -> list[str]:
    """Which configurations the record lacks, or has no admitted frames of."""
    measured = {one.configuration.index for one in evaluation.measured}
    missing = [
        one.index for one in study.configurations[: study.settings] if one.index not in measured
    ]
    return (
        [f"Not recorded or not admitted, and left out: configurations {listed(missing)}."]
        if missing
        else []
    )


def parts(run: Run) -> str:
    """In how many parts a run was recorded, and when and why it was cut: ``Recorded in 2 parts: cut
    at ... (...), resumed at ...``.
    """
    cuts: list[str] = []
    for stop, start in zip(run.cut, run.resumed, strict=True):
        when = (
            "cut off"
            if stop is None
            else f"cut at {moment(stop.get('time'))} ({stop.get('reason') or 'no reason given'})"
        )
        cuts.append(f"{when}, resumed at {moment(start.get('time'))}")
    return f"Recorded in {len(cuts) + 1} parts: {'; '.join(cuts)}."


def moment(seconds: float | None) -> str:
    """A time since 1970 in seconds as date and time, UTC."""
    return (
        "not recorded"
        if seconds is None
        else datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    )


def counted(many: int, what: str) -> str:
    """``1 row``, ``2 rows``."""
    return f"{many} {what}" if many == 1 else f"{many} {what}s"


def listed(places: list[int]) -> str:
    """Rising whole numbers in words, three and more in a row as a range: ``0, 2 and 5 to 9``."""
    runs: list[list[int]] = []
    for place in places:
        if runs and place == runs[-1][-1] + 1:
            runs[-1].append(place)
        else:
            runs.append([place])
    words = [
        word
        for run in runs
        for word in ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run))
    ]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def pictured(evaluation: Evaluation, reference: int, most: int = PICTURED) -> frozenset[int]:
    """The configurations whose frames and curves a page shows: the reference, first and last, and
    those farthest from the model.
    """
    every = [one.configuration.index for one in evaluation.measured]
    off = dict.fromkeys(every, 0.0)
    for row in evaluation.comparison.rows:
        if row.reference_configuration is None and row.quantity != "contrast_paper":
            off[row.configuration] = max(off[row.configuration], abs(row.z))
    first = [index for index in (reference, every[0], every[-1]) if index in off]
    return frozenset(
        list(dict.fromkeys([*first, *sorted(every, key=lambda index: -off[index])]))[:most]
    )


def _saturation(measured: tuple[Measured, ...]) -> list[str]:
    counts = ", ".join(
        f"{one.saturated} in configuration {one.configuration.index}"
        for one in measured
        if one.saturated
    )
    return (
        [f"Saturated pixels, left out of every fit, in the worst frame: {counts}."]
        if counts
        else []
    )


def _wrong_targets(measured: tuple[Measured, ...], study: Study) -> list[str]:
    """What was found in no configuration, where more than one was taken: rarely the camera's
    fault.
    """
    missing = [
        name
        for name, kind, seen in (
            ("dots", study.dots.kind, any(one.dots for one in measured)),
            ("bars", study.bars.kind, any(one.curve for one in measured)),
            ("bars along y", study.bars_y.kind, any(one.curve_y for one in measured)),
            ("texture", Texture.kind, any(one.plane for one in measured)),
        )
        if kind in study.shown and not seen
    ]
    if not missing or len(measured) < 2:
        return []
    return [
        f"No {' and no '.join(missing)} could be measured in any configuration: are the targets"
        " exchanged, or is the picture mirrored or turned by 90 degrees? Columns rise with x, rows"
        " with y. `flflab bench snap` shows what the camera sees."
    ]


def _notes_on(one: Measured) -> list[str]:
    found = [f"{failure}." for failure in one.failures]
    if one.lattice.misfit > WORST_MISFIT:
        found.append(
            f"the light of micro-images departs by {100 * one.lattice.misfit:.2g} % from the"
            " camera's shape; the lattice's uncertainties were enlarged to match."
        )
    found += [
        f"the contrast fit of {words} leaves {curve.chi2_per_pixel:.2g} times the noise's"
        " variance; its uncertainties were enlarged to match."
        for words, curve in (("bars", one.curve), ("bars along y", one.curve_y))
        if curve and curve.chi2_per_pixel > WORST_CHI2
    ]
    uncertain = sum(dot.views_uncertain for dot in one.dots)
    if uncertain:
        found.append(f"views so near an edge that the frame hardly decides them: {uncertain}.")
    return found

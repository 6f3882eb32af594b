"""Tables of the report as plain text cells; the page lays them out and escapes them."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np

from flflab.bench import AxisDescription, Bench
from flflab.digits import decimals, plus_minus
from flflab.optics.airy import airy_diameter
from flflab.optics.focus import magnification, virtual_depth
from flflab.optics.resolution import central_smms
from flflab.record import Run
from flflab.report.facts import counted, z_statistics
from flflab.report.quantities import quantity_of
from flflab.study import Study
from flflab.targets import Target
from flflab.verdict.comparison import Row
from flflab.verdict.evaluation import Evaluation
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted

MICRO = "\u00b5m"


@dataclass(frozen=True)
class Table:
    """A caption, headings and rows of cells."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def planes_table(evaluation: Evaluation) -> Table | None:
    """Depth maps of a texture against the stages; None where there are none."""
    rows = tuple(
        (
            str(one.configuration.index),
            f"{model.distance:.2f} mm",
            f"{measured_number(seen.distance, seen.uncertainty)} mm",
            f"{seen.distance - model.distance:+.2f} mm",
            f"{seen.scatter:.2g} mm",
            f"{100 * seen.within_1:.0f} %, {100 * seen.within_2:.0f} %",
            f"{100 * seen.density:.0f} %",
        )
        for one, model in zip(evaluation.measured, evaluation.predicted, strict=True)
        if (seen := one.plane) is not None
    )
    headings = (
        "configuration",
        "target by the stages",
        "mean of the map",
        "bias",
        "scatter",
        "within 1, 2 sigma of it",
        "places with a value",
    )
    caption = "Depth maps of the texture against the stages (due within 1, 2 sigma: 68 %, 95 %)"
    return Table(caption, headings, rows) if rows else None


def number(value: float, digits: int = 6) -> str:
    """A number for people; ``infinity`` where there is no end to it."""
    if math.isnan(value):
        return "-"
    return (
        f"{value:.{digits}g}" if math.isfinite(value) else "infinity" if value > 0 else "-infinity"
    )


def measured_number(value: float, uncertainty: float) -> str:
    """Value with its standard uncertainty in the last two digits: ``245.5814(29)``; ``±`` where
    brackets would mislead.
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0 and math.isfinite(value)):
        return number(value)
    places = 1 - math.floor(math.log10(float(f"{uncertainty:.1e}")))
    if 0 < places <= 9:
        return f"{value:.{places}f}({round(uncertainty * 10**places)})"
    return plus_minus(value, uncertainty)


def to_decimals(value: float, places: int | None, sign: str = "") -> str:
    """A number with so many decimals and no minus before zero, or with six digits."""
    if places is None or not math.isfinite(value):
        return number(value)
    return f"{round(value, places) + 0.0:{sign}.{places}f}"


def in_words(quantity: str) -> str:
    """A quantity and its unit: ``bright field, µm``."""
    words, unit, _ = quantity_of(quantity)
    return f"{words}, {unit}" if unit else words


def statistics_table(evaluation: Evaluation) -> Table:
    """Pooled z of every quantity."""
    rows = [
        (
            quantity_of(one.quantity).words, str(one.rows), to_decimals(one.mean, 2),
            to_decimals(one.deviation, 2),
            f"{100 * one.beyond_two:.1f} %",
            to_decimals(one.largest.z, 2), str(one.largest.configuration), str(one.unlimited),
        )
        for one in z_statistics(evaluation.comparison.rows)
    ]  # fmt: skip
    headings = (
        "quantity", "rows", "mean z", "standard deviation of z", "share with |z| > 2",
        "z farthest from 0", "in configuration", "rows without a finite z",
    )  # fmt: skip
    return Table("Standardised differences, pooled over all configurations", headings, tuple(rows))


def visible_table(evaluation: Evaluation) -> Table:
    """How large every single change of the bench must be to be seen in this run."""
    rows = tuple((one.what, one.words) for one in evaluation.visible)
    return Table("Smallest change that this run would show", ("changed", "seen from"), rows)


def settings_table(study: Study, evaluation: Evaluation, wavelength: float) -> Table:
    """What was set and what follows from it by the model, in light of a wavelength (mm)."""
    pairs = zip(evaluation.measured, evaluation.predicted, strict=True)
    rows = [_settings(one, model, study.description.reference, wavelength) for one, model in pairs]
    headings = (
        "configuration", "f-number", "target D, mm", "array L, mm", "sensor, mm", "gap b, mm",
        "virtual depth", "magnification",
        "blur, px", "Airy diameter, px",
    )  # fmt: skip
    return Table(
        "Settings as the stages read them, and what the model makes of them", headings, tuple(rows)
    )


def _settings(
    one: Measured, model: Predicted, reference: int, wavelength: float
) -> tuple[str, ...]:
    smms, camera, vergence = central_smms(model.camera), model.camera, 1 / model.distance
    index = one.configuration.index
    said = ", ".join(
        filter(None, ("reference" if index == reference else "", one.configuration.besides))
    )
    return (
        f"{index} ({said})" if said else str(index), number(one.configuration.f_number, 4),
        f"{model.distance:.4f}", f"{camera.array.distance:.4f}", f"{camera.sensor.distance:.4f}",
        f"{camera.gap:.4f}",
        number(float(virtual_depth(smms, vergence)), 5),
        number(float(magnification(smms, vergence)), 5),
        f"{model.blur_px:.2f}",
        f"{airy_diameter(camera, model.distance, wavelength) / camera.sensor.pixel:.2f}",
    )  # fmt: skip


def micro_image_table(evaluation: Evaluation, run: Run) -> Table:
    """What the frames show of every configuration."""
    rows: list[tuple[str, ...]] = []
    for one, model in zip(evaluation.measured, evaluation.predicted, strict=True):
        smms, lattice, pixel = central_smms(model.camera), one.lattice, model.camera.sensor.pixel
        pitch = model.camera.array.pitch[0] * float(smms.image_scale) / pixel
        frames = [frame for frame in run.frames if frame.configuration == one.configuration.index]
        rows.append(
            (
                str(one.configuration.index),
                f"{measured_number(lattice.pitch_px, lattice.pitch_uncertainty_px)} / {pitch:.3f}",
                measured_number(1e3 * lattice.angle, 1e3 * lattice.angle_uncertainty),
                f"{measured_number(lattice.inside_radius_px, lattice.inside_uncertainty_px)} / {float(smms.inside_radius) / pixel:.2f}",  # noqa: E501
                f"{measured_number(lattice.outside_radius_px, lattice.outside_uncertainty_px)} / {float(smms.outside_radius) / pixel:.2f}",  # noqa: E501
                ", ".join(f"{dot.views}/{model.views[dot.dot]}" for dot in one.dots),
                str(len(one.curve.cycles_per_mm)) if one.curve else "none",
                number(1e3 * one.exposure_s, 4),
                number(frames[0].gain, 3) if frames else "-", str(one.saturated),
            )
        )  # fmt: skip
    headings = (
        "configuration", "pitch, px", "angle, mrad", "inside radius, px", "outside radius, px",
        "views of dots 0 to 3",
        "frequencies", "exposure, ms", "gain", "saturated pixels",
    )  # fmt: skip
    caption = (
        "Measured in the frames / predicted; in brackets the standard uncertainty of the last"
        " digits"
    )
    return Table(caption, headings, tuple(rows))


def comparison_tables(rows: tuple[Row, ...]) -> tuple[Table, ...]:
    """All rows, one table a quantity."""
    quantities = dict.fromkeys(row.quantity for row in rows)
    return tuple(
        _comparison([row for row in rows if row.quantity == quantity], quantity)
        for quantity in quantities
    )


def _comparison(rows: list[Row], quantity: str) -> Table:
    referred, dots = (
        any(row.reference_configuration is not None for row in rows),
        any(row.dot is not None for row in rows),
    )
    bars = any(row.cycles_per_mm is not None for row in rows)
    place_heading = ["dot"] if dots else ["frequency, cycles/mm"] if bars else []
    headings = ["configuration", *(["against"] if referred else []), *place_heading]
    cells: list[tuple[str, ...]] = []
    for row in rows:
        place = [str(row.dot)] if dots else [number(row.cycles_per_mm or 0.0, 4)] if bars else []
        against = [str(row.reference_configuration)] if referred else []
        cells.append((str(row.configuration), *against, *place, *_numbers(row)))
    headings += ["measured", "uncertainty", "predicted", "difference", "z"]
    caption = f"{in_words(quantity)}: {counted(len(rows), 'row')} ({quantity} in comparison.csv)"
    return Table(caption, tuple(headings), tuple(cells))


def _numbers(row: Row) -> tuple[str, ...]:
    """What was measured and predicted in people's unit, to the uncertainty's second digit; counts
    are whole.
    """
    many, counts = quantity_of(row.quantity).many, row.quantity.endswith("views")
    uncertainty = many * row.uncertainty
    places = decimals(uncertainty)
    measured, predicted = (
        to_decimals(many * value, None if counts else places)
        for value in (row.measured, row.predicted)
    )
    difference = to_decimals(many * row.difference, 0 if counts else places, "+")
    return measured, to_decimals(uncertainty, places), predicted, difference, f"{row.z:+.2f}"


def axes_table(bench: Bench, run: Run) -> Table:
    """The axes: where they are reached, how their readings become places, and how far they went."""
    axes = bench.description.axes
    properties = (
        "moves", "driver", "address", "driver's own keys", "world z, mm",
        f"uncertainty of the zero, {MICRO}",
        "uncertainty of the scale, ppm", "limits of the reading, mm", "readings used, mm",
        "speed, mm/s", "homes towards",
    )  # fmt: skip
    columns = [properties, *(_axis(name, axis, run) for name, axis in axes.items())]
    return Table("Axes", ("property", *axes), tuple(zip(*columns, strict=True)))


def _axis(name: str, axis: AxisDescription, run: Run) -> tuple[str, ...]:
    """An axis's column; one that turns the array says degrees where the headings say lengths."""
    unit, turns = axis.coordinate.per_unit, axis.coordinate.unit == "rad"
    readings = [unit * frame.readings[name] for frame in run.frames if name in frame.readings]
    used = f"{min(readings):.4f} to {max(readings):.4f}" if readings else "-"
    own = ", ".join(f"{key} {value}" for key, value in (axis.model_extra or {}).items())
    low, high = (unit * limit for limit in axis.limits)
    zero = number((unit if turns else 1e3) * axis.zero_uncertainty, 3)
    cells = (
        f"{unit * axis.zero:g} {'+' if axis.sign > 0 else '-'} reading",
        zero,
        f"{low:g} to {high:g}",
        used,
        number(unit * axis.speed, 4),
    )
    place, zero, limits, used, speed = (
        f"{cell} ({said})" if turns else cell
        for cell, said in zip(cells, (*["deg"] * 4, "deg/s"), strict=True)
    )
    scale = number(1e6 * axis.scale_uncertainty, 3)
    return (
        axis.moves,
        axis.driver,
        axis.address or "none",
        own or "none",
        place,
        zero,
        scale,
        limits,
        used,
        speed,
        axis.home_towards,
    )


def parts_table(bench: Bench, study: Study) -> Table:
    """Camera, iris, target holder and the optics in words."""
    description, optics = bench.description, bench.optics
    rows: list[tuple[str, str]] = []
    for name, device in (
        ("camera", description.camera),
        ("iris", description.iris),
        ("target holder", description.target),
    ):
        own = "".join(f", {key} {value}" for key, value in (device.model_extra or {}).items())
        rows.append((name, f"driver {device.driver}, address {device.address or 'none'}{own}"))
    lens, array, sensor, useful = optics.main_lens, optics.array, optics.sensor, optics.useful
    focal = ", ".join(f"{one:g}" for one in array.focal_lengths)
    rows += [
        ("main lens", f"focal length {lens.focal_length:g} mm"),
        (
            "microlens array",
            (
                f"{array.layout}, {array.count[0]} x {array.count[1]}, pitch"
                f" {1e3 * array.pitch[0]:g} x {1e3 * array.pitch[1]:g} {MICRO}, aperture"
                f" {1e3 * array.aperture:g} {MICRO}, focal length {focal} mm"
            ),
        ),
        (
            "sensor",
            (
                f"{sensor.resolution[0]} x {sensor.resolution[1]} pixels of {1e3 * sensor.pixel:g}"
                f" {MICRO}"
            ),
        ),
        (
            "useful region",
            (
                f"illumination from {useful.minimum_illumination:g} up, crosstalk up to"
                f" {useful.maximum_crosstalk:g} (shares)"
            ),
        ),
        *((one.kind, _target(one)) for one in study.targets),
        ("smallest gap allowed", f"{description.minimum_gap:g} mm between array and sensor"),
    ]
    return Table("Camera, settings and targets", ("part", "as described"), tuple(rows))


def _target(target: Target) -> str:
    units = {"cycles_per_mm": "cycles/mm", "angle": "rad"}
    values = []
    for field in fields(target):
        value: Any = getattr(target, field.name)
        if isinstance(value, np.ndarray):
            continue
        shown = (
            " to ".join(f"{one:g}" for one in value) if isinstance(value, tuple) else f"{value:g}"
        )
        values.append(
            f"{field.name.replace('cycles_per_mm', 'frequency')} {shown}"
            f" {units.get(field.name, 'mm')}"
        )
    return ", ".join([target.kind, *values])


def simulated_table(bench: Bench) -> Table:
    """The ``simulated`` block of the bench file."""
    block = bench.description.simulated
    truths = "; ".join(f"{name} = {value}" for name, value in block.truths.items())
    faults = "; ".join(
        f"{one.device}: {one.fault} after {one.after} commands" for one in block.faults
    )
    rows = (
        ("seed", str(block.seed)),
        ("planted truths", truths or "none: errors are drawn from the stated uncertainties"),
        ("planted faults", faults or "none"), ("clock", f"{block.clock:g} times real time"),
        ("light", f"{block.electrons_per_second:g} electrons/s at white level"),
        ("full well", f"{block.full_well_electrons:g} electrons"),
        ("read noise", f"{block.read_noise_electrons:g} electrons"),
        ("digits", f"{block.bits} bits, black level {block.black_level:g} DN"),
    )  # fmt: skip
    return Table("Simulated devices", ("property", "value"), rows)


def exposures_table(run: Run) -> Table:
    """One line for every kind of frame: what was shown, how often, how long, how many pixels
    saturated.
    """
    kinds: dict[tuple[str, float, float], list[int]] = {}
    for frame in run.frames:
        target = frame.target if frame.configuration is not None else f"{frame.target} (dark)"
        kinds.setdefault((target, frame.exposure_s, frame.gain), []).append(frame.saturated)
    rows = tuple(
        (
            target,
            number(1e3 * exposure, 4),
            number(gain, 3),
            str(len(saturated)),
            str(max(saturated)),
        )
        for (target, exposure, gain), saturated in sorted(kinds.items())
    )
    return Table(
        "Exposures", ("target", "exposure, ms", "gain", "frames", "most saturated pixels"), rows
    )


def devices_table(run: Run) -> Table:
    """What every device said of itself at the start of the run; empty where nothing was
    recorded.
    """
    devices = [
        cast(Mapping[str, Any], one)
        for one in run.start.get("devices", ())
        if isinstance(one, Mapping)
    ]
    headings = tuple(dict.fromkeys(str(name) for device in devices for name in device))
    rows = tuple(tuple(_text(one.get(name)) for name in headings) for one in devices)
    return Table("What the devices said of themselves", headings, rows)


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_text(one) for one in cast(list[object], value)) or "none"
    return (
        value
        if isinstance(value, str)
        else "none"
        if value is None
        else json.dumps(value, default=str)
    )


def facts_table(caption: str, facts: Mapping[str, Any]) -> Table:
    """Names and values as they were recorded; nested ones joined by dots."""
    return Table(caption, ("what", "recorded"), tuple(_flat(facts)))


def _flat(facts: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in facts.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(cast(Mapping[str, Any], value), f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", _text(value)

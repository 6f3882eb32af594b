"""A recorded run as a calibration: what its pictures make of the bench, in words and as files to go
on with.

A calibration's run is a study's, of which white and dot pictures count; bars may be in it.
"""

import json
import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.calibration.belief import FAR
from flflab.calibration.bench_model import BenchModel, Setting, Stage
from flflab.calibration.fit import BARELY, Fit, Hiding, hidings
from flflab.calibration.from_pictures import Pictures, calibrate
from flflab.calibration.least_squares import Direction
from flflab.calibration.quantities import Quantities
from flflab.digits import plus_minus, two_digits
from flflab.errors import RecordError
from flflab.measurement.sensor.noise import SensorNoise
from flflab.record import FrameRecord, Run
from flflab.study import Study
from flflab.whole_file import write_own
from flflab.yaml_file import edit_yaml, put

Array = npt.NDArray[np.float64]

FILES = ("calibration.json", "calibrated-camera.yaml", "calibrated-bench.yaml")


@dataclass(frozen=True)
class Calibration:
    """What was found, and on what."""

    model: BenchModel
    fit: Fit
    quantities: tuple[Quantities, ...]
    began: float | None = None  # s since 1970, of the run


def calibrate_run(run: Run, study: Study, bench: Bench) -> Calibration:
    """Measure a run's white and dot pictures and fit the bench to them.

    Raises:
        MeasurementError: a configuration has no white frame, or shows no lattice; or there are
            fewer than two.
    """
    axes = {
        name: axis for name, axis in bench.description.axes.items() if axis.moves.endswith(".z")
    }
    stages = tuple(
        Stage(name, axis.moves, axis.sign, axis.zero, axis.zero_uncertainty, axis.scale_uncertainty)
        for name, axis in axes.items()
    )
    moved = {axis.moves for axis in axes.values()}
    settings, pictures = list[Setting](), list[Pictures]()
    for configuration in study.configurations:
        white = _mean(run, configuration.index, "white")
        dots = _mean(run, configuration.index, study.dots.kind)
        if white is None:
            continue
        first = white[2]
        standing = {element: z for element, z in first.worlds.items() if element not in moved}
        settings.append(
            Setting({name: first.readings[name] for name in axes}, standing, first.f_number)
        )
        pictures.append(Pictures(white[0], white[1], *(dots[:2] if dots else (None, None))))
    model = BenchModel(bench.optics, stages, tuple(settings))
    return Calibration(model, *calibrate(model, pictures, study.dots), run.start.get("time"))


def _mean(
    run: Run, configuration: int, target: str
) -> tuple[Array, SensorNoise, FrameRecord] | None:
    """Mean of a configuration's frames of one target, DN, its noise, and the first frame."""
    frames = [
        frame
        for frame in run.frames
        if frame.configuration == configuration and frame.target == target
    ]
    if not frames:
        return None
    picture = np.asarray(
        np.mean([run.picture(frame) for frame in frames], axis=0, dtype=np.float64)
    )
    noise, dark = SensorNoise(**run.sensor_noise), run.dark(frames[0].exposure_s)
    offset = noise.offset_dn if dark is None else float(np.mean(run.picture(dark)))
    count = len(frames)
    noise = replace(
        noise,
        offset_dn=offset,
        dn_per_electron=noise.dn_per_electron / count,
        read_noise_dn=noise.read_noise_dn / count**0.5,
    )
    return picture, noise, frames[0]


def state_calibration(found: Calibration) -> list[str]:
    """What was found and what is not determined, in sentences."""
    fit = found.fit
    dots = sum(math.isfinite(one.values[5]) for one in found.quantities)
    said = [
        f"{fit.count} numbers of {len(found.quantities)} settings, {dots} of them with dots;"
        " reduced chi-square"
        f" {fit.chi2:.2f}{', by which the uncertainties are scaled' if fit.chi2 > 1 else ''}. The"
        " array's pitch and the pixel are taken as exact: they are the rulers across the axis."
    ]
    if fit.chi2 > fit.most_by_noise:
        said.append(
            f"Noise leaves a reduced chi-square of up to {fit.most_by_noise:.2f}: the bench, its"
            f" pitch, pixel or dots are not as the files say. The largest misfit is {fit.farthest};"
            " find out why before you trust a zero."
        )
    for name, value, u, nominal, prior in zip(
        fit.names, fit.values, fit.uncertainty, fit.nominal, fit.prior, strict=True
    ):
        if not math.isfinite(value):
            said.append(f"{name} is not determined by the pictures or by the description.")
        elif math.isfinite(prior) and prior > 0 and abs(value - nominal) > FAR * prior:
            said.append(
                f"{name} differs by {shown(name, value - nominal, u)} from the description,"
                f" {abs(value - nominal) / prior:.1f} times the uncertainty that the bench file"
                " states; correct it there."
            )
    said += [_undetermined(direction) for direction in fit.untold]
    kept = [
        name
        for name, share, u in zip(fit.names, fit.by_pictures, fit.uncertainty, strict=True)
        if share < BARELY and u > 0
    ]
    if kept:
        said.append(f"Known from the description rather than from the pictures: {', '.join(kept)}.")
    said += [_hidden(one) for one in hidings(fit)]
    return said


def shown(name: str, value: float, uncertainty: float = math.nan) -> str:
    """A parameter with its unit, and with its uncertainty where one is given."""
    if not math.isfinite(value):
        return "-"
    if math.isfinite(uncertainty) and uncertainty > 0:
        many, unit = (100.0, "%") if name.endswith(".scale") else (1.0, "mm")
        return f"({plus_minus(many * value, many * uncertainty, '+')}) {unit}"
    return f"{100 * value:+.4f} %" if name.endswith(".scale") else f"{value:+.5f} mm"


def _hidden(one: Hiding) -> str:
    taken = ", ".join(
        f"{name} by {shown(name, shift)} (correlation {both:+.2f})"
        for name, (shift, both) in one.taken.items()
    )
    return (
        f"{one.name} is weakly constrained: an error of {shown(one.name, one.told)} there would"
        f" shift {taken}."
    )


def _undetermined(direction: Direction) -> str:
    """Which values can change together without changing the pictures."""
    if direction.words:
        return f"The pictures do not determine {direction.words}; the bench file's zeros do."
    parts = [f"{name} by {shown(name, change)}" for name, change in direction.parts.items()]
    together = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
    how = (
        ", without changing the pictures"
        if direction.uncertainty > 1e4
        else f"; the pictures limit that to ± {two_digits(direction.uncertainty)} times this change"
    )
    verb = "These values can change together" if len(parts) > 1 else "This value can change"
    return f"{verb}{how}: {together}. The bench file's zeros fix them."


def require_unwritten(folder: Path) -> None:
    """Refuse a folder that holds a calibration's files.

    Raises:
        RecordError: one of them is there already.
    """
    for name in FILES:
        if (folder / name).exists():
            raise RecordError(
                f"{folder / name} is there already and is not overwritten; move it away first"
            )


def calibration_numbers(found: Calibration) -> dict[str, Any]:
    """What ``calibration.json`` holds; mm and shares, None for what is not determined."""
    fit = found.fit
    return {
        "parameters": list(fit.names), "described": fit.nominal.tolist(),
        "described_uncertainty": _plain(fit.prior),
        "values": _plain(fit.values), "uncertainties": _plain(fit.uncertainty),
        "covariance": [_plain(row) for row in fit.covariance],
        "told_by_pictures": fit.by_pictures.tolist(), "reduced_chi_square": fit.chi2,
        "numbers": fit.count,
        "untold": [{"changes": direction.parts,
        "uncertainty": _number(direction.uncertainty)} for direction in fit.untold],
        "sentences": state_calibration(found),
    }  # fmt: skip


def write_calibration(found: Calibration, bench: Bench, folder: Path) -> tuple[Path, Path, Path]:
    """Write ``calibration.json``, ``calibrated-camera.yaml`` and ``calibrated-bench.yaml``; an
    existing file is never overwritten.

    Raises:
        RecordError: one of them is there already.
        InputError: one cannot be written.
    """
    camera, described = bench_files(found, bench)
    require_unwritten(folder)
    for name, text in zip(
        FILES,
        (json.dumps(calibration_numbers(found), indent=1) + "\n", camera, described),
        strict=True,
    ):
        write_own(folder / name, text)
    written = [folder / name for name in FILES]
    return written[0], written[1], written[2]


def bench_files(found: Calibration, bench: Bench) -> tuple[str, str]:
    """Camera file and bench file with what was found; what was not determined stays as described,
    and a comment says so.
    """
    fit = found.fit
    comments = [f"# {name}: {_commented(fit, name)}" for name in fit.names]
    optics = bench.file.parent / bench.description.optics
    head = (
        "# Written by `flflab calibrate`: what was described, what was found, standard"
        " uncertainties (of zeros and scales: errors).\n"
    )
    listed = head + "\n".join(comments) + "\n"
    camera = edit_yaml(
        optics.read_text(encoding="utf-8"), str(optics), lambda data: _put_optics(data, fit, bench)
    )
    described = edit_yaml(
        bench.file.read_text(encoding="utf-8"),
        str(bench.file),
        lambda data: _put_bench(data, found),
    )
    return listed + camera, listed + described


def _put_optics(camera: Any, fit: Fit, bench: Bench) -> None:
    """Put what was found of the optics into a camera file's fields."""

    def put_length(where: Any, key: str, name: str) -> None:
        value, _ = fit.value(name)
        if math.isfinite(value):
            put(where, key, f"{value:.6f} mm")

    lens, array, sensor = camera["main_lens"], camera["microlens_array"], camera["sensor"]
    put_length(lens, "focal_length", "main_lens.focal_length")
    if len(bench.optics.array.focal_lengths) == 1:
        put_length(array, "focal_length", "microlens_array.focal_length")
        for other in ("radius_of_curvature", "refractive_index", "numerical_aperture"):
            array.pop(other, None)
    put_length(array, "aperture", "microlens_array.aperture")
    for part, owner in ((array, "microlens_array"), (sensor, "sensor")):
        values = [fit.value(f"{owner}.offset.{axis}")[0] for axis in "xy"]
        if np.all(np.isfinite(values)):
            put(part, "offset", [f"{value:.6f} mm" for value in values])


def _put_bench(data: Any, found: Calibration) -> None:
    """Put what was found of stages and iris into a bench file's fields."""
    for stage in found.model.stages:
        value, u = found.fit.value(f"{stage.name}.zero")
        if math.isfinite(value):
            put(data["axes"][stage.name], "zero", f"{stage.zero + value:.6f} mm")
            put(data["axes"][stage.name], "zero_uncertainty", f"{u:.3g} mm")
    data["optics"] = "calibrated-camera.yaml"
    if found.began is not None:
        put(data, "calibrated", datetime.fromtimestamp(found.began, UTC).date().isoformat())
    if data.get("optics_uncertainty") is None:
        data.pop("optics_uncertainty", None)
        put(data, "optics_uncertainty", {})
    for key, share in _shares(found.fit).items():
        put(data["optics_uncertainty"], key, share)


def _shares(fit: Fit) -> dict[str, float]:
    """Standard uncertainties of the optics as shares, where they were found; the iris's error,
    which nothing corrects, counts as one.
    """
    names = {
        "main_lens_focal_length": "main_lens.focal_length",
        "microlens_focal_length": "microlens_array.focal_length",
        "microlens_aperture": "microlens_array.aperture",
    }
    found = {
        key: u / value
        for key, name in names.items()
        for value, u in [fit.value(name)]
        if math.isfinite(value)
    }
    iris, u = fit.value("iris.scale")
    found |= {"f_number": math.hypot(iris, u)} if math.isfinite(iris) else {}
    return {key: float(f"{share:.3g}") for key, share in found.items()}


def _commented(fit: Fit, name: str) -> str:
    place = fit.names.index(name)
    (value, u), prior = fit.value(name), float(fit.prior[place])
    known = f" (u {shown(name, prior)[1:]})" if math.isfinite(prior) else ""
    found = (
        f"found {shown(name, value)}, u {shown(name, u)[1:]}"
        if math.isfinite(value)
        else "not determined, left as described"
    )
    return (
        f"described {shown(name, float(fit.nominal[place]))}{known}, {found},"
        f" {100 * fit.by_pictures[place]:.0f} % by the pictures"
    )


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _plain(values: Array) -> list[float | None]:
    return [_number(float(value)) for value in values]

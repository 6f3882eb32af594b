"""From a run's frames to a comparison: measure every configuration, predict it, set both side by side.

Reads a record, never a bench: the same function serves a run that just ended and one from years ago.
"""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.analysis.contrast import ContrastCurve, fit_contrast
from flflab.analysis.dots import DotViews, count_views
from flflab.analysis.lattice import Lattice, find_lattice
from flflab.analysis.noise import SensorNoise
from flflab.bench import Bench, Element
from flflab.comparison import Comparison, Row, count_spread, judge, z_score
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.optics.contrast import contrast_paper, disc_transfer
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.prediction import contrast_draws, placements, predicted_view_indices, stage_errors, view_draws
from flflab.record import FrameRecord, Run
from flflab.study import Configuration, Study

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """What the frames of one configuration show, and what else was recorded with them."""

    configuration: Configuration
    worlds: dict[Element, float]
    lattice: Lattice
    dots: tuple[DotViews, ...]
    curve: ContrastCurve
    exposure_s: float
    saturated: int


@dataclass(frozen=True)
class Predicted:
    """What the model says of one configuration where the stages stood.

    Attributes:
        camera: the camera with the distances that the stages read.
        distance: main lens to target, mm.
        views: nominal number of views of each dot, shape (4,).
        view_draws: the same for each draw of the stage errors, shape (draws, 4).
        view_indices: positions of the microlenses that see each dot.
        contrast_draws: contrast at the measured frequencies for each draw, shape (draws, K).
        blur_px: diameter of the geometric blur, pixels.
    """

    camera: Camera
    distance: float
    views: npt.NDArray[np.int64]
    view_draws: npt.NDArray[np.int64]
    view_indices: tuple[npt.NDArray[np.int64], ...]
    contrast_draws: Array
    blur_px: float


@dataclass(frozen=True)
class Evaluation:
    """A run, measured and predicted and compared."""

    measured: tuple[Measured, ...]
    predicted: tuple[Predicted, ...]
    comparison: Comparison


def evaluate(run: Run, study: Study, bench: Bench, seed: int = 0) -> Evaluation:
    """Measure and predict every configuration of a run, and compare.

    Args:
        run: the record.
        study: the study as recorded with it.
        bench: the bench as recorded with it.
        seed: of the draws behind uncertainties and verdicts.

    Raises:
        MeasurementError: a configuration's frames are missing or do not show what they should.
    """
    # The measurement's kernels let other threads run, so every core measures a configuration of its own.
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        measured = tuple(pool.map(lambda configuration: measure_configuration(run, configuration, study, bench), study.configurations))
    rng = np.random.Generator(np.random.Philox(key=seed))
    errors = stage_errors(bench, study.description.draws, rng)
    predicted = tuple(predict(one, study, bench, errors) for one in measured)
    return Evaluation(measured, predicted, compare(measured, predicted, study, rng))


def _mean_picture(run: Run, configuration: Configuration, target: str) -> tuple[Array, tuple[FrameRecord, ...]]:
    """Mean of a configuration's frames of one target, DN, and the frames."""
    frames = tuple(frame for frame in run.frames if frame.configuration == configuration.index and frame.target == target)
    if not frames:
        raise MeasurementError(
            f"run {run.folder}: configuration {configuration.index} has no {target} frame; the run stopped before it was taken"
        )
    total = run.picture(frames[0]).astype(np.float64)
    for frame in frames[1:]:
        total += run.picture(frame)
    return total / len(frames), frames


def sensor_noise(run: Run, exposure_s: float) -> SensorNoise:
    """What the camera says of its noise, with the black level of the dark frame where one was taken at that exposure."""
    noise = SensorNoise(**run.sensor_noise)
    dark = run.dark(exposure_s)
    return replace(noise, offset_dn=float(np.mean(run.picture(dark)))) if dark else noise


def averaged(noise: SensorNoise, frames: int) -> SensorNoise:
    """The noise of a mean of several frames."""
    return replace(noise, dn_per_electron=noise.dn_per_electron / frames, read_noise_dn=noise.read_noise_dn / frames**0.5)


def measure_configuration(run: Run, configuration: Configuration, study: Study, bench: Bench) -> Measured:
    """Lattice, views and contrast of one configuration of a run, from the means of its frames."""
    pictures, frames = {}, {}
    for target in ("white", "four-dot", "bars"):
        pictures[target], frames[target] = _mean_picture(run, configuration, target)
    first = frames["four-dot"][0]
    return measure_pictures(
        pictures,
        {target: averaged(sensor_noise(run, taken[0].exposure_s), len(taken)) for target, taken in frames.items()},
        configuration,
        first.worlds,
        study,
        bench.optics,
        first.exposure_s,
        max(frame.saturated for taken in frames.values() for frame in taken),
    )


def measure_pictures(
    pictures: Mapping[str, Array],
    noises: Mapping[str, SensorNoise],
    configuration: Configuration,
    worlds: dict[Element, float],
    study: Study,
    optics: Camera,
    exposure_s: float = 0.0,
    saturated: int = 0,
) -> Measured:
    """Lattice from the white picture, views from the dots, contrast from the bars.

    Args:
        pictures: DN, [row, col], by target: white, four-dot, bars.
        noises: the noise of each.
        configuration: what was asked for.
        worlds: where the stages said the elements stood, mm.
        study: whose targets were shown.
        optics: the bench's camera.
        exposure_s: as recorded, s.
        saturated: most saturated pixels in one frame.
    """
    camera, distance = as_placed(configuration, optics, worlds)
    rough = camera.array.pitch[0] * float(central_smms(camera).image_scale) / camera.sensor.pixel
    white = pictures["white"]
    lattice = find_lattice(white, camera.array.layout, rough, noises["white"])
    return Measured(
        configuration=configuration,
        worlds=worlds,
        lattice=lattice,
        dots=count_views(pictures["four-dot"], white, lattice, camera, study.dots, distance, noises["four-dot"]),
        curve=fit_contrast(pictures["bars"], lattice, camera, study.bars, distance, noises["bars"]),
        exposure_s=exposure_s,
        saturated=saturated,
    )


def as_placed(configuration: Configuration, optics: Camera, worlds: dict[Element, float]) -> tuple[Camera, float]:
    """The nominal camera with the elements where the stages said they stood, and the target's distance, mm."""
    lens = worlds["main_lens.z"]
    placed = replace(configuration, array=worlds["array.z"] - lens, sensor=worlds["sensor.z"] - lens)
    return placed.camera(optics), lens - worlds["target.z"]


def predict(measured: Measured, study: Study, bench: Bench, errors: dict[Element, tuple[Array, Array]]) -> Predicted:
    """What the model expects of a configuration, nominally and over draws of the stage errors."""
    camera, distance = as_placed(measured.configuration, bench.optics, measured.worlds)
    placement = placements(bench, measured.worlds, errors)
    points = study.dots.centres
    indices = tuple(predicted_view_indices(camera, distance, points))
    return Predicted(
        camera=camera,
        distance=distance,
        views=np.array([len(seen) for seen in indices]),
        view_draws=view_draws(camera, placement, points),
        view_indices=indices,
        contrast_draws=contrast_draws(camera, placement, measured.curve.cycles_per_mm),
        blur_px=float(blur(central_smms(camera), 1 / distance)) / camera.sensor.pixel,
    )


def compare(measured: tuple[Measured, ...], predicted: tuple[Predicted, ...], study: Study, rng: np.random.Generator) -> Comparison:
    """Rows of every configuration and between each and the reference, and the verdicts on views and MTF.

    The two verdicts share the study's significance equally, so that an honest bench is rejected no more often than it says.
    """
    rows: list[Row] = []
    for one, model in zip(measured, predicted, strict=True):
        rows += _view_rows(one, model) + _mtf_rows(one, model)
    reference = study.description.reference
    for one, model in zip(measured, predicted, strict=True):
        if one.configuration.index != reference:
            rows += _difference_rows(one, model, measured[reference], predicted[reference])
    threshold = study.description.significance / 2
    contrasts = np.concatenate([one.curve.contrast for one in measured])
    noise = _block_diagonal([one.curve.covariance for one in measured])
    verdicts = [judge("mtf", contrasts, noise, np.concatenate([model.contrast_draws for model in predicted], axis=1), threshold, rng)]
    counts = np.array([dot.views for one in measured for dot in one.dots], dtype=np.float64)
    doubts = np.diag([_count_doubt(dot) ** 2 for one in measured for dot in one.dots])
    draws = np.concatenate([model.view_draws for model in predicted], axis=1).astype(np.float64)
    verdicts.append(judge("views", counts, doubts, draws, threshold, rng))
    return Comparison(tuple(rows), tuple(verdicts))


def _count_doubt(dot: DotViews) -> float:
    """Standard uncertainty of a measured count: each undecided view is one or none, and a sure count is sure to 1 in 400."""
    return float(np.sqrt(dot.views_uncertain / 4 + 1 / 400))


def _block_diagonal(blocks: list[Array]) -> Array:
    size = sum(len(block) for block in blocks)
    whole = np.zeros((size, size))
    start = 0
    for block in blocks:
        whole[start : start + len(block), start : start + len(block)] = block
        start += len(block)
    return whole


def _row(
    one: Measured, model: Predicted, quantity: str, measured: float, uncertainty: float, predicted: float, **where: float | int | str | None
) -> Row:
    difference = measured - predicted
    return Row(
        configuration=one.configuration.index,
        reference_configuration=where.get("reference"),  # pyright: ignore[reportArgumentType]
        distance_mm=model.distance,
        array_mm=model.camera.array.distance,
        sensor_mm=model.camera.sensor.distance,
        f_number=one.configuration.f_number,
        target=str(where["target"]),
        dot=where.get("dot"),  # pyright: ignore[reportArgumentType]
        cycles_per_mm=where.get("cycles_per_mm"),  # pyright: ignore[reportArgumentType]
        quantity=quantity,
        measured=measured,
        uncertainty=uncertainty,
        predicted=predicted,
        difference=difference,
        z=z_score(difference, uncertainty),
    )


def _view_rows(one: Measured, model: Predicted) -> list[Row]:
    spread = count_spread(model.view_draws, model.views)
    return [
        _row(
            one,
            model,
            "views",
            dot.views,
            float(np.hypot(spread[dot.dot], _count_doubt(dot))),
            int(model.views[dot.dot]),
            target="four-dot",
            dot=dot.dot,
        )
        for dot in one.dots
    ]


def _mtf_rows(one: Measured, model: Predicted) -> list[Row]:
    curve = one.curve
    mean, spread = model.contrast_draws.mean(axis=0), model.contrast_draws.std(axis=0, ddof=1)
    sigma = np.sqrt(np.diag(curve.covariance) + spread**2)
    rows = [
        _row(one, model, "mtf", float(curve.contrast[k]), float(sigma[k]), float(mean[k]), target="bars", cycles_per_mm=float(frequency))
        for k, frequency in enumerate(curve.cycles_per_mm)
    ]
    if model.blur_px <= 1:
        rows += _paper_rows(one, model)
    return rows


def _paper_rows(one: Measured, model: Predicted) -> list[Row]:
    """The paper's curve, which knows no blur and is claimed inside the depth of field only.

    What a blur of up to one pixel takes away there is the model's own slack: a rectangular distribution from none to all of it.
    """
    curve, pixel = one.curve, model.camera.sensor.pixel
    cycles_per_px = curve.cycles_per_mm / float(magnification(central_smms(model.camera), 1 / model.distance)) * pixel
    claimed = contrast_paper(cycles_per_px)
    slack = claimed * (1 - disc_transfer(1.0, cycles_per_px)) / 3**0.5
    sigma = np.sqrt(curve.extremes_uncertainty**2 + slack**2)
    return [
        _row(
            one,
            model,
            "contrast_paper",
            float(curve.extremes[k]),
            float(sigma[k]),
            float(claimed[k]),
            target="bars",
            cycles_per_mm=float(nu),
        )
        for k, nu in enumerate(curve.cycles_per_mm)
    ]


def _difference_rows(one: Measured, model: Predicted, other: Measured, other_model: Predicted) -> list[Row]:
    """Differences of views and ratios of MTF against the reference; common stage errors cancel in the joint draws."""
    reference = other.configuration.index
    expected = model.views - other_model.views
    spread = count_spread(model.view_draws - other_model.view_draws, expected)
    rows = [
        _row(
            one, model, "difference_views", mine.views - theirs.views,
            float(np.sqrt(spread[mine.dot] ** 2 + _count_doubt(mine) ** 2 + _count_doubt(theirs) ** 2)),
            int(expected[mine.dot]), target="four-dot", dot=mine.dot, reference=reference,
        )
        for mine, theirs in zip(one.dots, other.dots, strict=True)
    ]  # fmt: skip
    mine_sigma, their_sigma = (np.sqrt(np.diag(curve.covariance)) for curve in (one.curve, other.curve))
    for k, frequency in enumerate(one.curve.cycles_per_mm):
        same = np.flatnonzero(np.isclose(other.curve.cycles_per_mm, frequency, rtol=1e-9))
        if len(same) == 0:
            continue
        j = int(same[0])
        theirs, their_draws = float(other.curve.contrast[j]), other_model.contrast_draws[:, j]
        their_spread = float(np.hypot(their_sigma[j], their_draws.std()))
        if min(abs(theirs), abs(float(their_draws.mean()))) < 5 * their_spread:
            # A ratio over a contrast that may be 0 has no useful distribution.
            continue
        ratio, ratios = float(one.curve.contrast[k]) / theirs, model.contrast_draws[:, k] / their_draws
        noise = np.hypot(mine_sigma[k], ratio * their_sigma[j]) / abs(theirs)
        sigma = float(np.hypot(noise, ratios.std(ddof=1)))
        rows.append(
            _row(
                one,
                model,
                "ratio_mtf",
                ratio,
                sigma,
                float(ratios.mean()),
                target="bars",
                cycles_per_mm=float(frequency),
                reference=reference,
            )
        )
    return rows

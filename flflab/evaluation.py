"""From a run's frames to a comparison: measure every configuration, predict it, set both side by side.

Reads a record, never a bench: the same function serves a run that just ended and one from years ago.
"""

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
from flflab.optics.contrast import contrast_paper
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.prediction import contrast_draws, placements, predicted_view_indices, stage_errors, view_draws
from flflab.record import FrameRecord, Run
from flflab.study import Configuration, Study
from flflab.targets import FourDot

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
    measured = tuple(measure_configuration(run, configuration, study, bench) for configuration in study.configurations)
    rng = np.random.Generator(np.random.Philox(key=seed))
    errors = stage_errors(bench, study.description.draws, rng)
    predicted = tuple(_predict(one, study, bench, errors) for one in measured)
    return Evaluation(measured, predicted, compare(measured, predicted, study, rng))


def _frames(run: Run, configuration: Configuration, target: str) -> list[FrameRecord]:
    found = [frame for frame in run.frames if frame.configuration == configuration.index and frame.target == target]
    if not found:
        raise MeasurementError(
            f"run {run.folder}: configuration {configuration.index} has no {target} frame; the run stopped before it was taken"
        )
    return found


def _mean_picture(run: Run, frames: list[FrameRecord]) -> Array:
    total = np.zeros(run.picture(frames[0]).shape)
    for frame in frames:
        total += run.picture(frame)
    return total / len(frames)


def measure_configuration(run: Run, configuration: Configuration, study: Study, bench: Bench) -> Measured:
    """Lattice from the white frames, views from the dots, contrast from the bars, of one configuration."""
    whites = _frames(run, configuration, "white")
    dots, bars = _frames(run, configuration, study.dots.kind), _frames(run, configuration, study.bars.kind)
    noise = SensorNoise(**run.sensor_noise)
    averaged = replace(noise, dn_per_electron=noise.dn_per_electron / len(bars), read_noise_dn=noise.read_noise_dn / len(bars) ** 0.5)
    worlds = dots[0].worlds
    camera, distance = _as_placed(configuration, bench, worlds)
    white = _mean_picture(run, whites)
    rough = camera.array.pitch[0] * float(central_smms(camera).image_scale) / camera.sensor.pixel
    lattice = find_lattice(white, camera.array.layout, rough, noise)
    pictures = _mean_picture(run, dots), _mean_picture(run, bars)
    return Measured(
        configuration=configuration,
        worlds=worlds,
        lattice=lattice,
        dots=count_views(pictures[0], white, lattice, camera, study.dots, distance, noise),
        curve=fit_contrast(pictures[1], lattice, camera, study.bars, distance, averaged),
        exposure_s=dots[0].exposure_s,
        saturated=max(int(np.count_nonzero(noise.saturated(run.picture(frame)))) for frame in (*whites, *dots, *bars)),
    )


def _as_placed(configuration: Configuration, bench: Bench, worlds: dict[Element, float]) -> tuple[Camera, float]:
    """The nominal camera with the elements where the stages said they stood, and the target's distance, mm."""
    lens = worlds["main_lens.z"]
    placed = replace(configuration, array=worlds["array.z"] - lens, sensor=worlds["sensor.z"] - lens)
    return placed.camera(bench.optics), lens - worlds["target.z"]


def _predict(measured: Measured, study: Study, bench: Bench, errors: dict[Element, tuple[Array, Array]]) -> Predicted:
    camera, distance = _as_placed(measured.configuration, bench, measured.worlds)
    placement = placements(bench, measured.worlds, errors)
    points = study.dots.centres if isinstance(study.dots, FourDot) else np.zeros((0, 2))
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


def _row(one: Measured, model: Predicted, quantity: str, measured: float, uncertainty: float, predicted: float, **where: float | int | str | None) -> Row:
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
        _row(one, model, "views", dot.views, float(np.hypot(spread[dot.dot], _count_doubt(dot))), int(model.views[dot.dot]), target="four-dot", dot=dot.dot)
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
        # The paper's curve knows no blur: it is claimed inside the depth of field only.
        enlarged = float(magnification(central_smms(model.camera), 1 / model.distance))
        claimed = contrast_paper(curve.cycles_per_mm / enlarged * model.camera.sensor.pixel)
        rows += [
            _row(one, model, "contrast_paper", float(curve.classic[k]), float(curve.classic_uncertainty[k]), float(claimed[k]), target="bars", cycles_per_mm=float(frequency))
            for k, frequency in enumerate(curve.cycles_per_mm)
            if np.isfinite(curve.classic[k])
        ]
    return rows


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
        rows.append(_row(one, model, "ratio_mtf", ratio, sigma, float(ratios.mean()), target="bars", cycles_per_mm=float(frequency), reference=reference))
    return rows

"""A small run in numbers made by hand: three configurations of a small camera, drawn frames, no
device and no fit behind them.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import Bench, Element, read_bench
from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.dots.views import DotViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import target_scales
from flflab.optics.resolution import central_smms
from flflab.record import FrameRecord, Recording, Run
from flflab.report.frames import predicted_view_places
from flflab.study import Configuration, Study, read_study
from flflab.verdict.comparison import Comparison, Row, Verdict
from flflab.verdict.evaluation import Evaluation, evaluate_measured, properties
from flflab.verdict.prediction import drawn_systems, placements, predicted_view_indices
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted
from flflab.verdict.sources import drawn_errors
from flflab.verdict.visible import Visible

COLUMNS, ROWS, PIXEL = 420, 300, 6.8e-3
FREQUENCIES = np.array([0.5, 2.0, 4.0, 6.0])


VISIBLE = (Visible("pixel size", 0.012, "%"), Visible("roll of the target", math.inf, "deg"))


@pytest.fixture(scope="session")
def bench(root: Path) -> Bench:
    """The built-in bench with a sensor of few, large pixels."""
    whole = read_bench(root / "examples" / "benches" / "simulated.yaml")
    sensor = replace(whole.optics.sensor, resolution=(COLUMNS, ROWS), pixel=PIXEL)
    return replace(whole, optics=replace(whole.optics, sensor=sensor))


@pytest.fixture(scope="session")
def study(root: Path, bench: Bench) -> Study:
    """Three configurations of the built-in study."""
    whole = read_study(root / "examples" / "studies" / "first.yaml", bench.optics)
    return replace(whole, configurations=whole.configurations[:3])


def lattice_of(configuration: Configuration, bench: Bench) -> Lattice:
    """The lattice where the model puts it, moved sideways by (1.5, -2) px: where the array stands
    sideways is not known before.
    """
    camera = configuration.camera(bench.optics)
    smms = central_smms(camera)
    pitch = float(camera.array.pitch[0] * smms.image_scale / PIXEL)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(-3, 4), np.arange(-2, 3)))
    origin = np.array([(COLUMNS - 1) / 2 + 1.5, (ROWS - 1) / 2 - 2], dtype=np.float64)
    indices = np.stack([i, j], axis=1).astype(np.int64)
    return Lattice(
        layout="square", pitch_px=pitch, angle=0.0, origin_px=origin, vectors_px=pitch * np.eye(2),
        indices=indices,
        centres_px=origin + pitch * indices.astype(np.float64),
        inside_radius_px=float(smms.inside_radius) / PIXEL,
        outside_radius_px=float(smms.outside_radius) / PIXEL, pitch_uncertainty_px=2e-4,
        angle_uncertainty=1e-6,
        origin_uncertainty_px=np.full(2, 1e-3), inside_uncertainty_px=2e-3,
        outside_uncertainty_px=1e-3,
        covariance_px=np.eye(6) * 1e-6, sizes_covariance_px=np.diag([2e-3, 1e-3, 2e-4]) ** 2,

        light=np.eye(6)[0] * 2000,
    )  # fmt: skip


def worlds_of(configuration: Configuration) -> dict[Element, float]:
    return {
        "main_lens.z": 0.0,
        "array.z": configuration.array,
        "sensor.z": configuration.sensor,
        "target.z": -configuration.distance,
    }


def predict(configuration: Configuration, bench: Bench, study: Study) -> Predicted:
    camera = configuration.camera(bench.optics)
    indices = tuple(predicted_view_indices(camera, configuration.distance, study.dots.centres))
    views = np.array([len(seen) for seen in indices])
    falling = 1 - FREQUENCIES / 10
    draws = falling + 0.01 * np.linspace(-1, 1, 101)[:, None]
    errors = drawn_errors(bench, 101, np.random.default_rng(0))
    placement = placements(bench, worlds_of(configuration), errors)
    systems = drawn_systems(central_smms(camera), camera, placement)
    pitches = camera.array.pitch[0] * systems.image_scale
    return Predicted(
        camera, configuration.distance, views, np.tile(views, (101, 1)), indices, draws,
        np.ones(draws.shape[1]), 0.3,
        systems, 1 / placement.distance, systems.inside_radius, systems.outside_radius, pitches,
        np.ones(101), np.zeros((101, 3)), np.zeros((101, 4)), np.zeros((101, 4)), np.ones(101),
        np.ones(101), np.zeros(101), np.zeros((101, 0)),
    )  # fmt: skip


def measure(
    configuration: Configuration, model: Predicted, lattice: Lattice, study: Study
) -> Measured:
    dots: list[DotViews] = []
    for dot, centre in enumerate(study.dots.centres):
        indices, places = predicted_view_places(model, lattice, dot, centre)
        count = len(indices)
        position = np.array([*centre, -configuration.distance])
        dots.append(
            DotViews(
                dot,
                count,
                0,
                indices,
                places,
                np.full((count, 2), 0.05),
                position,
                np.full(3, 0.1),
                np.zeros((3, 9)),
            )
        )
    zeros = np.zeros(len(FREQUENCIES))
    across, _ = target_scales(model.camera, configuration.distance)
    curve = ContrastCurve(
        focal_length=0.917, views=np.zeros(1, dtype=np.int64),
        views_contrast=np.full((1, len(FREQUENCIES)), np.nan),
        views_uncertainty=np.full((1, len(FREQUENCIES)), np.nan),
        views_share=np.ones((1, len(FREQUENCIES))),
        cycles_per_mm=FREQUENCIES, cycles_per_px=FREQUENCIES / 10, contrast=1 - FREQUENCIES / 10,
        covariance=1e-6 * np.eye(len(FREQUENCIES)), extremes=zeros, extremes_uncertainty=zeros,
        classic=zeros + 0.9,
        geometry=np.array([0.0, across, 0.0, 1.0, 0.0]),
        geometry_uncertainty=np.zeros(5), chi2_per_pixel=1.0, pixels=1000,
    )  # fmt: skip
    return Measured(
        configuration, worlds_of(configuration), lattice, None, tuple(dots), curve, 0.0125, 0
    )


def rows_of(one: Measured, reference: int) -> list[Row]:
    index, rows = one.configuration.index, list[Row]()

    def row(
        quantity: str,
        value: float,
        dot: int | None,
        frequency: float | None,
        against: int | None = None,
    ) -> Row:
        setting = one.configuration
        return Row(
            index, against, setting.distance, setting.array, setting.sensor, setting.f_number,
            "four-dot" if frequency is None else "bars",
            dot, frequency, quantity, value, 0.05, value, 0.0, 0.0,
        )  # fmt: skip

    for dot in one.dots:
        rows.append(row("views", dot.views, dot.dot, None))
        if index != reference:
            rows.append(row("difference_views", 0, dot.dot, None, reference))
    for frequency in FREQUENCIES:
        rows += [
            row("mtf", 1 - frequency / 10, None, frequency),
            row("contrast_paper", 1, None, frequency),
        ]
        if index != reference:
            rows.append(row("ratio_mtf", 1, None, frequency, reference))
    return rows


def never_rejected(study: Study) -> Study:
    """Of few draws, and nothing rejects: no cause is looked for."""
    update = {"draws": 450, "significance": 1e-9}
    return replace(study, description=study.description.model_copy(update=update))


@pytest.fixture(scope="session")
def lenient(study: Study) -> Study:
    """The study, which rejects nothing."""
    return never_rejected(study)


@pytest.fixture(scope="session")
def evaluation(bench: Bench, study: Study) -> Evaluation:
    """Measured exactly as predicted."""
    predicted = tuple(
        predict(configuration, bench, study) for configuration in study.configurations
    )
    measured = tuple(
        measure(configuration, model, lattice_of(configuration, bench), study)
        for configuration, model in zip(study.configurations, predicted, strict=True)
    )
    rows = tuple(row for one in measured for row in rows_of(one, study.description.reference))
    verdicts = (
        Verdict(
            "mtf", 12, 0.41, 200, 1.7, 0.025, True, "contrast (MTF): 12 values agree with the model"
        ),
        Verdict(
            "views",
            12,
            0.97,
            200,
            0.4,
            0.025,
            True,
            "number of views: 12 values agree with the model",
        ),
    )
    values = properties(measured, predicted, bench)
    budgets = evaluate_measured(measured, never_rejected(study), bench).budgets
    return Evaluation(measured, predicted, Comparison(rows, verdicts), values, budgets, (), VISIBLE)


@pytest.fixture(scope="session")
def single(evaluation: Evaluation) -> Evaluation:
    """The first configuration alone."""
    rows = tuple(
        row
        for row in evaluation.comparison.rows
        if row.configuration == 0 and row.reference_configuration is None
    )
    values = tuple(one for one in evaluation.values if one.configuration == 0)
    comparison = Comparison(rows, evaluation.comparison.verdicts)
    return Evaluation(
        evaluation.measured[:1],
        evaluation.predicted[:1],
        comparison,
        values,
        tuple(one for one in evaluation.budgets if one.configuration == 0 and not one.reference),
        suspects=(),
        visible=VISIBLE,
    )


@pytest.fixture(scope="session")
def run(bench: Bench, study: Study, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The record of that run: a white, a dots' and a bars' frame of each configuration, and a dark
    one.
    """
    folder = tmp_path_factory.mktemp("20261121T040000Z-first")
    recording = Recording(folder, 10, (ROWS, COLUMNS))
    column = np.arange(COLUMNS)[None, :] + np.zeros((ROWS, 1))
    pictures = {
        "white": np.full_like(column, 2000.0),
        "four-dot": 64.0 + 10 * (column % 60),
        "bars": 1000 * (1 + np.sin(column)),
    }
    frames: list[FrameRecord] = []
    for setting in study.configurations:
        worlds = {
            "main_lens.z": 0.0,
            "array.z": setting.array,
            "sensor.z": setting.sensor,
            "target.z": -setting.distance,
        }
        readings = {
            name: axis.reading(worlds[axis.moves]) for name, axis in bench.description.axes.items()
        }
        for target, picture in pictures.items():
            place = recording.frame(picture.astype(np.uint16))
            frames.append(
                FrameRecord(
                    f"c{setting.index}/{target}/0", setting.index, target, 0, setting.f_number,
                    readings, worlds, 0.0125, 1.0, 0, place,  # pyright: ignore[reportArgumentType]
                    place, 1.8e9 + place,
                )
            )  # fmt: skip
    recording.close()
    start = {
        "uid": "a-uid", "time": 1.8e9, "seed": 7, "plan_name": "validate", "study": "first",
        "software": {"python": "3.11.7", "numpy": "2.4.6"},
        "devices": [{"name": "camera", "identity": "<script>alert('x')</script>",
        "position": None}],
    }  # fmt: skip
    return Run(folder, start, tuple(frames), {"time": 1.8e9 + 60, "exit_status": "success"})

"""Are the stated uncertainties true? Many small simulated benches, each with its own hidden errors of stages, angles and light, no wire.

The hidden errors are drawn here, by this file's own generator; the analysis knows only the bench file's uncertainties.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from flflab.analysis.noise import SensorNoise
from flflab.bench import Bench, Element, read_bench
from flflab.comparison import Comparison
from flflab.diagnosis import not_told_apart
from flflab.evaluation import Evaluation, evaluate_measured
from flflab.image.exposure import white_irradiance
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera
from flflab.prediction import attitude_uncertainty
from flflab.properties.measured import measure_pictures
from flflab.study import Configuration, ConfigurationsDescription, Study, StudyDescription, expand
from flflab.targets import Bars, FourDot, Target, White

BENCH = Path(__file__).parents[2] / "examples" / "benches" / "simulated.yaml"
GAIN, READ_NOISE_E, OFFSET, FULL_SCALE, WHITE_E = 4095 / 12000, 3.0, 64.0, 4095.0, 8000.0
NOISE = SensorNoise(GAIN, READ_NOISE_E * GAIN, OFFSET, FULL_SCALE)
Change = Callable[[Camera], Camera]
ELEMENTS: tuple[Element, ...] = ("main_lens.z", "array.z", "sensor.z", "target.z")


def small_bench() -> Bench:
    """The built-in bench with a sensor of 760 x 560 pixels and the microlenses before it."""
    bench = read_bench(BENCH)
    optics = replace(
        bench.optics, sensor=replace(bench.optics.sensor, resolution=(760, 560)), array=replace(bench.optics.array, count=(7, 7))
    )
    return replace(bench, optics=optics)


def small_study(bench: Bench) -> Study:
    """In focus at two f-numbers, and two points through focus."""
    description = StudyDescription(
        name="small",
        configurations=[
            ConfigurationsDescription.model_validate({"f_number": [2.8, 4], "distance": "507 mm"}),
            ConfigurationsDescription.model_validate({"f_number": 4, "distance": ["500 mm", "515 mm"], "focused_at": "507 mm"}),
        ],
        draws=1000,
    )
    return Study(description, expand(description, bench.optics), FourDot(1.0, 4.0), Bars((0.5, 10.0), 12.0, 8.0))


def picture(
    camera: Camera, configuration: Configuration, errors: dict[Element, float], target: Target, rng: np.random.Generator, electrons: float
) -> npt.NDArray[np.float64]:
    """What a camera records whose elements stand off by these errors (mm), ``electrons`` those of full light."""
    lens, array, sensor, away = (errors[element] for element in ELEMENTS)
    true = replace(
        camera,
        array=replace(camera.array, distance=configuration.array + array - lens),
        sensor=replace(camera.sensor, distance=configuration.sensor + sensor - lens),
    )
    light = np.maximum(
        render(one_plane(true, target, configuration.distance - away + lens), tolerance=3e-5 if target == White() else 2e-4), 0.0
    )
    caught = rng.poisson(light * electrons * white_irradiance(true)) + rng.normal(0.0, READ_NOISE_E, light.shape)
    return np.clip(np.rint(caught * GAIN + OFFSET), 0, FULL_SCALE)


def with_turned_array(camera: Camera, roll: float, yaw: float, pitch: float) -> Camera:
    array = camera.array
    tilt = (array.tilt[0] + math.tan(yaw), array.tilt[1] + math.tan(pitch))
    return replace(camera, array=replace(array, roll=array.roll + roll, tilt=tilt))


def as_described(camera: Camera) -> Camera:
    return camera


def one_run(seed: int, change: Change = as_described) -> Evaluation:
    """Hidden errors, pictures, measurement, prediction, comparison of one bench whose optics are changed."""
    bench = small_bench()
    study = small_study(bench)
    hidden = np.random.default_rng(10_000 + seed)
    axes = {element: found[1] for element in ELEMENTS if (found := bench.description.axis_of(element))}
    zeros = {element: hidden.normal(0.0, axis.zero_uncertainty) for element, axis in axes.items()}
    scales = {element: hidden.normal(0.0, axis.scale_uncertainty) for element, axis in axes.items()}
    turned = hidden.normal(0.0, 1.0, 3) * attitude_uncertainty(bench)
    measured = []
    for configuration in study.configurations:
        worlds: dict[Element, float] = {
            "main_lens.z": 0.0,
            "array.z": configuration.array,
            "sensor.z": configuration.sensor,
            "target.z": -configuration.distance,
        }
        targets: dict[str, Target] = {"white": White(), "four-dot": study.dots, "bars": study.bars}
        errors: dict[Element, float] = {e: zeros[e] + axes[e].sign * scales[e] * axes[e].reading(z) for e, z in worlds.items()}
        camera = with_turned_array(change(configuration.camera(bench.optics)), *turned)
        electrons = WHITE_E / white_irradiance(bench.optics) * (1 + hidden.normal(0.0, bench.description.light_uncertainty))
        pictures = {name: picture(camera, configuration, errors, target, hidden, electrons) for name, target in targets.items()}
        measured.append(measure_pictures(pictures, dict.fromkeys(targets, NOISE), configuration, worlds, study, bench.optics))
    return evaluate_measured(tuple(measured), study, bench, seed)


@pytest.fixture(scope="module")
def runs() -> Callable[[int], list[Comparison]]:
    def take(count: int) -> list[Comparison]:
        with ThreadPoolExecutor(2) as pool:
            return [run.comparison for run in pool.map(one_run, range(count))]

    return take


def pooled(comparisons: list[Comparison], quantity: str) -> npt.NDArray[np.float64]:
    return np.array([row.z for comparison in comparisons for row in comparison.rows if row.quantity == quantity])


@pytest.mark.ci
@pytest.mark.timeout(600)
def test_a_few_honest_benches_are_measured_within_their_uncertainties(runs: Callable[[int], list[Comparison]]) -> None:
    comparisons = runs(8)
    z = pooled(comparisons, "mtf")
    # All values of a run share its few stage errors, so eight runs say only this much.
    assert 0.3 < z.std() < 2.0
    assert np.mean(np.abs(z) < 3) > 0.8
    views = [row for comparison in comparisons for row in comparison.rows if row.quantity == "views"]
    assert np.mean([row.measured == row.predicted for row in views]) >= 0.95


def longer_microlenses(camera: Camera) -> Camera:
    return replace(camera, array=replace(camera.array, focal_lengths=(1.02 * camera.array.focal_lengths[0],)))


def narrower_iris(camera: Camera) -> Camera:
    return replace(camera, main_lens=replace(camera.main_lens, f_number=1.03 * camera.main_lens.f_number))


def longer_main_lens(camera: Camera) -> Camera:
    return replace(camera, main_lens=replace(camera.main_lens, focal_length=1.004 * camera.main_lens.focal_length))


def tilted_array(camera: Camera) -> Camera:
    return replace(camera, array=replace(camera.array, tilt=(math.tan(math.radians(0.3)), 0.0)))


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("change", "named", "size", "hidden"),
    [
        pytest.param(longer_microlenses, "focal length of the microlenses", 0.02, 0.0, marks=pytest.mark.ci),
        pytest.param(narrower_iris, "aperture of the main lens (the f-number the other way)", 1 / 1.03 - 1, 0.0, marks=pytest.mark.ci),
        pytest.param(tilted_array, "yaw of the array (its tilt along x)", math.radians(0.3), 5e-4, marks=pytest.mark.ci),
        pytest.param(longer_main_lens, "focal length of the main lens", 0.004, 0.0, marks=pytest.mark.full),
    ],
)
def test_a_planted_error_is_found_and_named(change: Change, named: str, size: float, hidden: float) -> None:
    """``hidden`` is the standard uncertainty of what the honest bench has of the same error beside."""
    run = one_run(3, change)
    assert not run.comparison.accepted
    assert run.suspects[0].what == named
    assert run.suspects[0].size == pytest.approx(size, abs=0.02 * abs(size) + 3 * hidden)
    assert not_told_apart(run.suspects) == run.suspects[:1]


@pytest.mark.full
@pytest.mark.timeout(7200)
def test_the_error_bars_of_300_honest_benches_are_honest(runs: Callable[[int], list[Comparison]]) -> None:
    comparisons = runs(300)
    for quantity in ("mtf", "ratio_mtf"):
        z = pooled(comparisons, quantity)
        sys_line = f"{quantity}: {len(z)} values, sd of z {z.std():.3f}, beyond 2: {100 * np.mean(np.abs(z) > 2):.2f} %"
        print(sys_line)
    z = np.concatenate([pooled(comparisons, "mtf"), pooled(comparisons, "ratio_mtf")])
    views = [row for comparison in comparisons for row in comparison.rows if row.quantity == "views"]
    exact = float(np.mean([row.measured == row.predicted for row in views]))
    rejected = float(np.mean([not comparison.accepted for comparison in comparisons]))
    print(f"views exact {100 * exact:.2f} %, benches rejected {100 * rejected:.1f} %")
    assert 0.9 <= z.std() <= 1.1
    assert 0.03 <= np.mean(np.abs(z) > 2) <= 0.06
    assert exact >= 0.95
    assert rejected <= 0.05 + 3 * (0.05 * 0.95 / 300) ** 0.5

"""Small simulated benches, each with its own hidden errors of stages, angles and light, no wire.

The hidden errors are drawn here, by this file's own generator; the analysis knows only the bench
file's uncertainties.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.bench import Bench, Element, read_bench
from flflab.bench_uncertainty import LightDescription, RepeatabilityDescription
from flflab.image.render import render
from flflab.image.scene import in_light, one_plane
from flflab.image.sensor.exposure import white_irradiance
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.study import (
    Configuration,
    ConfigurationsDescription,
    Study,
    StudyDescription,
    expand,
    repeated,
)
from flflab.targets import Bars, FourDot, Target, White
from flflab.verdict.evaluation import Evaluation, evaluate_measured
from flflab.verdict.properties.measured import measure_pictures
from flflab.verdict.sources import attitude_uncertainty

BENCHES = Path(__file__).parents[2] / "examples" / "benches"
GAIN, READ_NOISE_E, OFFSET, FULL_SCALE, WHITE_E = 4095 / 12000, 3.0, 64.0, 4095.0, 8000.0
NOISE = SensorNoise(GAIN, READ_NOISE_E * GAIN, OFFSET, FULL_SCALE)
Change = Callable[[Camera], Camera]
ELEMENTS: tuple[Element, ...] = ("main_lens.z", "array.z", "sensor.z", "target.z")


def small(file: str) -> Bench:
    """A bench of the examples with a sensor of 760 x 560 pixels and the microlenses before it."""
    bench = read_bench(BENCHES / file)
    optics = replace(
        bench.optics,
        sensor=replace(bench.optics.sensor, resolution=(760, 560)),
        array=replace(bench.optics.array, count=(7, 7)),
    )
    return replace(bench, optics=optics)


def study_of(bench: Bench, configurations: list[dict[str, Any]], repeats: int = 1) -> Study:
    """Dots and bars in each of these configurations, so many times."""
    described = [ConfigurationsDescription.model_validate(one) for one in configurations]
    description = StudyDescription(
        name="small", configurations=described, draws=1000, repeats=repeats
    )
    return Study(
        description,
        repeated(expand(description, bench.optics), repeats),
        FourDot(1.0, 4.0),
        Bars((0.5, 10.0), 12.0, 8.0),
    )


IN_AND_OUT_OF_FOCUS = [
    {"f_number": [2.8, 4, 5.6], "distance": "507 mm"},
    {"f_number": 4, "distance": ["500 mm", "515 mm"], "focused_at": "507 mm"},
]


def picture(
    camera: Camera,
    configuration: Configuration,
    errors: dict[Element, float],
    target: Target,
    rng: np.random.Generator,
    electrons: float,
    wavelength: float | None,
) -> npt.NDArray[np.float64]:
    """What a camera records whose elements stand off by these errors (mm), ``electrons`` those of
    full light.
    """
    lens, array, sensor, away = (errors[element] for element in ELEMENTS)
    true = replace(
        camera,
        array=replace(camera.array, distance=configuration.array + array - lens),
        sensor=replace(camera.sensor, distance=configuration.sensor + sensor - lens),
    )
    scene = in_light(one_plane(true, target, configuration.distance - away + lens), wavelength)
    # What rounding leaves of dark pixels is another on each machine, and the generator draws for
    # any light but none.
    tolerance = (
        3e-5 if target == White() else 5e-4 if wavelength is None else 1e-3
    )  # the electrons of full light are as many to 1e-2
    light = np.maximum(np.round(render(scene, tolerance=tolerance), 9), 0.0)
    caught = rng.poisson(light * electrons * white_irradiance(true)) + rng.normal(
        0.0, READ_NOISE_E, light.shape
    )
    return np.clip(np.rint(caught * GAIN + OFFSET), 0, FULL_SCALE)


def with_turned_array(camera: Camera, roll: float, yaw: float, pitch: float) -> Camera:
    array = camera.array
    tilt = (array.tilt[0] + math.tan(yaw), array.tilt[1] + math.tan(pitch))
    return replace(camera, array=replace(array, roll=array.roll + roll, tilt=tilt))


def as_described(camera: Camera) -> Camera:
    return camera


def one_run(
    seed: int,
    change: Change = as_described,
    described: Change = as_described,
    file: str = "simulated.yaml",
    configurations: list[dict[str, Any]] = IN_AND_OUT_OF_FOCUS,
    wavelength: float | None = None,
    told: bool = True,
    repeats: int = 1,
    approach: tuple[float, float] = (0.0, 0.0),
) -> Evaluation:
    """Hidden errors, pictures, measurement, prediction, comparison of one bench.

    ``change`` makes the true optics of those described; of the light's wavelength (mm) the bench
    file may say nothing. ``approach`` is how far stages repeat as the bench file says and as they
    do, mm; every picture is approached anew.
    """
    bench = small(file)
    light = (
        LightDescription.model_validate({"wavelength": f"{wavelength} mm"})
        if told and wavelength
        else None
    )
    stated = RepeatabilityDescription.model_validate({"stages": f"{approach[0]} mm"})
    update = {"light": light, "repeatability": stated}
    description = bench.description.model_copy(update=update)
    bench = replace(bench, description=description, optics=described(bench.optics))
    study = study_of(bench, configurations, repeats)
    hidden = np.random.default_rng(10_000 + seed)
    axes = {
        element: found[1] for element in ELEMENTS if (found := bench.description.axis_of(element))
    }
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
        errors: dict[Element, float] = {
            e: zeros[e] + axes[e].sign * scales[e] * axes[e].reading(z) for e, z in worlds.items()
        }
        camera = with_turned_array(change(configuration.camera(bench.optics)), *turned)
        electrons = (
            WHITE_E
            / white_irradiance(bench.optics)
            * (1 + hidden.normal(0.0, bench.description.light_uncertainty))
        )
        pictures: dict[str, npt.NDArray[np.float64]] = {}
        for name, target in targets.items():
            stands = dict(errors)
            if approach[1]:
                for element in ELEMENTS:
                    stands[element] += approach[1] * hidden.normal()
            pictures[name] = picture(
                camera, configuration, stands, target, hidden, electrons, wavelength
            )
        noises = dict.fromkeys(targets, NOISE)
        seen = measure_pictures(
            pictures,
            noises,
            configuration,
            worlds,
            study,
            bench.optics,
            wavelength=description.mean_wavelength,
        )
        measured.append(seen)
    return evaluate_measured(tuple(measured), study, bench, seed)


@pytest.fixture(scope="session")
def one_bench() -> Callable[..., Evaluation]:
    """``one_run``: seed, and what is changed of the optics or swept."""
    return one_run


@pytest.fixture(scope="session")
def small_bench() -> Bench:
    """The bench that ``one_bench`` hides errors in."""
    return small("simulated.yaml")


@pytest.fixture(scope="session")
def small_study(small_bench: Bench) -> Callable[[list[dict[str, Any]]], Study]:
    """The study of it in some configurations."""
    return lambda configurations: study_of(small_bench, configurations)

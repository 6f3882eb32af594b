"""What a study's frames will give before one is taken: exposure, uncertainty of the MTF, and how
many frames an accuracy takes.

White frames and bars of each configuration are drawn with the light and noise of the bench file's
``simulated`` block, of a bench whose stages stand off by errors drawn from what the bench file says
of them, and measured like real ones: in exact focus, where no bench is, the blur is less well known
than beside it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench, Element
from flflab.errors import MeasurementError
from flflab.image.render import render
from flflab.image.scene import in_light, one_plane
from flflab.image.sensor.exposure import white_irradiance
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.sequential import Look, frames_due
from flflab.optics.camera import Camera
from flflab.optics.light import lines_of
from flflab.study import Configuration, Study
from flflab.targets import White
from flflab.verdict.prediction import contrast_draws, placements
from flflab.verdict.sources import drawn_errors
from flflab.workers import results

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Expectation:
    """What one configuration will give.

    Attributes:
        configuration: its index.
        exposure_s: by the exposure rule.
        looks: frames of the bars and the largest standard uncertainty of the MTF in their mean, by
            noise and the floor of the measurement: the study's number of frames first, then
            those that the accuracy asked for takes. Empty where the bars cannot be measured.
        why: why they cannot be; else empty.
        by_stages: the largest standard uncertainty of the predicted MTF by what the stages may be
            off; nan where there are no looks.
    """

    configuration: int
    exposure_s: float
    looks: tuple[Look, ...]
    why: str = ""
    by_stages: float = math.nan


def expected_noise(bench: Bench) -> SensorNoise:
    """The noise of the bench file's simulated sensor at gain 1, where a full well is full scale."""
    sensor = bench.description.simulated
    full_scale = 2.0**sensor.bits - 1
    per_electron = (full_scale - sensor.black_level) / sensor.full_well_electrons
    return SensorNoise(
        per_electron, sensor.read_noise_electrons * per_electron, sensor.black_level, full_scale
    )


def expected_exposure(configuration: Configuration, study: Study, bench: Bench) -> float:
    """Exposure in s that brings the brightest view to the study's share of full scale, not rounded
    to the camera's steps.
    """
    sensor = bench.description.simulated
    light = white_irradiance(configuration.camera(bench.optics)) / white_irradiance(bench.optics)
    return (
        study.description.exposure.level
        * sensor.full_well_electrons
        / (sensor.electrons_per_second * light)
    )


def expect(configuration: Configuration, study: Study, bench: Bench) -> Expectation:
    """Draw and measure one configuration's white frames, then its bars until they are as sure as
    the study asks for, else once.
    """
    camera, description = configuration.camera(bench.optics), study.description
    rng = np.random.Generator(np.random.Philox(key=configuration.index))
    real, distance = _as_it_may_stand(configuration, bench, rng)
    noise, light = expected_noise(bench), bench.description.spectrum
    floor = bench.description.measurement_floor.contrast
    electrons = description.exposure.level * bench.description.simulated.full_well_electrons
    exposure = expected_exposure(configuration, study, bench)
    white, bars = (
        noise.offset_dn
        + noise.dn_per_electron
        * electrons
        * np.maximum(
            np.sum(
                [
                    weight * render(in_light(one_plane(real, target, distance), wavelength))
                    for wavelength, weight in lines_of(light)
                ],
                axis=0,
            ),
            0.0,
        )
        for target in (White(), study.bars)
    )
    looks: tuple[Look, ...] = ()
    by_stages = math.nan
    due = description.exposure.frames

    def taken(mean: Array, frames: int) -> Array:
        return mean + np.sqrt(noise.variance(mean) / frames) * rng.standard_normal(mean.shape)

    try:
        lattice = lattice_behind(camera, taken(white, due), noise.of_mean(due))
        while not looks or due > looks[-1].frames:
            curve = fit_contrast(
                taken(bars, due),
                lattice,
                camera,
                study.bars,
                configuration.distance,
                noise.of_mean(due),
                wavelength=bench.description.mean_wavelength,
            )
            looks = (*looks, Look(due, math.hypot(float(curve.uncertainty.max()), floor)))
            by_stages = _by_stages(configuration, study, bench, curve.cycles_per_mm)
            if description.mtf_standard_uncertainty is not None:
                due = frames_due(
                    looks, description.mtf_standard_uncertainty, description.exposure.most_frames
                )
    except MeasurementError as error:
        return Expectation(configuration.index, exposure, looks, str(error), by_stages)
    return Expectation(configuration.index, exposure, looks, by_stages=by_stages)


def _by_stages(
    configuration: Configuration, study: Study, bench: Bench, cycles_per_mm: Array
) -> float:
    """The largest standard uncertainty of the predicted MTF where the optics are as described and
    the stages off as stated.
    """
    errors = drawn_errors(
        bench, study.description.draws, np.random.Generator(np.random.Philox(key=0))
    ).of_the_stages_alone()
    placement = placements(bench, _places(configuration), errors)
    draws = contrast_draws(
        configuration.camera(bench.optics), placement, cycles_per_mm, bench.description.spectrum
    )
    return float(draws.std(axis=0).max())


def _places(configuration: Configuration) -> dict[Element, float]:
    """World z of every element where it is sent, mm."""
    return {
        "main_lens.z": 0.0,
        "array.z": configuration.array,
        "sensor.z": configuration.sensor,
        "target.z": -configuration.distance,
    }


def _as_it_may_stand(
    configuration: Configuration, bench: Bench, rng: np.random.Generator
) -> tuple[Camera, float]:
    """The camera and the target's distance, mm, with one draw of the stages' errors."""
    sent = _places(configuration)
    stands = dict(sent)
    for element, place in sent.items():
        if (found := bench.description.axis_of(element)) is not None:
            stands[element] += rng.standard_normal() * found[1].uncertainty(found[1].reading(place))
    lens = stands["main_lens.z"]
    placed = replace(
        configuration, array=stands["array.z"] - lens, sensor=stands["sensor.z"] - lens
    )
    return placed.camera(bench.optics), lens - stands["target.z"]


def expect_all(study: Study, bench: Bench, scheduler: str | None = None) -> Iterator[Expectation]:
    """What every configuration will give, as they are ready, from this machine's cores or a Dask
    scheduler's workers: the same numbers.

    Raises:
        InputError: no scheduler answers at the address.
    """
    return results(
        expect, [(configuration, study, bench) for configuration in study.configurations], scheduler
    )

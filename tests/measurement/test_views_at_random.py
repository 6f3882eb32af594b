"""Views counted in pictures of random dots before random cameras, against the rule of the model at
the dots' true places.
"""

from dataclasses import replace

import numpy as np
import pytest

from flflab.image.effects.scatter import Scatter
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.sensor.random_numbers import noise_key
from flflab.image.sensor.response import SensorResponse, digitise
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.useful import sensor_fields
from flflab.optics.views import chief_view_indices
from flflab.targets import FourDot, White


def bench(seed: int) -> tuple[Camera, SensorNoise, float]:
    """Camera, noise and electrons at white."""
    rng = np.random.default_rng(seed)
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    f_number = float(np.exp(rng.uniform(np.log(2.2), np.log(9.0))))
    side = int(rng.integers(620, 900))
    useful = Useful(minimum_illumination=float(rng.choice([0.2, 0.5, 0.7])))
    camera = Camera(
        MainLens(50.0, f_number), array, Sensor((side, side + 60), 0.00166, 61.15), "round", useful
    )
    response = SensorResponse()
    numbers = response.quantisation
    read = 3.0 if response.read_noise is None else response.read_noise.electrons
    noise = SensorNoise(
        numbers.dn_per_electron,
        read * numbers.dn_per_electron,
        numbers.offset_dn,
        numbers.full_scale,
    )
    return (
        camera,
        noise,
        min(float(rng.choice([2000.0, 10000.0, 40000.0])), 0.6 * response.saturation_e),
    )


def target_of(seed: int, place: int) -> tuple[FourDot, float, tuple[float, float]]:
    """Target, distance (mm) and where the target's centre stands (mm)."""
    rng = np.random.default_rng([seed, place])
    target = FourDot(diameter=float(rng.uniform(0.6, 1.2)), spacing=float(rng.uniform(3.0, 6.0)))
    distance = float(rng.choice([506.7016, rng.uniform(490.0, 525.0)]))
    return target, distance, (float(rng.uniform(-1.0, 1.0)), float(rng.uniform(-1.0, 1.0)))


def counts(seed: int, places: int, scatter: Scatter | None = None) -> list[tuple[int, int, int]]:
    """(true views, measured views, how many of them the measurement calls uncertain) of each dot of
    targets before one bench, its lenses alike or not.
    """
    camera, noise, electrons = bench(seed)
    if scatter is not None:  # of a wide aperture few micro-images are whole, and six are needed
        camera = replace(camera, sensor=replace(camera.sensor, resolution=(1200, 1260)))
    fields = sensor_fields(camera)
    white = digitise(
        render(replace(one_plane(camera, White(), 506.7016), scatter=scatter)),
        electrons,
        SensorResponse(),
        noise_key(seed, "white"),
    )
    lattice = lattice_behind(camera, white, noise)
    every: list[tuple[int, int, int]] = []
    for place in range(places):
        target, distance, offset = target_of(seed, place)
        dots = digitise(
            render(replace(one_plane(camera, target, distance, offset), scatter=scatter)),
            electrons,
            SensorResponse(),
            noise_key(seed, f"dots {place}"),
        )
        for dot in count_views(dots, lattice, camera, target, distance, noise):
            true = len(
                chief_view_indices(
                    fields, 1 / distance, (target.centres[dot.dot] + offset) / distance
                )
            )
            every.append((true, dot.views, dot.views_uncertain))
    return every


def agree(seeds: range, places: int) -> tuple[int, int, int]:
    """How many dots there were, how many of them were decided beyond the noise, and how many of
    those were counted wrongly.
    """
    every = [one for seed in seeds for one in counts(seed, places)]
    sure = [(true, found) for true, found, uncertain in every if uncertain == 0]
    assert all(abs(true - found) <= uncertain for true, found, uncertain in every)
    return len(every), len(sure), sum(true != found for true, found in sure)


@pytest.mark.parametrize(
    ("seeds", "places", "least"),
    [
        pytest.param(range(2), 2, 8, marks=pytest.mark.ci),
        pytest.param(range(100, 140), 4, 580, marks=[pytest.mark.full, pytest.mark.timeout(0)]),
    ],
)
def test_views_of_random_dots_are_counted_exactly_where_noise_does_not_decide(
    seeds: range, places: int, least: int
) -> None:
    every, decided, wrong = agree(seeds, places)
    print(f"{decided} of {every} decided, {wrong} wrong")
    assert decided >= least
    assert wrong == 0


@pytest.mark.parametrize(
    ("seeds", "places"),
    [
        pytest.param(range(900, 902), 2, marks=pytest.mark.ci),
        pytest.param(range(900, 940), 4, marks=[pytest.mark.full, pytest.mark.timeout(0)]),
    ],
)
def test_views_behind_lenses_as_built_are_counted_exactly_or_marked(
    seeds: range, places: int
) -> None:
    """Places 0.3 um, focal lengths and light 1 % from lens to lens."""
    every = [one for seed in seeds for one in counts(seed, places, Scatter(0.01, 3e-4, seed, 0.01))]
    wrong = [one for one in every if abs(one[0] - one[1]) > one[2]]
    print(f"{len(every)} dots, {sum(one[2] == 0 for one in every)} decided, wrong: {wrong}")
    assert not wrong

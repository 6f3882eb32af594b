"""Views counted in pictures of random dots before random cameras, against the rule of the model at the dots' true places."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.analysis.dots import count_views
from flflab.analysis.lattice import find_lattice
from flflab.analysis.noise import SensorNoise
from flflab.image.random_numbers import noise_key
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.sensor_response import SensorResponse, digitise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.optics.useful import sensor_fields
from flflab.optics.views import chief_view_indices
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]


def scene(seed: int) -> tuple[Camera, FourDot, float, Array, float]:
    """Camera, target, distance (mm), where the target's centre stands (mm), electrons at white."""
    rng = np.random.default_rng(seed)
    array = MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0)
    f_number = float(np.exp(rng.uniform(np.log(2.2), np.log(9.0))))
    side = int(rng.integers(700, 1100))
    useful = Useful(minimum_illumination=float(rng.choice([0.2, 0.5, 0.7])))
    camera = Camera(MainLens(50.0, f_number), array, Sensor((side, side + 60), 0.00166, 61.15), "round", useful)
    target = FourDot(diameter=float(rng.uniform(0.6, 1.2)), spacing=float(rng.uniform(3.0, 6.0)))
    distance = float(rng.choice([506.7016, rng.uniform(490.0, 525.0)]))
    return camera, target, distance, rng.uniform(-1.0, 1.0, 2), float(rng.choice([2000.0, 10000.0, 40000.0]))


def counts(seed: int) -> list[tuple[int, int, int]]:
    """(true views, measured views, how many of them the measurement calls uncertain) of each dot of a random scene."""
    camera, target, distance, offset, electrons = scene(seed)
    response = SensorResponse()
    numbers = response.quantisation
    electrons = min(electrons, 0.6 * response.saturation_e)
    noise = SensorNoise(numbers.dn_per_electron, 3.0 * numbers.dn_per_electron, numbers.offset_dn, numbers.full_scale)
    if response.read_noise is not None:
        noise = replace(noise, read_noise_dn=response.read_noise.electrons * numbers.dn_per_electron)
    white, dots = (
        digitise(
            render(one_plane(camera, kind, distance, (float(offset[0]), float(offset[1])))), electrons, response, noise_key(seed, kind.kind)
        )
        for kind in (White(), target)
    )
    pitch = 0.4 * camera.sensor.distance / camera.array.distance / camera.sensor.pixel
    lattice = find_lattice(white, "square", pitch, noise)
    found = count_views(dots, white, lattice, camera, target, distance, noise)
    fields = sensor_fields(camera)
    return [
        (len(chief_view_indices(fields, 1 / distance, (target.centres[dot.dot] + offset) / distance)), dot.views, dot.views_uncertain)
        for dot in found
    ]


def agree(seeds: range) -> tuple[int, int]:
    """How many dots were decided beyond the noise, and how many of those were counted wrongly."""
    every = [one for seed in seeds for one in counts(seed)]
    sure = [(true, found) for true, found, uncertain in every if uncertain == 0]
    assert all(abs(true - found) <= uncertain for true, found, uncertain in every)
    return len(sure), sum(true != found for true, found in sure)


def test_views_of_random_dots_are_counted_exactly_where_noise_does_not_decide() -> None:
    decided, wrong = agree(range(4))
    assert decided >= 8
    assert wrong == 0


@pytest.mark.full
@pytest.mark.timeout(0)
def test_views_of_ten_thousand_random_dots_are_counted_exactly() -> None:
    decided, wrong = agree(range(100, 2900))
    assert decided >= 10_000
    assert wrong == 0

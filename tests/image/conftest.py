from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.reference import trace_pixels
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Target

Array = npt.NDArray[np.float64]
Difference = Callable[..., float]


@pytest.fixture(scope="session")
def camera() -> Camera:
    """The laboratory's camera with a sensor of a few micro-images."""
    array = MicrolensArray(layout="square", count=(25, 25), pitch=(0.4, 0.4), aperture=0.336, focal_lengths=(0.917,), distance=60.0)
    return Camera(MainLens(50.0, 4.0), array, Sensor((270, 230), 0.00166, 61.15))


@pytest.fixture(scope="session")
def with_f_number(camera: Camera) -> Callable[[float], Camera]:
    return lambda f_number: replace(camera, main_lens=MainLens(50.0, f_number))


@pytest.fixture(scope="session")
def largest_difference() -> Difference:
    """Largest difference between the image and traced rays over some lit pixels, half of them where the image is steepest."""

    def compare(
        camera: Camera,
        target: Target,
        distance: float,
        count: int = 16,
        rays: int = 65536,
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> float:
        image = render(one_plane(camera, target, distance, offset))
        rng = np.random.default_rng(7)
        steepness = np.abs(np.gradient(image)).sum(axis=0)
        places = [np.argwhere(image > 0), np.argwhere(steepness > 0.5 * steepness.max())]
        chosen = np.concatenate([place[rng.integers(0, len(place), count // 2)] for place in places])
        traced = trace_pixels(camera, target, distance, chosen[:, ::-1], rays=rays, target_offset=offset)
        return float(np.abs(image[chosen[:, 0], chosen[:, 1]] - traced).max())

    return compare

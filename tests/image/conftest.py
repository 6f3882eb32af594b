from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.render import render, render_light
from flflab.image.scene import ALL, Scene
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor

Array = npt.NDArray[np.float64]
Difference = Callable[..., float]


@pytest.fixture(scope="session")
def camera() -> Camera:
    """The laboratory's camera with a sensor of a few micro-images."""
    array = MicrolensArray(
        layout="square",
        count=(25, 25),
        pitch=(0.4, 0.4),
        aperture=0.336,
        focal_lengths=(0.917,),
        distance=60.0,
    )
    return Camera(MainLens(50.0, 4.0), array, Sensor((270, 230), 0.00166, 61.15))


@pytest.fixture(scope="session")
def with_f_number(camera: Camera) -> Callable[[float], Camera]:
    return lambda f_number: replace(camera, main_lens=MainLens(50.0, f_number))


@pytest.fixture(scope="session")
def with_gap() -> Callable[[float], Camera]:
    """One microlens so far before the sensor; about 1.017 mm its micro-image has no rim."""
    array = MicrolensArray("square", (1, 1), (0.2, 0.2), 0.16, (1.0,), 60.0)
    return lambda gap: Camera(MainLens(50.0, 1.8), array, Sensor((130, 130), 0.004, 60.0 + gap))


@pytest.fixture(scope="session")
def typical_difference(trace_pixels: Callable[..., tuple[Array, Array]]) -> Difference:
    """Root mean square of the difference between the picture and traced rays over some lit pixels.

    What the reference cannot vouch for is taken off: four of its own uncertainties.
    """

    def compare(
        scene: Scene, count: int = 12, tolerance: float = 0.002, wanted: float = 3e-4
    ) -> float:
        image = render(scene, tolerance=tolerance)
        assert image.any(), "nothing of the scene is lit"
        assert np.isfinite(image).all()
        places = np.argwhere(image > 0)
        chosen = places[np.random.default_rng(7).integers(0, len(places), count)]
        mean = (
            None
            if scene.stray_light is None
            else float(render(replace(scene, stray_light=None, colour_filter=None)).mean())
        )
        traced, uncertainty = trace_pixels(scene, chosen[:, ::-1], wanted=wanted, mean_light=mean)
        apart = np.abs(image[chosen[:, 0], chosen[:, 1]] - traced)
        return float(np.sqrt(np.mean(np.maximum(apart - 4 * uncertainty, 0.0) ** 2)))

    return compare


@pytest.fixture(scope="session")
def allowed() -> Difference:
    """Largest root mean square that a few pixels may show: the tolerance where closed forms make
    the picture; where rays do, twice what the picture states of itself, which is bounded too.
    """

    def of(scene: Scene, tolerance: float = 0.002) -> float:
        light = render_light(scene, tolerance, ALL)
        if light.pilot is None:
            return tolerance
        assert light.pilot.rms < 10 * tolerance  # what 256 rays a pixel reach at steep tilts
        return 2 * max(tolerance, light.pilot.rms)

    return of

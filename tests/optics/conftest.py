"""The camera of the worked example, and rays traced by thin-lens refraction alone."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful

Array = npt.NDArray[np.float64]
TracedRays = tuple[Array, Array, npt.NDArray[np.bool_]]


@pytest.fixture
def laboratory() -> Callable[..., Camera]:
    """The camera of the worked example at any f-number, distance of the array and gap."""

    def build(
        f_number: float = 4.0,
        array: float = 60.0,
        gap: float = 1.15,
        aperture: float = 0.336,
        minimum: float = 0.5,
    ) -> Camera:
        return Camera(
            MainLens(50.0, f_number),
            MicrolensArray("square", (25, 25), (0.4, 0.4), aperture, (0.917,), array),
            Sensor((3664, 2748), 1.66e-3, array + gap),
            useful=Useful(minimum, 0.0),
        )

    return build


@pytest.fixture
def trace() -> Callable[[Camera, float, float, float, Array], TracedRays]:
    """Rays in one coordinate from an object point through main lens and one microlens, by
    refraction at each thin lens.
    """

    def run(
        camera: Camera, distance: float, height: float, centre: float, crossings: Array
    ) -> TracedRays:
        slope = (crossings - height) / distance
        slope = slope - crossings / camera.main_lens.focal_length
        at_array = crossings + slope * camera.array.distance
        slope = slope - (at_array - centre) / camera.array.focal_lengths[0]
        at_sensor = at_array + slope * camera.gap
        through = np.abs(at_array - centre) <= camera.array.aperture / 2
        return at_array, at_sensor, through

    return run

"""What a microlens shows of a dot, against rays drawn at random through two thin lenses."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.measurement.dots.model import Microlenses, shown
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor

Array = npt.NDArray[np.float64]
CAMERA = Camera(
    MainLens(50.0, 4.0),
    MicrolensArray("square", (25, 25), (0.4, 0.4), 0.336, (0.917,), 60.0),
    Sensor((1400, 1100), 0.00166, 61.15),
)
RAYS = 300_000


def by_rays(
    camera: Camera, lens: Array, dot: Array, distance: float, diameter: float
) -> tuple[Array, Array, float]:
    """Centroid from the micro-image's centre, its standard uncertainty, mm, and share of the rays
    that pass both stops, weighed by the fourth power of the cosine.
    """
    rng = np.random.default_rng(1)

    def disc(width: float) -> Array:
        turn = rng.uniform(0, 2 * np.pi, RAYS)
        r = width / 2 * np.sqrt(rng.uniform(0, 1, RAYS))
        return r[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    away, gap, main = camera.array.distance, camera.gap, camera.main_lens
    point, q = dot + disc(diameter), lens + disc(camera.array.aperture)
    # from the point through the main lens to q: m with (m - point)/D - m/F = (q - m)/L
    m = (q / away + point / distance) / (1 / distance - 1 / main.focal_length + 1 / away)
    slope = (q - m) / away - (q - lens) / camera.array.focal_lengths[0]
    passes = np.hypot(*m.T) < main.aperture / 2
    weight = passes * (1 + (slope**2).sum(axis=1)) ** -2.0
    landing = q + gap * slope - lens * (1 + gap / away)
    centroid = np.average(landing, axis=0, weights=weight)
    doubt = landing[passes].std(axis=0) / np.sqrt(passes.sum())
    return centroid, doubt, float(weight.mean())


@pytest.mark.parametrize("distance", [400.0, 506.7, 640.0])
@pytest.mark.parametrize("aside", [0.0, 2.5, 3.6])
def test_the_centroid_of_a_dot_is_that_of_rays_whether_cut_defocused_or_not(
    distance: float, aside: float
) -> None:
    lens, dot, diameter = np.array([0.4, -0.8]), np.array([aside - 3.0, 5.8]), 0.8
    microlens = Microlenses(
        lens[None] * (1 + CAMERA.gap / 60.0), np.zeros(1), np.array([0.917]), 6.25, 1.0, CAMERA,
    )  # fmt: skip
    found = shown(microlens, dot[None] / distance, np.array([1 / distance]), diameter / distance)
    centroid, doubt, light = by_rays(CAMERA, lens, dot, distance, diameter)
    assert np.all(np.abs(found.centroid[0] - centroid) < 4 * doubt + 0.0005 * CAMERA.sensor.pixel)
    assert found.light[0] == pytest.approx(light, rel=0.005, abs=0.001)


def test_where_the_main_lens_limits_the_centroid_is_the_chief_ray_s() -> None:
    """A pinhole of a main lens: the target's image on the array is seen by one microlens."""
    camera = replace(CAMERA, main_lens=MainLens(50.0, 40.0))
    distance, lens, dot = 310.0, np.array([0.0, 0.0]), np.array([0.3, -0.2])
    microlens = Microlenses(
        lens[None], np.zeros(1), np.array([0.917]), 0.625, 0.0, camera,
    )  # fmt: skip
    found = shown(microlens, dot[None] / distance, np.array([1 / distance]), 0.1 / distance)
    centroid, doubt, _ = by_rays(camera, lens, dot, distance, 0.1)
    np.testing.assert_allclose(found.chief, found.centroid, atol=1e-6)
    assert np.all(np.abs(found.centroid[0] - centroid) < 4 * doubt + 1e-6)

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.image.sensor.exposure import white_irradiance
from flflab.optics.camera import Camera
from flflab.targets import White


def integrated(camera: Camera) -> float:
    """Irradiance over exitance of a Lambertian pupil, ring by ring, at the middle of the
    micro-image on the axis.
    """
    gap, count = camera.gap, 200000
    kappa = 1 + gap / 60 - gap / 0.917
    radius = min(0.336, camera.main_lens.aperture * gap / 60 / abs(kappa)) / 2
    ring = radius * (np.arange(count) + 0.5) / count
    cosine = gap / np.hypot(gap, ring)
    return float(np.sum(2 * ring * radius / count * cosine**4 / gap**2))


@pytest.mark.parametrize("f_number", [1.6, 4.0, 16.0, 22.0])
def test_the_irradiance_is_that_of_a_lambertian_disc(
    with_f_number: Callable[[float], Camera], f_number: float
) -> None:
    camera = with_f_number(f_number)
    assert white_irradiance(camera) == pytest.approx(integrated(camera), rel=1e-6)


def test_brightness_falls_with_the_f_number_only_where_the_main_lens_limits(
    with_f_number: Callable[[float], Camera],
) -> None:
    assert white_irradiance(with_f_number(2.0)) == white_irradiance(with_f_number(8.0))
    assert white_irradiance(with_f_number(16.0)) / white_irradiance(
        with_f_number(32.0)
    ) == pytest.approx(4.0, rel=0.01)


def test_brightness_falls_with_the_gap(camera: Camera) -> None:
    further = replace(camera, sensor=replace(camera.sensor, distance=61.5))
    assert white_irradiance(camera) / white_irradiance(further) == pytest.approx(
        (1.5 / 1.15) ** 2, rel=0.02
    )


@pytest.mark.parametrize("f_number", [4.0, 16.0])
def test_a_picture_shows_the_true_irradiance(
    with_f_number: Callable[[float], Camera], f_number: float
) -> None:
    camera = with_f_number(f_number)
    point = replace(
        camera.sensor, resolution=(1, 1), pixel=1e-4
    )  # within one of 1.66 um light falls off by 6e-5
    plain = one_plane(replace(camera, sensor=point), White(), 506.7)
    for scene in (plain, replace(plain, falloff=Falloff())):
        shown = render(scene, tolerance=1e-5)[0, 0] * white_irradiance(camera, scene.falloff)
        assert shown == pytest.approx(integrated(camera), rel=1e-4)

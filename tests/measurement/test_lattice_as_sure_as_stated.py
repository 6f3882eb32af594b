"""Radii of white pictures' micro-images are off by no more than noise makes of them, and together
as stated.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.optics.resolution import central_smms
from flflab.targets import White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)
LIGHT_DN = 2730.0


def camera(size: tuple[int, int], pixel: float, tilt: tuple[float, float]) -> Camera:
    """One kind of microlenses before the image of the main lens."""
    array = MicrolensArray("square", (12, 14), (0.2752, 0.2752), 0.2394, (0.82,), 62.95, tilt=tilt)
    return Camera(MainLens(50.0, 3.5), array, Sensor(size, pixel, 63.62))


def radii_px(camera: Camera, focal: float) -> tuple[float, float]:
    """Of bright and total field, by similar triangles."""
    away, lens = camera.array.distance, camera.main_lens
    gap = camera.sensor.distance - away
    shadow, microlens = (
        lens.focal_length / lens.f_number * gap / away,
        camera.array.aperture * abs(1 + gap / away - gap / focal),
    )
    return abs(shadow - microlens) / 2 / camera.sensor.pixel, (
        shadow + microlens
    ) / 2 / camera.sensor.pixel


def without_noise(camera: Camera) -> Array:
    return (
        np.asarray(render(one_plane(camera, White(), 300.0), tolerance=1e-4)) * LIGHT_DN
        + NOISE.offset_dn
    )


def off(white: Array, true: Camera, described: Camera) -> Array:
    """Of both radii, by what is stated."""
    lattice = lattice_behind(described, white, NOISE)
    inside, outside = radii_px(true, true.array.focal_lengths[0])
    return np.array(
        [
            (lattice.inside_radius_px - inside) / lattice.inside_uncertainty_px,
            (lattice.outside_radius_px - outside) / lattice.outside_uncertainty_px,
        ]
    )


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (-0.0012, -0.002), (0.0004, 0.004)])
def test_without_noise_radii_are_right_to_a_part_of_what_is_stated(
    tilt: tuple[float, float],
) -> None:
    """Coarse tables, and few of them behind a tilt, left the outside radius off by 1 to 4 of what
    is stated.
    """
    behind = camera((420, 400), 0.0043, tilt)
    assert np.abs(off(without_noise(behind), behind, behind)).max() < 0.4


SEVERAL = Camera(
    MainLens(97.91, 7.185),
    MicrolensArray(
        "hexagonal",
        (12, 14),
        (0.3659, 0.3659),
        0.3015,
        (2.25, 2.2812, 2.1967),
        124.313,
        ((0, 1, 2), (2, 0, 1)),
        tilt=(0.0007, 0.0),
    ),
    Sensor((442, 363), 0.00725, 127.06),
)


@pytest.mark.ci
@pytest.mark.parametrize("columns", [430, 434, 438, 442, 446])
def test_kinds_that_differ_otherwise_than_described_are_fitted_as_they_are(columns: int) -> None:
    """A gap half a per cent off widens every kind by its own: held as described, radii were 3.5 of
    what is stated off. One of which the picture's border shows the rim alone was looked for by the
    central kind's width, and left out.
    """
    true = replace(SEVERAL, sensor=replace(SEVERAL.sensor, resolution=(columns, 363)))
    described = replace(true, sensor=replace(true.sensor, distance=127.06 - 0.014))
    lattice = lattice_behind(described, without_noise(true), NOISE)
    inside, outside = radii_px(true, float(central_smms(true).focal))
    assert abs(lattice.inside_radius_px - inside) < 0.6 * lattice.inside_uncertainty_px
    assert abs(lattice.outside_radius_px - outside) < 0.6 * lattice.outside_uncertainty_px


@pytest.mark.full
def test_radii_and_pitch_scatter_by_no_more_than_stated(brute: Any) -> None:
    behind = camera((210, 200), 0.0043, (0.0, 0.0))
    light, rng = (without_noise(behind) - NOISE.offset_dn) / LIGHT_DN, np.random.default_rng(1)
    lattices = [
        lattice_behind(behind, brute.expose(light, NOISE, LIGHT_DN, rng), NOISE) for _ in range(150)
    ]
    found = np.array(
        [[one.inside_radius_px, one.outside_radius_px, one.pitch_px] for one in lattices]
    )
    stated = np.mean([one.sizes_covariance_px for one in lattices], axis=0)
    spread = np.sqrt(np.diag(stated))
    assert np.all(found.std(axis=0) < 1.1 * spread)

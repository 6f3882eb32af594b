"""Dots counted and placed, against rays through the microlenses' middles and where the dots are."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import Scene, in_light, one_plane
from flflab.measurement.dots.views import DotViews, count_views
from flflab.measurement.lattice.registration import target_scales
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import FourDot, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
RESOLUTION = (1240, 1240)
FOCUS = 506.7016
TARGET = FourDot(diameter=1.0, spacing=4.0)


def exact(scene: Scene, level: float = 2700) -> Array:
    return 64 + level * np.maximum(render(scene, tolerance=1e-4), 0.0)


def found_in(
    real: Camera, distance: float, nominal: Camera | None = None, target: FourDot = TARGET
) -> tuple[DotViews, ...]:
    """In pictures without noise."""
    white, dots = (exact(one_plane(real, one, distance)) for one in (White(), target))
    camera = nominal or real
    lattice = lattice_behind(camera, white, NOISE)
    return count_views(dots, lattice, camera, target, distance, NOISE)


def off_depth(found: tuple[DotViews, ...], distance: float) -> Array:
    """Errors of depth over what is stated."""
    return np.array([(dot.position_mm[2] + distance) / dot.uncertainty_mm[2] for dot in found])


def expected_views(brute: Any, camera: Camera, distance: float, dot: Array) -> tuple[Array, Array]:
    """Landings (px) within half of the light's circle, and how far from its rim all are."""
    b, away, pixel = camera.gap, camera.array.distance, camera.sensor.pixel
    lenses, landed = brute.landings(camera, distance, dot)
    centres = lenses * (1 + b / away) / pixel + (np.asarray(RESOLUTION) - 1) / 2
    lens, cone = (
        camera.main_lens.aperture * b / away / 2,
        camera.array.aperture * abs(1 + b / away - b / camera.array.focal_lengths[0]) / 2,
    )
    r = np.linspace(lens - cone, lens, 50) / pixel
    # two-disc illumination by counting: the share of the small disc's points inside the large one
    grid = np.meshgrid(np.linspace(-1, 1, 401), np.linspace(-1, 1, 401))
    x, y = (part[np.hypot(*grid) <= 1] for part in grid)
    share = [
        np.mean(np.hypot(one + x * cone / pixel, y * cone / pixel) <= lens / pixel) for one in r
    ]
    margin = np.hypot(*(landed - centres).T) - np.interp(-0.5, -np.array(share), r)
    inside = np.all((landed > -0.5) & (landed < np.asarray(RESOLUTION) - 0.5), axis=1)
    inside &= np.all((centres > -0.5) & (centres < np.asarray(RESOLUTION) - 0.5), axis=1)
    return landed[inside & (margin <= 0)], margin


@pytest.mark.parametrize(
    ("f_number", "distance", "offset"),
    [
        (4.0, FOCUS, (0.0, 0.0)),
        pytest.param(5.6, 497.0, (0.3, 0.1), marks=pytest.mark.ci),
        pytest.param(2.8, FOCUS, (0.13, -0.2), marks=pytest.mark.full),
        pytest.param(8.0, FOCUS, (0.0, 0.0), marks=pytest.mark.ci),
    ],
)
def test_every_dot_is_counted_and_placed(
    brute: Any, f_number: float, distance: float, offset: tuple[float, float]
) -> None:
    camera, rng = brute.camera(f_number, RESOLUTION), np.random.default_rng(2)
    white, dots = (
        brute.expose(
            render(one_plane(camera, target, distance, offset), tolerance=1e-3), NOISE, 3000, rng
        )
        for target in (White(), TARGET)
    )
    lattice = lattice_behind(camera, white, NOISE)
    for dot in count_views(dots, lattice, camera, TARGET, distance, NOISE):
        true = TARGET.centres[dot.dot] + offset
        landed, margin = expected_views(brute, camera, distance, true)
        assert abs(dot.views - len(landed)) <= np.count_nonzero(np.abs(margin) < 0.3)
        apart = dot.centres_px[:, None] - landed[None]
        nearest = np.hypot(*apart.transpose(2, 0, 1)).min(axis=1)
        assert np.all(nearest < 5 * dot.centre_uncertainty_px.max(axis=1))
        known = np.isfinite(dot.position_mm).all()
        assert known or dot.views < 2
        error = dot.position_mm - np.array([*true, -distance])
        assert not known or np.all(np.abs(error) < 4 * dot.uncertainty_mm)
        together = float(np.sqrt((dot.common_mm[2] ** 2).sum()))
        most = 0.2 if f_number < 8 else 1.0  # mm; a dot has two views or three at F/8
        assert not known or 0 < together < dot.uncertainty_mm[2] < most


@pytest.mark.parametrize(
    "distance",
    [590.0, *(pytest.param(d, marks=pytest.mark.ci) for d in (392.0, 441.0, 507.0, 514.0))],
)
def test_the_model_has_no_bias_beside_the_noise_whatever_the_focus(
    brute: Any, distance: float
) -> None:
    found = found_in(brute.camera(4.0, (640, 640)), distance, target=FourDot(0.8, 3.0))
    assert np.abs(off_depth(found, distance)).max() < 0.5


@pytest.mark.parametrize(
    ("f_number", "off_mm"),
    [(5.6, 0.005), *(pytest.param(5.6, off, marks=pytest.mark.ci) for off in (-0.01, 0.01))],
)
def test_a_gap_that_the_camera_file_has_wrong_draws_no_spot_aside(
    brute: Any, f_number: float, off_mm: float
) -> None:
    """It blurs spots that an aperture cuts to one side: their common focus is fitted."""
    nominal = brute.camera(f_number, (640, 640))
    sensor = replace(nominal.sensor, distance=nominal.sensor.distance + off_mm)
    camera = replace(nominal, sensor=sensor)
    for dot in found_in(camera, FOCUS, nominal):
        landed = brute.landings(camera, FOCUS, TARGET.centres[dot.dot])[1]
        apart = dot.centres_px[:, None] - landed[None]
        assert np.hypot(*apart.transpose(2, 0, 1)).min(axis=1).max() < 0.06


@pytest.mark.parametrize(
    ("f_number", "diameter"),
    [(5.6, 1.0), *(pytest.param(4.0, d, marks=pytest.mark.ci) for d in (0.5, 1.0))],
)
def test_dots_close_together_are_not_taken_for_one_another(
    brute: Any, f_number: float, diameter: float
) -> None:
    fine, close = brute.camera(f_number, (320, 320)), FourDot(diameter, 1.5 * diameter)
    camera = replace(fine, sensor=replace(fine.sensor, pixel=4 * fine.sensor.pixel))
    found = found_in(camera, FOCUS, target=close)
    assert np.abs(off_depth(found, FOCUS)).max() < 2


@pytest.mark.ci
def test_behind_a_turned_array_without_a_microlens_on_the_axis_dots_stand_where_they_are(
    brute: Any,
) -> None:
    straight = brute.camera(4.0, (980, 980))
    camera = replace(straight, array=replace(straight.array, count=(24, 24), tilt=(3e-3, 0.0)))
    found = found_in(camera, FOCUS)
    assert np.abs(off_depth(found, FOCUS)).max() < 1


@pytest.mark.parametrize(
    ("f_number", "distance", "wavelength", "falloff"),
    [
        (4.0, 470.0, None, Falloff()),
        pytest.param(4.0, 590.0, None, Falloff(), marks=pytest.mark.ci),
        pytest.param(2.8, 450.0, None, Falloff(), marks=pytest.mark.ci),
        pytest.param(5.6, 507.0, 550e-6, None, marks=pytest.mark.ci),
        pytest.param(2.8, 515.0, 550e-6, None, marks=pytest.mark.ci),
        pytest.param(4.0, 495.0, 550e-6, Falloff(), marks=pytest.mark.ci),
    ],
)
def test_fall_off_and_diffraction_leave_dots_where_they_are(
    brute: Any, f_number: float, distance: float, wavelength: float | None, falloff: Falloff | None
) -> None:
    camera = brute.camera(f_number, (760, 560))
    white = exact(replace(one_plane(camera, White(), distance), falloff=falloff))
    dots = exact(
        replace(in_light(one_plane(camera, TARGET, distance), wavelength), falloff=falloff)
    )
    lattice = lattice_behind(camera, white, NOISE)
    found = count_views(dots, lattice, camera, TARGET, distance, NOISE)
    assert np.abs(off_depth(found, distance)).max() < 1.5


def test_what_spoils_a_spot_spoils_no_depth_and_what_leaves_none_is_named(brute: Any) -> None:
    camera, rng = brute.camera(4.0, (760, 560)), np.random.default_rng(5)
    white, dots, dark = (
        brute.expose(image, NOISE, 2700, rng)
        for image in (
            *(render(one_plane(camera, one, FOCUS), tolerance=1e-3) for one in (White(), TARGET)),
            np.zeros((560, 760)),
        )
    )
    lattice = lattice_behind(camera, white, NOISE)

    def depths(picture: npt.NDArray[np.uint16]) -> tuple[DotViews, ...]:
        return count_views(picture, lattice, camera, TARGET, FOCUS, NOISE)

    hot = dots.copy()
    hot.ravel()[rng.choice(hot.size, 300, replace=False)] = 4095
    assert np.abs(off_depth(depths(hot), FOCUS)).max() < 4
    dust = dots.copy()
    x, y = np.rint(depths(dots)[1].centres_px[0]).astype(int)
    dust[y - 4 : y + 30, x - 30 : x + 30] = 64
    assert np.abs(off_depth(depths(dust), FOCUS)).max() < 4
    clipped = np.minimum(64 + 2.0 * (dots.astype(float) - 64), 4095)
    spoilt = depths(clipped)
    assert sum(dot.saturated for dot in spoilt) > 1000
    assert np.abs(off_depth(spoilt, FOCUS)).max() < 4
    with pytest.raises(MeasurementError, match=r"no pattern of dots .* 0 % of the expected light"):
        depths(dark)
    with pytest.raises(MeasurementError, match="shape"):
        depths(dots[1:])


@pytest.mark.ci
@pytest.mark.parametrize("longer", [0.0, 0.002])
def test_a_main_lens_that_is_longer_than_described_scales_dots_as_the_bench_has_them(
    brute: Any, longer: float
) -> None:
    """Depth, which it leaves open by many per cent, says nothing of how wide a dot's light is."""
    nominal, target = brute.camera(5.6, (640, 640)), FourDot(0.8, 3.0)
    lens = nominal.main_lens
    real = replace(nominal, main_lens=replace(lens, focal_length=lens.focal_length * (1 + longer)))
    found = found_in(real, FOCUS, nominal, target)
    scale = found[0].scale
    assert scale is not None
    due = target_scales(nominal, FOCUS)[0] / target_scales(real, FOCUS)[0]
    assert abs(scale.size / due - 1) < 2 * scale.size_uncertainty < 2e-3

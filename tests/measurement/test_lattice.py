"""The lattice of chief rays in white pictures of a camera whose file is known, against where rays
through the microlenses' middles land.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.nominal import mixed_up_units
from flflab.measurement.lattice.with_camera import lattice_behind, white_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import White

Array = npt.NDArray[np.float64]

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=16383.0)
LEVEL = 3000.0  # 10,000 electrons: 1 %
L, GAP, PITCH = 60.0, 1.15, 0.4


def camera(
    f_number: float, resolution: tuple[int, int], pixel: float = 0.0083, focal: float = 0.917
) -> Camera:
    """The worked example with larger pixels; a focal length above the gap makes it Galilean."""
    array = MicrolensArray("square", (25, 25), (PITCH, PITCH), 0.336, (focal,), L)
    return Camera(MainLens(50.0, f_number), array, Sensor(resolution, pixel, L + GAP))


def light(one: Camera, falling: bool = True) -> Array:
    scene = one_plane(one, White(), 506.7016)
    scene = replace(scene, falloff=Falloff()) if falling else scene
    return np.maximum(render(scene, tolerance=1e-4), 0.0)


def radii_px(one: Camera) -> tuple[float, float]:
    """Of bright and total field, by similar triangles."""
    lens = one.main_lens.focal_length / one.main_lens.f_number * GAP / L
    microlens = 0.336 * abs(1 + GAP / L - GAP / one.array.focal_lengths[0])
    pixel = 2 * one.sensor.pixel
    return abs(lens - microlens) / pixel, (lens + microlens) / pixel


@pytest.mark.parametrize(
    ("f_number", "focal"),
    [pytest.param(2.8, 0.917, marks=pytest.mark.full), (4.0, 0.917), (4.0, 1.4)],
)
def test_fall_off_moves_the_light_and_not_the_chief_rays(f_number: float, focal: float) -> None:
    one = camera(f_number, (720, 550), focal=focal)
    found = white_behind(one, LEVEL * light(one) + NOISE.offset_dn, NOISE)
    lattice, pitch = found.lattice, PITCH * (1 + GAP / L) / one.sensor.pixel
    light_pitch = math.sqrt(abs(np.linalg.det(found.white.grid.vectors_px)))
    assert abs(lattice.pitch_px / pitch - 1) < 2e-5
    assert abs(light_pitch / pitch - 1) > 5e-5
    np.testing.assert_allclose(
        [lattice.inside_radius_px, lattice.outside_radius_px], radii_px(one), atol=0.02
    )
    np.testing.assert_allclose(lattice.origin_px, [359.5, 274.5], atol=0.002)


def test_without_fall_off_none_is_corrected_for() -> None:
    one = camera(4.0, (720, 550))
    lattice = lattice_behind(one, LEVEL * light(one, False) + NOISE.offset_dn, NOISE)
    assert abs(lattice.pitch_px / (PITCH * (1 + GAP / L) / one.sensor.pixel) - 1) < 5e-6
    assert lattice.fall_off < 0.05


@pytest.mark.parametrize(
    "f_number",
    [
        *(pytest.param(n, marks=pytest.mark.ci) for n in (8.0, 16.0)),
        *(pytest.param(n, marks=pytest.mark.full) for n in (1.6, 2.8)),
    ],
)
def test_at_one_percent_noise_every_whole_centre_is_where_its_chief_ray_lands(
    brute: Any, f_number: float
) -> None:
    one = camera(f_number, (1200, 900), pixel=0.005)
    picture = brute.expose(light(one), NOISE, LEVEL, np.random.default_rng(7))
    lattice = lattice_behind(one, picture, NOISE)
    pitch, middle = PITCH * (1 + GAP / L) / 0.005, np.array([599.5, 449.5])
    off = lattice.centres_px - middle - np.rint((lattice.centres_px - middle) / pitch) * pitch
    limit = 0.1 if f_number < 2 else 0.01
    assert np.sqrt(np.mean(off**2)) < limit
    assert np.all(np.abs(lattice.origin_px - middle) < (0.02 if f_number < 2 else 0.003))
    assert abs(lattice.pitch_px - pitch) < 3 * lattice.pitch_uncertainty_px


@pytest.mark.full
def test_stated_uncertainties_cover_new_noise(brute: Any) -> None:
    one = camera(4.0, (360, 300), pixel=0.0166)
    image, pitch = light(one), PITCH * (1 + GAP / L) / 0.0166
    rng, scores = np.random.default_rng(3), list[Array]()
    for _ in range(8):
        found = lattice_behind(one, brute.expose(image, NOISE, LEVEL, rng), NOISE)
        due = np.array([pitch, 0.0, 179.5, 149.5, *radii_px(one)])
        seen = [found.pitch_px, found.angle, *found.origin_px]
        stated = [found.pitch_uncertainty_px, found.angle_uncertainty, *found.origin_uncertainty_px]
        seen += [found.inside_radius_px, found.outside_radius_px]
        stated += [found.inside_uncertainty_px, found.outside_uncertainty_px]
        scores.append((np.array(seen) - due) / stated)
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all(rms < 2), rms


def test_microlenses_off_their_lattice_widen_what_is_stated(brute: Any) -> None:
    one = camera(4.0, (360, 300), pixel=0.0166)
    pitch, rng = PITCH * (1 + GAP / L) / 0.0166, np.random.default_rng(5)
    inside, outside = radii_px(one)
    lens, microlens = (outside + inside) / 2, (outside - inside) / 2
    picture = np.zeros((300, 360))
    for j, i in np.ndindex(15, 17):
        at = np.array([179.5, 149.5]) + pitch * np.array([i - 8, j - 7])
        picture += brute.micro_image(picture.shape, at + rng.normal(0, 0.1, 2), lens, microlens)
    picture = brute.expose(picture, NOISE, LEVEL, rng)
    found = white_behind(one, picture, NOISE)
    assert found.white.grid.scatter_px == pytest.approx(0.1, rel=0.15)
    lattice = found.lattice
    assert abs(lattice.pitch_px - pitch) < 3 * lattice.pitch_uncertainty_px
    assert np.all(np.abs(lattice.origin_px - [179.5, 149.5]) < 3 * lattice.origin_uncertainty_px)
    assert lattice.pitch_uncertainty_px > 1e-3


@pytest.mark.ci
def test_another_layout_or_pitch_than_described_is_refused() -> None:
    one = camera(4.0, (360, 300), pixel=0.0166)
    white = LEVEL * light(one) + NOISE.offset_dn
    hexagonal = replace(one, array=replace(one.array, layout="hexagonal"))
    with pytest.raises(MeasurementError, match="check the layout"):
        lattice_behind(hexagonal, white, NOISE)
    coarse = replace(one, sensor=replace(one.sensor, pixel=0.00166))
    with pytest.raises(MeasurementError, match="centimetres and millimetres mixed up"):
        lattice_behind(coarse, white, NOISE)


def test_units_are_known_by_their_ratio() -> None:
    assert mixed_up_units(25.0) == mixed_up_units(1 / 25.0) == "inches and millimetres"
    assert mixed_up_units(3.0) is None


@pytest.mark.parametrize(
    "picture",
    [
        np.full((300, 360), 2000.0),
        np.full((300, 360), 64.0),
        np.random.default_rng(5).normal(2000, 30, (300, 360)),
    ],
)
def test_a_picture_without_a_lattice_is_refused_in_one_sentence(picture: Array) -> None:
    with pytest.raises(MeasurementError, match="white picture"):
        lattice_behind(camera(4.0, (360, 300), pixel=0.0166), picture, NOISE)


@pytest.mark.ci
@pytest.mark.parametrize("f_number", [2.1, 2.2])
def test_micro_images_that_touch_have_their_radii_though_light_does_not_fall_off(
    f_number: float,
) -> None:
    focal, array, gap, lens, pixel = 45.55, 50.19, 0.4677, 0.3378, 0.0030244
    camera = Camera(
        MainLens(focal, f_number),
        MicrolensArray("hexagonal", (9, 11), (0.28485, 0.28485), 0.2797, (lens,), array),
        Sensor((555, 449), pixel, array + gap),
    )
    picture = render(one_plane(camera, White(), 650.0), tolerance=1e-4)
    noisy = np.random.default_rng(1).poisson(picture * 3500 / 0.34) * 0.34 + 64
    noise = SensorNoise(dn_per_electron=0.34, read_noise_dn=0.5, offset_dn=64, full_scale_dn=4095)
    found = lattice_behind(camera, np.rint(noisy).astype(np.uint16), noise)
    shadow, disc = focal / f_number * gap / array, 0.2797 * abs(1 + gap / array - gap / lens)
    assert found.outside_radius_px == pytest.approx((shadow + disc) / 2 / pixel, rel=0.005)
    assert found.inside_radius_px == pytest.approx((shadow - disc) / 2 / pixel, rel=0.02)
    assert found.misfit < 0.002

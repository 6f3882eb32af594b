"""What changes a finished picture, against closed forms and single rays."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import ncx2

from flflab.errors import InputError
from flflab.image.choose import choose
from flflab.image.effects.columns import Columns
from flflab.image.effects.effect import Formed
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.hot_pixels import HotPixels
from flflab.image.effects.second_stop import SecondStop
from flflab.image.effects.shading import Shading
from flflab.image.effects.soft_rims import SoftRims
from flflab.image.render import finish, render
from flflab.image.scene import one_plane
from flflab.image.scene_file import read_scene
from flflab.optics.camera import Camera
from flflab.targets import Bars, White


def test_shading_falls_with_the_square_of_the_distance_to_the_corner(camera: Camera) -> None:
    image = np.ones((11, 21))
    finish(image, replace(one_plane(camera, White(), 507.0), shading=Shading(0.2)), 0.002)
    assert image[5, 10] == 1.0
    assert image[0, 0] == pytest.approx(0.8)
    assert image[5, 0] == pytest.approx(1 - 0.2 * 100 / 125)


def test_a_halo_softens_an_edge_by_the_gaussian_integral_and_keeps_the_light(
    camera: Camera,
) -> None:
    image = np.zeros((41, 201))
    image[:, 100:] = 1.0
    radius = 6 * camera.sensor.pixel
    finish(image, replace(one_plane(camera, White(), 507.0), halo=Halo(0.1, radius)), 0.002)
    away = np.arange(201) - 99.5
    expected = 0.9 * (away > 0) + 0.1 * ndtr(away / 6)
    assert image[20, 60:140] == pytest.approx(expected[60:140], abs=5e-4)
    point = np.zeros((101, 101))
    point[50, 50] = 1.0
    finish(point, replace(one_plane(camera, White(), 507.0), halo=Halo(0.3, radius)), 0.002)
    assert point.sum() == pytest.approx(1.0, abs=1e-3)
    assert point[50, 50] == pytest.approx(0.7 + 0.3 / (2 * np.pi * 36), abs=1e-3)


def test_gamma_raises_the_light_to_its_power_and_leaves_white_alone(camera: Camera) -> None:
    image = np.array([[0.0, 0.25, 1.0]])
    finish(image, replace(one_plane(camera, White(), 507.0), gamma=Gamma(0.5)), 0.002)
    assert image[0] == pytest.approx([0.0, 0.5, 1.0])


def test_a_soft_rim_is_a_disc_blurred_and_leaves_what_is_seen_inside_sharp(camera: Camera) -> None:
    places = np.arange(161) - 80.0
    away = np.hypot(places, places[:, None])
    disc = np.clip(50.5 - away, 0, 1)
    stripes = np.where(np.arange(161) // 4 % 2, 1.0, 0.0)
    rims = SoftRims(2.1 * camera.sensor.pixel)
    formed = Formed(camera, lambda: disc.copy(), lambda: np.zeros(0, np.void))
    white, bars = disc.copy(), disc * stripes
    rims.apply(white, formed)
    rims.apply(bars, formed)
    blurred = ncx2.cdf((50 / 2.1) ** 2, 2, (away[80] / 2.1) ** 2)  # a disc and a Gaussian
    assert white[80] == pytest.approx(blurred, abs=0.01)
    assert white[80, 80 + 48] - white[80, 80 + 52] == pytest.approx(0.66, abs=0.02)  # over 4 px
    inside = away < 40
    assert bars[inside] == pytest.approx((disc * stripes)[inside], abs=1e-4)


def test_columns_and_taps_have_gains_of_their_own(camera: Camera) -> None:
    image = np.full((3, 40_000), 2.0)
    plain = one_plane(camera, White(), 507.0)
    finish(image, replace(plain, columns=Columns(0.002, 0.005, 2, seed=4)), 0.002)
    assert (image == image[0]).all()
    left, right = image[0, :20_000] / 2, image[0, 20_000:] / 2
    assert left.std() == pytest.approx(0.002, rel=0.03)
    assert abs(left.mean() - right.mean()) > 1e-4  # ten times what columns alone leave
    with pytest.raises(InputError, match=r"columns: tap is 0.2 of the mean gain; from 0 to 0.1"):
        Columns(tap=0.2)


def test_a_second_stop_takes_the_rays_that_it_stops(camera: Camera) -> None:
    small = replace(camera, sensor=replace(camera.sensor, offset=(1.5, 1.0)))
    ring = SecondStop(distance=40.0, diameter=4.4)
    scene = one_plane(small, White(), 507.0)
    open_wide = render(scene, tolerance=1e-4)
    clipped = render(replace(scene, second_stop=ring), tolerance=1e-4)
    array, gap, focal = 60.0, 1.15, 0.917
    rng = np.random.default_rng(0)
    lens_plane = np.sqrt(rng.random(20_000)) * np.exp(2j * np.pi * rng.random(20_000)) * 0.168
    middle = 1.6 + 0.8j  # of a microlens
    seen = []
    for row, column in np.argwhere(open_wide > 0.05)[::400]:
        place = 1.5 + (column - 134.5) * 0.00166 + 1j * (1.0 + (row - 114.5) * 0.00166)
        if abs(place - middle * (1 + gap / array)) > 0.15:
            continue  # of another microlens
        at = middle + lens_plane
        slope = (place - at) / gap + lens_plane / focal
        reached = abs(at - array * slope) <= 6.25
        passed = reached & (abs(at - 20.0 * slope) <= 2.2)
        seen.append((clipped[row, column] / open_wide[row, column], passed.sum() / reached.sum()))
    found, expected = np.array(seen).T
    assert len(found) > 15
    assert found == pytest.approx(expected, abs=0.02)
    assert np.ptp(expected) > 0.5
    with pytest.raises(InputError, match=r"second stop: distance is 61 mm; one below 60 mm"):
        render(replace(scene, second_stop=SecondStop(61.0, 5.0)))


def test_effects_too_small_to_matter_are_left_out_where_that_saves_time(camera: Camera) -> None:
    plain = one_plane(camera, Bars(), 507.0)
    faint = replace(plain, halo=Halo(1e-5, 0.02))
    assert "halo" not in choose(faint, 0.002).effects
    assert "halo" in choose(replace(plain, halo=Halo(0.02, 0.02)), 0.002).effects


def test_a_scene_file_states_them_and_refuses_what_cannot_be(tmp_path: Path, root: Path) -> None:
    file, camera = tmp_path / "scene.yaml", root / "examples/cameras/osinski.yaml"
    start = "planes: [{target: white, distance: 507 mm}]\n"
    text = start + "shading: 10 %\nhalo: {share: 2 %, radius: 20 um}\ngamma: 0.9\n"
    text += "soft_rims: 3 um\nsecond_stop: {distance: 40 mm, diameter: 8 mm}\n"
    text += "columns: {column: 0.2 %, tap: 0.3 %, taps: 4, seed: 2}\n"
    text += "sensor: {hot_pixels: {share: 0.1 %, electrons: 500}}\n"
    file.write_text(text, encoding="utf-8")
    read = read_scene(file, camera)
    scene = read.scene
    assert (scene.shading, scene.halo, scene.gamma) == (Shading(0.1), Halo(0.02, 0.02), Gamma(0.9))
    assert (scene.soft_rims, scene.second_stop) == (SoftRims(0.003), SecondStop(40.0, 8.0))
    assert scene.columns == Columns(0.002, 0.003, 4, 2)
    assert read.response.hot_pixels == HotPixels(0.001, 500.0)
    file.write_text(start + "gamma: 7\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"scene.yaml:2: gamma: exponent is 7; from 0.3 to 3"):
        read_scene(file, camera)

"""What multiplies or blurs a finished picture, against closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from flflab.errors import InputError
from flflab.image.after import finish
from flflab.image.choose import choose
from flflab.image.effects.gamma import Gamma
from flflab.image.effects.halo import Halo
from flflab.image.effects.shading import Shading
from flflab.image.scene import one_plane
from flflab.image.scene_file import read_scene
from flflab.optics.camera import Camera
from flflab.targets import Bars, White


def test_shading_falls_with_the_square_of_the_distance_to_the_corner(camera: Camera) -> None:
    image = np.ones((11, 21))
    finish(image, replace(one_plane(camera, White(), 507.0), shading=Shading(0.2)))
    assert image[5, 10] == 1.0
    assert image[0, 0] == pytest.approx(0.8)
    assert image[5, 0] == pytest.approx(1 - 0.2 * 100 / 125)


def test_a_halo_softens_an_edge_by_the_gaussian_integral_and_keeps_the_light(
    camera: Camera,
) -> None:
    image = np.zeros((41, 201))
    image[:, 100:] = 1.0
    radius = 6 * camera.sensor.pixel
    finish(image, replace(one_plane(camera, White(), 507.0), halo=Halo(0.1, radius)))
    away = np.arange(201) - 99.5
    expected = 0.9 * (away > 0) + 0.1 * ndtr(away / 6)
    assert image[20, 60:140] == pytest.approx(expected[60:140], abs=5e-4)
    point = np.zeros((101, 101))
    point[50, 50] = 1.0
    finish(point, replace(one_plane(camera, White(), 507.0), halo=Halo(0.3, radius)))
    assert point.sum() == pytest.approx(1.0, abs=1e-3)
    assert point[50, 50] == pytest.approx(0.7 + 0.3 / (2 * np.pi * 36), abs=1e-3)


def test_gamma_raises_the_light_to_its_power_and_leaves_white_alone(camera: Camera) -> None:
    image = np.array([[0.0, 0.25, 1.0]])
    finish(image, replace(one_plane(camera, White(), 507.0), gamma=Gamma(0.5)))
    assert image[0] == pytest.approx([0.0, 0.5, 1.0])


def test_effects_too_small_to_matter_are_left_out_where_that_saves_time(camera: Camera) -> None:
    plain = one_plane(camera, Bars(), 507.0)
    faint = replace(plain, halo=Halo(1e-5, 0.02))
    assert "halo" not in choose(faint, 0.002).effects
    assert "halo" in choose(replace(plain, halo=Halo(0.02, 0.02)), 0.002).effects


def test_a_scene_file_states_them_and_refuses_what_cannot_be(tmp_path: Path, root: Path) -> None:
    file, camera = tmp_path / "scene.yaml", root / "examples/cameras/osinski.yaml"
    start = "planes: [{target: white, distance: 507 mm}]\n"
    text = start + "shading: 10 %\nhalo: {share: 2 %, radius: 20 um}\ngamma: 0.9\n"
    file.write_text(text, encoding="utf-8")
    scene = read_scene(file, camera).scene
    assert (scene.shading, scene.halo, scene.gamma) == (Shading(0.1), Halo(0.02, 0.02), Gamma(0.9))
    file.write_text(start + "gamma: 7\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"scene.yaml:2: gamma: exponent is 7; from 0.3 to 3"):
        read_scene(file, camera)

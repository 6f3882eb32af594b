"""What a quarter turn makes of camera, picture and lattice."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.built_in import Kind, built_in
from flflab.files.camera import read_camera
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.registration import microlens_type_of
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.measure import measure
from flflab.measurement.quarter_turn import (
    turned_camera,
    turned_gains,
    turned_lattice,
    turned_picture,
    turned_pixels,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.targets import Bars, BarsAlongY, Target, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)


def small_camera() -> Camera:
    camera = read_camera(built_in(Kind.CAMERA))
    return replace(camera, sensor=replace(camera.sensor, resolution=(760, 560)))


def exposed(camera: Camera, target: Target, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    scene = one_plane(camera, target, 506.7, (0.2, 0.1))
    electrons = rng.poisson(np.maximum(render(scene, tolerance=5e-4), 0) * 7000.0)
    dn = electrons * NOISE.dn_per_electron + rng.normal(NOISE.offset_dn, NOISE.read_noise_dn)
    return np.clip(np.rint(dn), 0, NOISE.full_scale_dn)


@pytest.mark.ci
def test_the_json_says_along_which_axis_contrast_was_measured() -> None:
    camera = small_camera()
    white = exposed(camera, White(), 1)
    for bars, along in ((Bars(), "x"), (BarsAlongY(), "y")):
        found = measure(exposed(camera, bars, 2), camera, bars, 506.7, NOISE, white)
        assert {point["along"] for point in found["mtf"]} == {along}
        width, height = camera.sensor.resolution
        for view in found["mtf_by_view"]:
            assert 0 <= view["centre_px"][0] <= width
            assert 0 <= view["centre_px"][1] <= height


@pytest.mark.ci
def test_a_turned_lattice_is_that_of_the_turned_picture() -> None:
    camera = small_camera()
    camera = replace(camera, array=replace(camera.array, roll=0.004, offset=(0.02, -0.03)))
    white = exposed(camera, White(), 1)
    turned = turned_lattice(lattice_behind(camera, white, NOISE), white.shape[1])
    measured = lattice_behind(turned_camera(camera), turned_picture(white), NOISE)
    here, there = (
        one.centres_px[np.lexsort(np.rint(one.centres_px / 50).T)] for one in (turned, measured)
    )
    assert here == pytest.approx(there, abs=1e-2)
    assert turned.light == pytest.approx(measured.light, rel=1e-2, abs=2.0)
    assert turned.angle == pytest.approx(measured.angle, abs=1e-4)
    assert turned.rises == pytest.approx(np.zeros(len(here)), abs=1e-3)


def test_types_of_a_hexagonal_array_stay_with_their_lenses() -> None:
    camera = small_camera()
    array = replace(
        camera.array, layout="hexagonal", focal_lengths=(0.9, 0.92, 0.94), pattern=((0, 1, 2),)
    )
    camera = replace(camera, array=array)
    lattice = lattice_behind(camera, exposed(camera, White(), 1), NOISE)
    turned = turned_lattice(lattice, camera.sensor.resolution[0])
    here, there = (
        microlens_type_of(lattice, camera),
        microlens_type_of(turned, turned_camera(camera)),
    )
    assert len(set(here)) == 3
    assert np.array_equal(here, there)


@pytest.mark.parametrize("columns", [6, 7])
def test_pixels_and_filters_turn_with_the_picture(columns: int) -> None:
    picture = np.arange(4 * columns, dtype=float).reshape(4, columns)
    turned = turned_picture(picture)
    column, row = turned_pixels(np.array([2.0, 1.0]), columns).astype(int)
    assert turned[row, column] == picture[1, 2]
    gains = np.array([[1.0, 2.0], [3.0, 4.0]])
    mosaic = gains[np.arange(4)[:, None] % 2, np.arange(columns) % 2]
    found = turned_gains(gains, columns)
    assert found is not None
    rows, across = np.indices((columns, 4)) % 2
    assert np.array_equal(turned_picture(mosaic), found[rows, across])

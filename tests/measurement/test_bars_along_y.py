"""Contrast along either axis."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.built_in import Kind, built_in
from flflab.files.camera import read_camera
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.measure import measure
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

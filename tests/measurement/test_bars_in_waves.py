"""Contrast of bars in light of one wavelength, against the autocorrelation of a round pupil that is
out of focus.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.built_in import Kind, built_in
from flflab.files.camera import read_camera
from flflab.image.render import render
from flflab.image.scene import in_light, one_plane
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.targets import Bars, White

Array = npt.NDArray[np.float64]
FOCUS, WAVE, NOISE = 506.7016, 550e-6, SensorNoise(0.34, 1.0, 64.0, 4095.0)
BARS, GAP, APERTURE, PIXEL = Bars((0.5, 10.0), 12.0, 8.0), 1.15, 0.336, 0.00166


def transfer(cycles_per_px: Array, blur_mm: float) -> Array:
    """Of a pupil with a quadratic phase that makes a disc of this diameter of rays, and a pixel."""
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 801)])
    found = []
    for frequency in cycles_per_px / PIXEL:
        shift = frequency * WAVE * GAP / (APERTURE / 2)
        left, right = np.hypot(x - shift / 2, y) < 1, np.hypot(x + shift / 2, y) < 1
        # the phase at radius r of the pupil is pi (blur / 2) (R / gap) r^2 / wave: its difference
        turn = 2 * math.pi * (blur_mm / 2) * (APERTURE / 2 / GAP) / WAVE * x * shift
        both = (left & right) * np.cos(turn)
        found.append(both.sum() / (np.hypot(x, y) < 1).sum())
    return np.array(found) * np.sinc(cycles_per_px)


@pytest.mark.ci
@pytest.mark.parametrize("distance", [FOCUS, 500.0, 520.0])
def test_every_frequency_has_the_contrast_of_its_pupil(distance: float) -> None:
    camera = read_camera(built_in(Kind.CAMERA))
    camera = replace(camera, sensor=replace(camera.sensor, resolution=(1240, 1000)))
    white = 64 + 2600 * render(one_plane(camera, White(), distance), tolerance=1e-3)
    scene = in_light(one_plane(camera, BARS, distance), WAVE)
    bars = 64 + 2600 * np.maximum(render(scene, tolerance=1e-3), 0.0)
    lattice = lattice_behind(camera, white, NOISE)
    curve = fit_contrast(bars, lattice, camera, BARS, distance, NOISE, wavelength=WAVE)
    # where rays of a microlens meet behind it, of the image that the main lens makes
    image = 1 / (1 / 50 - 1 / distance)
    behind = 1 / (1 / 0.917 - 1 / (60 - image))
    blur = APERTURE * abs(GAP / behind - 1)
    due = transfer(curve.cycles_per_px, blur)
    assert len(due) == 14  # of 16: the smaller sensor sees no more of the chart
    assert np.abs(curve.contrast - due).max() < 0.005

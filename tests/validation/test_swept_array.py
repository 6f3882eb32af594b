"""The array of an honest bench turned step by step: attitude and fields of the micro-images against
what was set, no wire.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from flflab.alignment import attitude_of
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import White

NOISE, WHITE_E = SensorNoise(4095 / 12000, 1.0, 64.0, 4095.0), 8000.0
A, L, B, F, D, PIXEL = 12.5, 60.0, 1.15, 0.917, 0.336, 0.00166
CAMERA = Camera(
    MainLens(50.0, 50.0 / A),
    MicrolensArray("square", (7, 7), (0.4, 0.4), D, (F,), L),
    Sensor((760, 560), PIXEL, L + B),
)
SETTINGS = [(0.0, 0.2, 0.0), (0.5, -0.1, -0.2), (0.0, 0.0, 0.5), (-1.0, 0.02, 0.3)]


@pytest.mark.full
def test_what_is_read_of_a_turned_array_lies_within_its_uncertainty_of_what_was_set() -> None:
    lens, microlens = (
        A * B / L / 2,
        D * abs(1 + B / L - B / F) / 2,
    )  # radii of the two shadows on the axis, physics.md
    rng, angles, fields = np.random.default_rng(8), list[list[float]](), list[list[float]]()
    for degrees in SETTINGS * 3:
        roll, yaw, pitch = np.radians(degrees)
        turned = replace(
            CAMERA, array=replace(CAMERA.array, roll=roll, tilt=(math.tan(yaw), math.tan(pitch)))
        )
        light = np.maximum(render(one_plane(turned, White(), 507.0), tolerance=5e-5), 0.0)
        electrons = rng.poisson(light * WHITE_E) + rng.normal(
            0.0, NOISE.read_noise_dn / NOISE.dn_per_electron, light.shape
        )
        picture = np.rint(electrons * NOISE.dn_per_electron + NOISE.offset_dn)
        lattice = lattice_behind(CAMERA, picture, NOISE)
        found = attitude_of(lattice)
        angles.append(
            [
                (value - due) / doubt
                for (value, doubt), due in zip(
                    found.angles.values(), (roll, yaw, pitch), strict=True
                )
            ]
        )
        dues = (lens - microlens) / PIXEL, (lens + microlens) / PIXEL
        radii = (
            (lattice.inside_radius_px, lattice.inside_uncertainty_px),
            (lattice.outside_radius_px, lattice.outside_uncertainty_px),
        )
        fields.append(
            [(value - due) / doubt for (value, doubt), due in zip(radii, dues, strict=True)]
        )
    assert np.sqrt(np.mean(np.square(angles))) < 1.35  # 36 scores: 1 +- 0.12
    # what no noise makes of radii is stated too
    assert np.sqrt(np.mean(np.square(fields))) < 1.5  # 24 scores: 1 +- 0.14

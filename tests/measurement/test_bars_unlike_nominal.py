"""Bars of a camera whose main lens is not quite the described one are found all the same: they are
larger or smaller than expected.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor
from flflab.targets import Bars, White

NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)
TRUE = Camera(
    MainLens(61.8779, 3.048),
    MicrolensArray(
        "square",
        (12, 14),
        (0.24358, 0.24358),
        0.2062,
        (0.5669,),
        75.5747,
        roll=-0.00018,
        tilt=(-0.00006, -0.0007),
    ),
    Sensor((546, 475), 0.0038976, 76.2508),
)
BARS, DISTANCE = Bars((0.3137, 3.0099), 13.24, 11.229), 440.586


@pytest.mark.ci
@pytest.mark.parametrize("longer", [0.04, 0.05, -0.1])
def test_low_bars_alone_lead_no_search_astray(brute: Any, longer: float) -> None:
    """Of bars whose harmonics are not looked at yet a third of what varies is no noise: taken for
    it, 336 runs outweighed what is known of the camera, magnification went 9 % the wrong way, and
    the bars were refused.
    """
    rng = np.random.default_rng(1)
    described = replace(TRUE, main_lens=MainLens(61.8779 + longer, 3.048))
    white, bars = (
        brute.expose(
            np.maximum(render(one_plane(TRUE, target, DISTANCE), tolerance=5e-4), 0.0),
            NOISE,
            2730,
            rng,
        )
        for target in (White(), BARS)
    )
    curve = fit_contrast(bars, lattice_behind(TRUE, white, NOISE), described, BARS, DISTANCE, NOISE)
    # a square pixel of so many mm on the target, and hardly any blur
    gap, offset = 76.2508 - 75.5747, 75.5747 / DISTANCE + 1 - 75.5747 / 61.8779
    pixel = 0.0038976 * DISTANCE * abs(offset) / gap
    for nu, contrast, doubt in zip(
        curve.cycles_per_mm, curve.contrast, curve.uncertainty, strict=True
    ):
        assert contrast == pytest.approx(
            math.sin(math.pi * nu * pixel) / (math.pi * nu * pixel), abs=5 * doubt + 0.02
        )

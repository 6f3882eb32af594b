"""What noise leaves of the depth of dots on average: of a picture and of one with the same noise
the other way round.
"""

from typing import Any

import numpy as np
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.views import DotViews, count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.targets import FourDot, White

NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
TARGET = FourDot(diameter=1.0, spacing=4.0)
PAIRS = 10


def depth(dots: tuple[DotViews, ...]) -> float:
    """Mean of the dots' z, mm."""
    return float(np.mean([dot.position_mm[2] for dot in dots]))


@pytest.mark.full
@pytest.mark.parametrize("distance", [502.0, 515.0])
def test_near_focus_noise_draws_depth_to_no_side(brute: Any, distance: float) -> None:
    """Edges that noise sharpens drew the blur down to them, those that it softens did not draw it
    up: a fifth of what is stated.
    """
    camera = brute.camera(5.6, (640, 640))
    white, exact = (
        render(one_plane(camera, target, distance), tolerance=1e-4) * 3000 + 64
        for target in (White(), TARGET)
    )
    lattice = lattice_behind(camera, white, NOISE)
    spread, rng = np.sqrt(NOISE.variance(exact)), np.random.default_rng(6)
    noises = [spread * rng.standard_normal(exact.shape) for _ in range(PAIRS)]
    noises += [-noise for noise in noises]
    noiseless = count_views(exact, None, lattice, camera, TARGET, distance, NOISE)
    found = [
        depth(count_views(exact + noise, None, lattice, camera, TARGET, distance, NOISE))
        for noise in noises
    ]
    stated = float(np.mean([dot.uncertainty_mm[2] for dot in noiseless]))
    assert abs(np.mean(found) - depth(noiseless)) < 0.08 * stated

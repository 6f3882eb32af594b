"""The lattice measured in dots on average: of a picture and of one with the same noise the other
way round, which a linear fit cancels.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.effects.falloff import Falloff
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.without_white.dots import lattice_from_dots
from flflab.targets import FourDot

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.3, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)
TARGET = FourDot(diameter=1.0, spacing=4.0)


def either_way_round(exact: Array, pairs: int) -> Iterator[Array]:
    """A picture without noise, in so many noises and the same with the other sign."""
    spread, rng = np.sqrt(NOISE.variance(exact)), np.random.default_rng(6)
    for _ in range(pairs):
        noise = spread * rng.standard_normal(exact.shape)
        yield from (exact + noise, exact - noise)


@pytest.mark.full
@pytest.mark.parametrize("falloff", [Falloff(), None])
def test_without_a_white_picture_the_pitch_is_drawn_to_no_side(
    brute: Any, falloff: Falloff | None
) -> None:
    """Fall-off taken for halfway to none, some of it where there is none, and coarse profiles left
    it 0.3 to 0.4 of what is stated off.
    """
    camera = brute.camera(4.0, (1240, 1240))
    exact = (
        render(
            replace(one_plane(camera, TARGET, 507.0, (0.1, 0.2)), falloff=falloff), tolerance=1e-4
        )
        * 3000
        + 64
    )
    nominal = nominal_lattice(camera, 3000.0)
    noiseless = lattice_from_dots(exact, nominal, camera, TARGET, 507.0, NOISE)
    assert noiseless.pitch_px == pytest.approx(
        nominal.pitch_px, abs=0.05 * noiseless.pitch_uncertainty_px
    )
    found = [
        lattice_from_dots(picture, nominal, camera, TARGET, 507.0, NOISE)
        for picture in either_way_round(exact, 4)
    ]
    off = [
        (lattice.pitch_px - nominal.pitch_px) / lattice.pitch_uncertainty_px for lattice in found
    ]
    assert abs(np.mean(off)) < 0.2

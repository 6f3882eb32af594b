"""The noise between two frames of the same scene, drawn by numpy."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.sensor.pairs import noise_of_pair

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(dn_per_electron=0.4, read_noise_dn=2.0, offset_dn=64.0, full_scale_dn=4095.0)


def frames(lamp: float = 1.0) -> tuple[Array, Array]:
    """Two frames of a scene with detail, behind pixels that differ by 3 %."""
    rng = np.random.default_rng(3)
    scene = 5000 * rng.uniform(0, 1, (200, 300)) * (1 + 0.03 * rng.standard_normal((200, 300)))
    one, other = (
        rng.poisson(np.maximum(light * scene, 0)) * 0.4 + rng.normal(64, 2, scene.shape)
        for light in (1.0, lamp)
    )
    return np.rint(np.clip(one, 0, 4095)), np.rint(np.clip(other, 0, 4095))


@pytest.mark.parametrize("lamp", [1.0, 1.05])
def test_detail_fixed_pattern_and_a_lamp_that_drifts_are_no_noise(lamp: float) -> None:
    found = noise_of_pair(*frames(lamp), NOISE)
    assert found is not None
    assert found.uncertainty < 0.004
    assert found.ratio == pytest.approx(1, abs=3 * found.uncertainty)


def test_a_gain_that_is_not_as_stated_shows() -> None:
    """Shot noise in DN is the root of gain times signal."""
    found = noise_of_pair(*frames(), replace(NOISE, dn_per_electron=0.3, read_noise_dn=1.0))
    assert found is not None
    assert found.ratio == pytest.approx(np.sqrt(4 / 3), abs=0.01)


def test_saturated_frames_say_nothing() -> None:
    full = np.full((100, 100), 4095.0)
    assert noise_of_pair(full, full, NOISE) is None

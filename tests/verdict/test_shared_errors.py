"""What numbers of several kinds or configurations have in common in their noise."""

import numpy as np
import pytest

from flflab.verdict.properties.light import over_their_mean
from flflab.verdict.properties.values import Shared, joined, single

DRAWS = np.random.default_rng(0).normal(size=200)


def test_errors_of_one_name_are_one_error() -> None:
    by = np.array([[0.3, 0.4]])
    one = single(0, "bright_field_mm", "white", 1.0, 0.5, DRAWS, Shared("lattice 0", by))
    other = single(0, "total_field_mm", "white", 2.0, 0.5, DRAWS, Shared("lattice 0", by[:, ::-1]))
    elsewhere = single(1, "bright_field_mm", "white", 1.0, 0.5, DRAWS, Shared("lattice 1", by))
    _, noise, _ = joined([one, other, elsewhere])
    np.testing.assert_allclose(noise, [[0.25, 0.24, 0.0], [0.24, 0.25, 0.0], [0.0, 0.0, 0.25]])


def test_readings_over_their_own_mean_scatter_as_stated() -> None:
    """One reading too bright is a mean too bright: taken as independent, p-values of marginal light
    lay at 0.66 in the middle.
    """
    rng, true, unsure = (
        np.random.default_rng(1),
        np.array([1.0, 0.5, 2.0]),
        np.array([0.01, 0.02, 0.01]),
    )
    ratios = np.array(
        [
            over_their_mean(true * (1 + unsure * rng.normal(size=3)), unsure)[0]
            for _ in range(20_000)
        ]
    )
    _, by = over_their_mean(true, unsure)
    np.testing.assert_allclose(
        np.cov(ratios.T), by @ by.T, rtol=0.03, atol=0.01 * (by @ by.T).max()
    )
    assert ratios.sum(axis=1) == pytest.approx(3.0)

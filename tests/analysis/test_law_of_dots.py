"""The law of a picture's dots is that of its spots, wherever the description puts them."""

import numpy as np
import numpy.typing as npt
import pytest

from flflab.analysis.spots.law import law_at, regress

Array = npt.NDArray[np.float64]
PIXEL, DOTS, PARALLAX = 0.0035, 0.0174, 0.31


def regressors(views: Array) -> Array:
    """Four dots 2 mm apart, each seen in micro-images 0.26 mm apart about its chief ray's."""
    dots = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    return np.array([[1.0, *dot, *(0.26 * np.rint(-0.2 * dot / 0.26) + 0.26 * view)] for dot in dots for view in views])


def test_spots_are_not_drawn_to_the_nominal_law() -> None:
    """A parallax 2 % off the nominal was drawn there by a fortieth of that, the dots' radius with it, the focus, and depth by 4.6 of its
    uncertainty."""
    rows = regressors(np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)]))
    true, nominal = law_at(DOTS * 1.01, PARALLAX * 1.02), law_at(DOTS, PARALLAX)
    found, _, _ = regress(nominal, nominal, rows, rows @ true, PIXEL)
    assert np.hypot(*found[1]) / np.hypot(*true[1]) == pytest.approx(1, abs=5e-5)
    assert np.hypot(*found[3]) / np.hypot(*true[3]) == pytest.approx(1, abs=1e-4)


def test_what_spots_cannot_tell_is_nominal() -> None:
    """Dots seen once each, as far from the axis as their micro-images, say the sum of both factors alone."""
    rows = regressors(np.zeros((1, 2)))
    rows[:, 3:] = -0.2 * rows[:, 1:3]
    nominal = law_at(DOTS, PARALLAX)
    found, _, _ = regress(nominal, nominal, rows, rows @ law_at(DOTS * 1.01, PARALLAX), PIXEL)
    seen, due = (law[1] - 0.2 * law[3] for law in (found, law_at(DOTS * 1.01, PARALLAX)))
    np.testing.assert_allclose(seen, due, atol=1e-6)
    assert np.abs(found[3] - nominal[3]).max() < 0.01 * PARALLAX

"""The law of a picture's dots is that of its spots, wherever the description puts them."""

import numpy as np
import numpy.typing as npt
import pytest

from flflab.measurement.spots.law import law_at, regress

Array = npt.NDArray[np.float64]
PIXEL, DOTS, PARALLAX = 0.0035, 0.0174, 0.31


def regressors(views: Array) -> Array:
    """Four dots 2 mm apart, each seen in micro-images 0.26 mm apart about its chief ray's."""
    dots = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    return np.array(
        [
            [1.0, *dot, *(0.26 * np.rint(-0.2 * dot / 0.26) + 0.26 * view)]
            for dot in dots
            for view in views
        ]
    )


def test_spots_are_not_drawn_to_the_nominal_law() -> None:
    """A parallax 2 % off the nominal was drawn there by a fortieth of that, the dots' radius with
    it, the focus, and depth by 4.6 of its uncertainty.
    """
    rows = regressors(np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)]))
    true, nominal = law_at(DOTS * 1.01, PARALLAX * 1.02), law_at(DOTS, PARALLAX)
    found, _, _ = regress(nominal, nominal, rows, rows @ true, PIXEL)
    assert np.hypot(*found[1]) / np.hypot(*true[1]) == pytest.approx(1, abs=5e-5)
    assert np.hypot(*found[3]) / np.hypot(*true[3]) == pytest.approx(1, abs=1e-4)


def test_what_spots_cannot_tell_is_nominal() -> None:
    """Dots seen once each, as far from the axis as their micro-images, say the sum of both factors
    alone.
    """
    rows = regressors(np.zeros((1, 2)))
    rows[:, 3:] = -0.2 * rows[:, 1:3]
    nominal = law_at(DOTS, PARALLAX)
    found, _, _ = regress(nominal, nominal, rows, rows @ law_at(DOTS * 1.01, PARALLAX), PIXEL)
    seen, due = (law[1] - 0.2 * law[3] for law in (found, law_at(DOTS * 1.01, PARALLAX)))
    np.testing.assert_allclose(seen, due, atol=1e-6)
    assert np.abs(found[3] - nominal[3]).max() < 0.01 * PARALLAX


def test_a_size_that_no_spots_tell_is_as_unsure_as_described() -> None:
    """A single spot says where the picture lies, and the size of the square is the nominal one:
    with no doubt at all the focus divided by it.
    """
    nominal = law_at(DOTS, PARALLAX)
    found, _, doubt = regress(
        nominal, nominal, regressors(np.zeros((1, 2)))[:1], np.array([[0.01, 0.02]]), PIXEL
    )
    assert np.hypot(*found[1]) == pytest.approx(DOTS)
    assert doubt == pytest.approx(0.1 * DOTS, rel=0.01)


def test_a_size_that_spots_tell_is_as_unsure_as_they_scatter() -> None:
    """Over 400 noises the size varies by what is stated of it."""
    rows = regressors(np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)]))
    nominal, noise = (
        law_at(DOTS, PARALLAX),
        np.random.default_rng(3).normal(0, 0.02 * PIXEL, (400, len(rows), 2)),
    )
    found = [regress(nominal, nominal, rows, rows @ nominal + one, PIXEL) for one in noise]
    sizes, doubts = np.array([(np.hypot(*law[1]), doubt) for law, _, doubt in found]).T
    assert np.std(sizes) / np.sqrt(np.mean(doubts**2)) == pytest.approx(1, abs=0.12)

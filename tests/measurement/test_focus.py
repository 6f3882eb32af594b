"""The figure of focus against pictures whose differences are known, and its noise against drawn
noise.
"""

import numpy as np
import pytest

from flflab.measurement.focus import focus_figure, parabola_top


def test_a_sine_has_the_figure_of_its_contrast_whatever_its_brightness() -> None:
    contrast, period = 0.4, 12.0
    wave = 1 + contrast * np.cos(2 * np.pi * np.arange(240) / period)
    # <(s(x + 2) - s(x))^2> = 2 C^2 sin^2(2 pi / period) of a sine of mean 1
    due = np.sqrt(2) * contrast * np.sin(2 * np.pi / period)
    for light in (50.0, 3000.0):
        picture = 64 + light * np.tile(wave, (60, 1))
        assert focus_figure(picture, 64.0) == pytest.approx(due, rel=0.01)
        assert focus_figure(picture.T, 64.0) == pytest.approx(due, rel=0.01)


def test_noise_adds_nothing_on_average_and_darkness_is_no_focus() -> None:
    rng = np.random.default_rng(4)
    flat = np.full((400, 600), 300.0)
    noisy = 64 + 0.5 * rng.poisson(flat / 0.5) + rng.normal(0, 2, flat.shape)
    blind = focus_figure(noisy, 64.0)
    assert blind == pytest.approx(np.sqrt(4 * (150 + 4)) / 300, rel=0.02)
    assert focus_figure(noisy, 64.0, 0.5, 2.0) < 0.15 * blind
    assert focus_figure(np.full((30, 30), 64, np.uint16), 64.0) == 0.0
    assert focus_figure(np.full((30, 30), 60, np.uint16), 64.0) == 0.0


def test_the_top_of_a_parabola_is_found_between_readings_and_not_at_an_end() -> None:
    readings = np.array([3.0, 3.5, 4.0, 4.5])
    assert parabola_top(readings, 2 - (readings - 3.8) ** 2) == pytest.approx(3.8)
    assert parabola_top(readings[::-1], 2 - (readings[::-1] - 3.8) ** 2) == pytest.approx(3.8)
    assert parabola_top(readings, readings) is None

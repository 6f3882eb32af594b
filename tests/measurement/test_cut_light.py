"""The light of a cut spot in a pixel, against areas in closed form that its fit does not use, and
its slopes against differences.
"""

import math

import numpy as np
import pytest

from flflab.measurement.spots.cut_light import common_area, pixel_in_disc
from flflab.optics.discs import disc_rectangle_area, three_disc_area

REPEATS = 2000


def test_the_share_of_a_pixel_in_a_disc_is_the_closed_form_for_discs_of_every_size() -> None:
    rng = np.random.default_rng(0)
    for radius in np.exp(rng.uniform(math.log(0.3), math.log(100), REPEATS)):
        turn, away = rng.uniform(0, 2 * math.pi), max(radius + rng.uniform(-1.2, 1.2), 0.0)
        left, bottom = away * math.cos(turn) - 0.5, away * math.sin(turn) - 0.5
        share, by_x, by_y = pixel_in_disc(radius, left, bottom)
        assert share == pytest.approx(_area(radius, left, bottom), abs=1e-7)
        # as the disc moves right, the pixel lies further left in it
        step = 1e-4
        assert by_x == pytest.approx(
            (_area(radius, left - step, bottom) - _area(radius, left + step, bottom)) / (2 * step),
            abs=0.02,
        )
        assert by_y == pytest.approx(
            (_area(radius, left, bottom - step) - _area(radius, left, bottom + step)) / (2 * step),
            abs=0.02,
        )


def _area(radius: float, left: float, bottom: float) -> float:
    return disc_rectangle_area(radius, left, left + 1, bottom, bottom + 1)


def test_the_area_common_to_three_discs_is_the_closed_form_however_they_lie() -> None:
    rng = np.random.default_rng(1)
    for n in range(REPEATS):
        small, main, dot = (
            rng.uniform(1, 20),
            rng.uniform(1, 40),
            math.exp(rng.uniform(0, math.log(300))),
        )
        main_x, main_y = rng.normal(0, (small + main) / 2, 2)
        if n % 7 == 0:  # as alike and as concentric as apertures may be
            main, main_x, main_y = small, 0.0, 0.0
        turn, away = rng.uniform(0, 2 * math.pi), abs(dot + rng.uniform(-small, small))
        dot_x, dot_y = away * math.cos(turn), away * math.sin(turn)
        area, length, out_x, out_y = common_area(small, main_x, main_y, main, dot_x, dot_y, dot)
        most = math.pi * min(small, main) ** 2

        def common(x: float, y: float, radius: float) -> float:
            return three_disc_area(0.0, 0.0, small, main_x, main_y, main, x, y, radius)  # noqa: B023

        assert area == pytest.approx(common(dot_x, dot_y, dot), abs=1e-9 * most)
        step = 1e-4
        for slope, more, less in (
            (length, common(dot_x, dot_y, dot + step), common(dot_x, dot_y, dot - step)),
            (out_x, common(dot_x + step, dot_y, dot), common(dot_x - step, dot_y, dot)),
            (out_y, common(dot_x, dot_y + step, dot), common(dot_x, dot_y - step, dot)),
        ):
            assert slope == pytest.approx((more - less) / (2 * step), abs=0.02 * math.sqrt(most))

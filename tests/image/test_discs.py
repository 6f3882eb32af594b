"""Overlapping discs against 60-digit arithmetic and against counting."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from mpmath import mp, mpf

from flflab.errors import InputError
from flflab.optics.discs import (
    disc_rectangle_area,
    lens_chord,
    lens_rows,
    three_disc_area,
    two_disc_area,
    two_disc_areas,
)

UNIT = 2.0**-53


def exact(radius1: float, radius2: float, distance: float) -> mpf:
    r, R, d = (
        sorted((mpf(radius1), mpf(radius2)))[0],
        max(mpf(radius1), mpf(radius2)),
        mpf(distance),
    )
    if d >= r + R:
        return mpf(0)
    if d <= R - r:
        return mp.pi * r**2
    a, b = (
        mp.acos((d * d + r * r - R * R) / (2 * d * r)),
        mp.acos((d * d + R * R - r * r) / (2 * d * R)),
    )
    return r * r * (a - mp.sin(a) * mp.cos(a)) + R * R * (b - mp.sin(b) * mp.cos(b))


def hard_inputs(count: int, seed: int) -> tuple[npt.NDArray[np.float64], ...]:
    """Radii up to 1 : 1e9, a third each near outer tangency, near nesting, and anywhere between."""
    rng = np.random.default_rng(seed)
    r = 10 ** rng.uniform(-3, 3, count)
    R = r * np.where(
        rng.random(count) < 0.3,
        1 + 10 ** rng.uniform(-15, 0, count),
        10 ** rng.uniform(0, 9, count),
    )
    gap = 10 ** rng.uniform(-15, 0, count)
    between = np.abs(R - r) + (r + R - np.abs(R - r)) * rng.random(count)
    kind = rng.integers(0, 3, count)
    return (
        r,
        R,
        np.where(
            kind == 0,
            (r + R) * (1 - gap * r / R),
            np.where(kind == 1, np.abs(R - r) + r * gap, between),
        ),
    )


def worst_error(count: int, seed: int) -> float:
    """Largest relative error in units of roundoff."""
    inputs = hard_inputs(count, seed)
    areas = two_disc_areas(*inputs)
    worst = 0.0
    with mp.workdps(60):
        for area, *given in zip(areas, *inputs, strict=True):
            truth = exact(*given)
            worst = max(
                worst,
                float(abs(mpf(area) - truth) / truth) / UNIT
                if truth
                else (0.0 if area == 0 else math.inf),
            )
    return worst


def test_two_discs_to_8_units_of_roundoff() -> None:
    assert worst_error(3000, 1) <= 8


@pytest.mark.full
def test_two_discs_to_8_units_of_roundoff_over_a_million() -> None:
    assert worst_error(1_000_000, 2) <= 8


@pytest.mark.parametrize(
    ("radius1", "radius2", "distance", "area"),
    [
        (1.0, 1.0, 2.0, 0.0),
        (1.0, 2.0, 1.0, math.pi),
        (1.0, 1.0, 0.0, math.pi),
        (3.0, 0.0, 1.0, 0.0),
        (0.0, 0.0, 0.0, 0.0),
        (1.0, 2.0, 3.5, 0.0),
        (1.0, 1.0, 1.0, 2 * math.pi / 3 - math.sqrt(3) / 2),
        (1e9, 1.0, 0.0, math.pi),
        (1.0, 1e9, 1e9 + 1, 0.0),
    ],
)
def test_tangent_nested_coinciding_and_empty_discs(
    radius1: float, radius2: float, distance: float, area: float
) -> None:
    assert two_disc_area(radius1, radius2, distance) == pytest.approx(area, rel=1e-15)
    assert two_disc_area(radius2, radius1, distance) == two_disc_area(radius1, radius2, distance)


@pytest.mark.parametrize("given", [(-1.0, 1.0, 1.0), (1.0, math.nan, 1.0), (1.0, 1.0, math.inf)])
def test_impossible_discs_are_refused(given: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="allowed"):
        two_disc_areas(*given)


def counted(inside: npt.NDArray[np.bool_]) -> float:
    return 9.0 * float(np.count_nonzero(inside)) / inside.size


def test_three_discs_and_a_disc_in_a_rectangle_agree_with_counting() -> None:
    places = (np.arange(1200) + 0.5) / 400 - 1.5
    x, y = np.meshgrid(places, places)
    unit = x**2 + y**2 <= 1
    rng = np.random.default_rng(3)
    for _ in range(40):
        x2, y2, x3, y3 = rng.uniform(-1.5, 1.5, 4)
        r2, r3 = rng.uniform(0.1, 2.0, 2)
        three = (
            unit
            & ((x - x2) ** 2 + (y - y2) ** 2 <= r2**2)
            & ((x - x3) ** 2 + (y - y3) ** 2 <= r3**2)
        )
        assert three_disc_area(0.0, 0.0, 1.0, x2, y2, r2, x3, y3, r3) == pytest.approx(
            counted(three), abs=6e-4
        )
        left, right = np.sort(np.round(rng.uniform(-1.5, 1.5, 2) * 400) / 400)
        bottom, top = np.sort(np.round(rng.uniform(-1.5, 1.5, 2) * 400) / 400)
        cut = unit & (x > left) & (x < right) & (y > bottom) & (y < top)
        assert disc_rectangle_area(1.0, left, right, bottom, top) == pytest.approx(
            counted(cut), abs=6e-4
        )


def test_a_third_disc_that_cuts_nothing_off_leaves_two() -> None:
    lens = two_disc_area(1.0, 1.2, 0.8)
    assert three_disc_area(0.0, 0.0, 1.0, 0.8, 0.0, 1.2, 0.3, 0.1, 50.0) == pytest.approx(
        lens, rel=1e-14
    )
    assert three_disc_area(0.0, 0.0, 1.0, 0.8, 0.0, 1.2, 0.0, 0.0, 1.0) == pytest.approx(
        lens, rel=1e-14
    )
    assert three_disc_area(0.0, 0.0, 1.0, 0.8, 0.0, 1.2, 9.0, 0.0, 1.0) == 0.0
    assert three_disc_area(0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0) == pytest.approx(math.pi)


def test_a_third_disc_of_huge_radius_cuts_like_a_line() -> None:
    for radius in (1e3, 1e6):
        area = three_disc_area(0.0, 0.0, 1.0, 0.0, 0.0, 1.5, radius, 0.0, radius)
        assert area == pytest.approx(
            math.pi / 2 - 1 / (3 * radius), rel=1e-5
        )  # the half disc less the sagitta's sliver


def test_the_strips_of_a_lens_add_up_to_its_area() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        radius = float(rng.uniform(0.2, 4.0))
        distance = float(rng.uniform(0.0, 1.0 + radius))
        angle = float(rng.uniform(0.0, 2 * math.pi))
        x, y = distance * math.cos(angle), distance * math.sin(angle)
        low, high = lens_rows(x, y, radius)
        heights = low + (high - low) * (np.arange(4000) + 0.5) / 4000
        chords = [
            max(0.0, right - left)
            for left, right in (lens_chord(x, y, radius, float(at)) for at in heights)
        ]
        assert (high - low) * float(np.mean(chords)) == pytest.approx(
            two_disc_area(1.0, radius, distance), abs=2e-4
        )

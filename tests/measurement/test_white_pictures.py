"""The generator of white pictures: its pixels against dense sums, its truth against centroids."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from white_pictures.drawing import draw_light, draw_white
from white_pictures.matching import compare_lattice, match
from white_pictures.profiles import SoftDisc
from white_pictures.spec import Layout, WhiteSpec


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def dense_mean(pixel: tuple[int, int], spec: Any, truth: Any, points: int = 80) -> float:
    """Mean of the light over a pixel from 80 x 80 points, for a spec whose micro-images are round,
    by the formulas that ``WhiteSpec`` states.
    """
    steps = (np.arange(points) + 0.5) / points - 0.5
    x, y = pixel[1] + steps[None, :], pixel[0] + steps[:, None]
    rows, columns = spec.shape
    middle = np.array([(columns - 1) / 2 + spec.axis[0], (rows - 1) / 2 + spec.axis[1]])
    corner = math.hypot(columns / 2 + abs(spec.axis[0]), rows / 2 + abs(spec.axis[1]))
    half = spec.profile.radius
    total = np.zeros((points, points))
    for centre, light in zip(truth.centre, truth.light, strict=True):
        away = (centre - middle) / corner
        dx, dy = x - centre[0], y - centre[1]
        if np.hypot(*(centre - pixel[::-1])) > 3 * half:
            continue
        aspect = 1 + (spec.second_stop - 1) * np.sum(away**2)
        stops = half * (aspect**2 - 1) / (aspect**2 + 1) * away / np.hypot(*away)
        r = np.maximum(
            np.hypot(dx - stops[0], dy - stops[1]), np.hypot(dx + stops[0], dy + stops[1])
        )
        turn = math.radians(spec.slope_angle)
        slope = spec.slope * np.array([math.cos(turn), math.sin(turn)])
        slope = (slope + spec.slope_at_corner * away) / (2 * half)
        ratio = spec.rounding / (1 - spec.rounding)
        rounding = 1 + ratio * (dx**2 + dy**2) / half**2
        total += light * spec.profile.light(r) * (1 + slope[0] * dx + slope[1] * dy) / rounding
    return float(total.mean())


@pytest.mark.parametrize("layout", ["square", "hexagonal along x", "hexagonal along y"])
def test_pixels_hold_the_mean_of_the_light(layout: Layout, rng: np.random.Generator) -> None:
    spec = WhiteSpec(
        shape=(150, 170),
        layout=layout,
        pitch=23.0,
        angle=3.0,
        profile=SoftDisc(12.5, 0.4),
        scatter=0.2,
        brightness=0.02,
        corner=0.5,
        slope=0.1,
        slope_angle=40.0,
        slope_at_corner=0.1,
        rounding=0.3,
        second_stop=1.3,
        bend=0.4,
        axis=(12.0, -7.0),
    )
    light, truth = draw_light(spec, rng)
    pixels = [(int(rng.integers(150)), int(rng.integers(170))) for _ in range(150)]
    wrong = [light[pixel] - dense_mean(pixel, spec, truth) for pixel in pixels]
    assert np.abs(wrong).max() < 1e-4


def test_halo_and_blur_move_light_and_lose_none(rng: np.random.Generator) -> None:
    plain = WhiteSpec(shape=(900, 900), pitch=899.0)
    spread = replace(plain, halo=0.1, halo_length=12.0, blur=1.5)
    before, after = (draw_light(spec, rng)[0] for spec in (plain, spread))
    assert after.sum() == pytest.approx(before.sum(), rel=1e-4)
    y, x = np.indices(before.shape) - 449.5
    r = np.hypot(x, y)
    beyond = after[r > 60].sum() / before.sum()
    # light of an exponential beyond r is (1 + r/L) exp(-r/L); the disc's own extent adds a little
    expected = 0.05 * (6 * math.exp(-5) + (1 + 5 / 3) * math.exp(-5 / 3))
    assert beyond == pytest.approx(expected, rel=0.05)


def test_the_true_centre_is_where_a_centroid_is(rng: np.random.Generator) -> None:
    spec = WhiteSpec(
        pitch=40.0,
        angle=-4.0,
        stretch=0.01,
        shear=0.004,
        profile=SoftDisc(14.0, 0.8),
        aspect=0.05,
        aspect_angle=30.0,
        scatter=0.3,
        bend=0.5,
        second_stop=1.2,
        rounding=0.2,
        corner=0.4,
        brightness=0.02,
        kinds=(1.0, 1.03, 0.97),
    )
    light, truth = draw_light(spec, rng)
    y, x = np.indices(spec.shape)
    for n in np.flatnonzero(truth.whole)[::6]:
        near = np.hypot(x - truth.centre[n, 0], y - truth.centre[n, 1]) < 19.5
        share = np.where(near, light, 0.0) / light[near].sum()
        centroid = np.array([(share * x).sum(), (share * y).sum()])
        assert np.abs(centroid - truth.centre[n]).max() < 2e-4


def test_the_true_lattice_is_the_drawn_one_whatever_bends_it(rng: np.random.Generator) -> None:
    cases: list[tuple[Layout, float, float]] = [
        ("square", 50.0, -40.0),
        ("hexagonal along x", 3.0, 3.0),
        ("hexagonal along y", 3.0, -27.0),
    ]
    for layout, angle, expected in cases:
        spec = WhiteSpec(layout=layout, angle=angle, pitch=31.0, bend=0.4)
        _, truth = draw_light(spec, rng)
        assert truth.lattice.pitch == pytest.approx(31.0, abs=2e-3)
        assert truth.lattice.angle == pytest.approx(expected, abs=2e-3)
        left = (truth.centre - truth.lattice.at(truth.index))[truth.whole]
        assert math.sqrt(np.mean(np.sum(left**2, axis=1))) == pytest.approx(0.4, rel=0.05)


def test_shot_noise_and_black_level_are_those_of_the_sensor(rng: np.random.Generator) -> None:
    spec = WhiteSpec(profile=SoftDisc(12.0, 0.5))
    light, _ = draw_light(spec, rng)
    picture, _ = draw_white(spec, rng)
    lit, dark = picture[light > 1 - 1e-6], picture[light < 1e-9]
    assert lit.mean() == pytest.approx(40500, rel=1e-3)
    assert lit.std() == pytest.approx(4 * math.sqrt(10000 + 25), rel=0.02)
    assert dark.mean() == pytest.approx(500, abs=1)
    assert dark.std() == pytest.approx(20, rel=0.05)


def test_what_was_found_is_matched_to_what_was_drawn(rng: np.random.Generator) -> None:
    spec = WhiteSpec(layout="hexagonal along x", angle=2.0, missing=2)
    _, truth = draw_light(spec, rng)
    whole = np.flatnonzero(truth.whole)
    noise = rng.normal(0, 0.02, (len(whole), 2))
    turned = truth.index[whole] @ np.array([[0, -1], [1, 1]]) + [3, -5]  # by 60 degrees, shifted
    stray = truth.centre[truth.missing]
    centres = np.vstack([truth.centre[whole] + noise, stray])
    indices = np.vstack([turned, [[90, 90], [91, 90]]])
    matched = match(truth, centres, indices)
    assert matched.found.tolist() == list(range(len(whole)))
    assert matched.overlooked.size == 0
    assert matched.index_is_right
    np.testing.assert_allclose(matched.error, noise, atol=1e-9)
    assert matched.z(np.full((len(centres), 2), 0.02)).std() == pytest.approx(1, rel=0.1)
    indices[0] += 1
    assert not match(truth, centres, indices).index_is_right


def test_a_lattice_is_compared_up_to_its_symmetry(rng: np.random.Generator) -> None:
    spec = WhiteSpec(layout="hexagonal along x", angle=29.0)
    _, truth = draw_light(spec, rng)
    drawn = truth.lattice
    origin = drawn.origin + drawn.vectors @ [4, -3] + [0.01, -0.02]
    found = compare_lattice(drawn, origin, drawn.pitch + 1e-3, -31.5)
    assert found.pitch == pytest.approx(1e-3)
    assert found.angle == pytest.approx(-0.5)
    np.testing.assert_allclose(found.origin, [0.01, -0.02], atol=1e-9)

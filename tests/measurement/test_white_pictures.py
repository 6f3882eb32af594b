"""The generator of white pictures: its pixels against dense sums, its truth against centroids."""

import math
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[np.float64]


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
def test_pixels_hold_the_mean_of_the_light(
    layout: str, white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(
        shape=(150, 170),
        layout=layout,
        pitch=23.0,
        angle=3.0,
        profile=white_pictures.SoftDisc(12.5, 0.4),
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
    light, truth = white_pictures.draw_light(spec, rng)
    pixels = [(int(rng.integers(150)), int(rng.integers(170))) for _ in range(150)]
    wrong = [light[pixel] - dense_mean(pixel, spec, truth) for pixel in pixels]
    assert np.abs(wrong).max() < 1e-4


@pytest.mark.parametrize("radii", [(13.0, 0.9), (20.0, 6.0), (72.2, 23.8), (7.0, 7.0)])
def test_a_pupil_seen_through_a_lens_keeps_its_light(
    radii: tuple[float, float], white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(
        shape=(200, 200), pitch=199.0, profile=white_pictures.OverlappingDiscs(*radii)
    )
    light, _ = white_pictures.draw_light(spec, rng)
    assert light.sum() == pytest.approx(math.pi * max(radii) ** 2, rel=2e-5)


def test_discs_and_spots_keep_their_light(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    disc = white_pictures.WhiteSpec(shape=(200, 200), pitch=199.0)
    light, _ = white_pictures.draw_light(disc, rng)
    assert light.sum() == pytest.approx(math.pi * (12.0**2 + 1.0**2), rel=1e-5)
    spot = replace(disc, profile=white_pictures.Blob(1.6))
    light, _ = white_pictures.draw_light(spot, rng)
    assert light.sum() == pytest.approx(math.pi * 1.6**2 / math.log(2), rel=1e-5)


def test_halo_and_blur_move_light_and_lose_none(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    plain = white_pictures.WhiteSpec(shape=(900, 900), pitch=899.0)
    spread = replace(plain, halo=0.1, halo_length=12.0, blur=1.5)
    before, after = (white_pictures.draw_light(spec, rng)[0] for spec in (plain, spread))
    assert after.sum() == pytest.approx(before.sum(), rel=1e-4)
    y, x = np.indices(before.shape) - 449.5
    r = np.hypot(x, y)
    beyond = after[r > 60].sum() / before.sum()
    # light of an exponential beyond r is (1 + r/L) exp(-r/L); the disc's own extent adds a little
    expected = 0.05 * (6 * math.exp(-5) + (1 + 5 / 3) * math.exp(-5 / 3))
    assert beyond == pytest.approx(expected, rel=0.05)


def test_the_true_centre_is_where_a_centroid_is(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(
        pitch=40.0,
        angle=-4.0,
        stretch=0.01,
        shear=0.004,
        profile=white_pictures.SoftDisc(14.0, 0.8),
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
    light, truth = white_pictures.draw_light(spec, rng)
    y, x = np.indices(spec.shape)
    for n in np.flatnonzero(truth.whole)[::6]:
        near = np.hypot(x - truth.centre[n, 0], y - truth.centre[n, 1]) < 19.5
        share = np.where(near, light, 0.0) / light[near].sum()
        centroid = np.array([(share * x).sum(), (share * y).sum()])
        assert np.abs(centroid - truth.centre[n]).max() < 2e-4
        above = near & (light > 0.5 * truth.light[n])
        assert math.sqrt(above.sum() / math.pi) == pytest.approx(
            truth.half_light_radius[n], abs=0.15
        )


def test_the_true_lattice_is_the_drawn_one(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    for layout, angle, expected in (
        ("square", 50.0, -40.0),
        ("hexagonal along x", 3.0, 3.0),
        ("hexagonal along y", 3.0, -27.0),
    ):
        spec = white_pictures.WhiteSpec(
            layout=layout, angle=angle, pitch=31.0, scatter=0.2, stretch=0.002, shear=0.001
        )
        _, truth = white_pictures.draw_light(spec, rng)
        assert truth.lattice.pitch == pytest.approx(31.0, abs=1e-9)
        assert truth.lattice.angle == pytest.approx(expected, abs=1e-9)
        assert truth.scatter == pytest.approx(0.2, rel=0.1)


def test_a_bend_is_as_large_as_it_says_and_keeps_the_pitch(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    _, truth = white_pictures.draw_light(white_pictures.WhiteSpec(bend=0.4), rng)
    left = (truth.centre - truth.lattice.at(truth.index))[truth.whole]
    assert math.sqrt(np.mean(np.sum(left**2, axis=1))) == pytest.approx(0.4, rel=1e-6)
    assert np.abs(left.mean(axis=0)).max() < 1e-9
    assert truth.lattice.pitch == pytest.approx(30.0, abs=1e-9)


def test_shot_noise_and_black_level_are_those_of_the_sensor(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(profile=white_pictures.SoftDisc(12.0, 0.5))
    light, _ = white_pictures.draw_light(spec, rng)
    picture, _ = white_pictures.draw_white(spec, rng)
    lit, dark = picture[light > 1 - 1e-6], picture[light < 1e-9]
    assert lit.mean() == pytest.approx(40500, rel=1e-3)
    assert lit.std() == pytest.approx(4 * math.sqrt(10000 + 25), rel=0.02)
    assert dark.mean() == pytest.approx(500, abs=1)
    assert dark.std() == pytest.approx(20, rel=0.05)


def test_what_was_found_is_matched_to_what_was_drawn(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(layout="hexagonal along x", angle=2.0, missing=2)
    _, truth = white_pictures.draw_light(spec, rng)
    whole = np.flatnonzero(truth.whole)
    noise = rng.normal(0, 0.02, (len(whole), 2))
    turned = truth.index[whole] @ np.array([[0, -1], [1, 1]]) + [3, -5]  # by 60 degrees, shifted
    stray = truth.centre[truth.missing]
    centres = np.vstack([truth.centre[whole] + noise, stray])
    indices = np.vstack([turned, [[90, 90], [91, 90]]])
    matched = white_pictures.match(truth, centres, indices)
    assert matched.invented.tolist() == [len(whole), len(whole) + 1]
    assert matched.overlooked.size == 0
    assert matched.index_is_right
    np.testing.assert_allclose(matched.error, noise, atol=1e-9)
    assert matched.z(np.full(len(centres), 0.02)).std() == pytest.approx(1, rel=0.1)
    indices[0] += 1
    assert not white_pictures.match(truth, centres, indices).index_is_right


def test_a_lattice_is_compared_up_to_its_symmetry(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(layout="hexagonal along x", angle=29.0)
    _, truth = white_pictures.draw_light(spec, rng)
    drawn = truth.lattice
    origin = drawn.origin + drawn.vectors @ [4, -3] + [0.01, -0.02]
    others = drawn.vectors @ np.array([[0, -1], [1, 1]])
    found = white_pictures.compare_lattice(drawn, origin, drawn.pitch + 1e-3, -31.5, others)
    assert found.pitch == pytest.approx(1e-3)
    assert found.angle == pytest.approx(-0.5)
    np.testing.assert_allclose(found.origin, [0.01, -0.02], atol=1e-9)
    assert found.vectors < 1e-9


def test_half_of_a_covered_lens_is_dark_and_a_dead_one_nearly_all(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(dead=3, half_covered=3, missing=3)
    light, truth = white_pictures.draw_light(spec, rng)
    y, x = np.indices(spec.shape)

    def flux(flags: npt.NDArray[np.bool_]) -> list[float]:
        near = [np.hypot(x - c[0], y - c[1]) < 15 for c in truth.centre[flags][:20]]
        return [float(light[one].sum()) / (145 * math.pi) for one in near]

    assert flux(truth.half_covered) == pytest.approx([0.5] * 3, abs=0.01)
    assert flux(truth.missing) == pytest.approx([0.0] * 3, abs=1e-3)
    dead = flux(truth.dead)
    assert len(dead) == 3
    assert 0.02 <= min(dead) <= max(dead) <= 0.22
    assert flux(truth.whole) == pytest.approx([1.0] * 20, abs=1e-3)


def test_kinds_alternate_between_neighbours(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.WhiteSpec(layout="hexagonal along y", kinds=(1.0, 0.9, 1.1))
    _, truth = white_pictures.draw_light(spec, rng)
    matched = {tuple(index): kind for index, kind in zip(truth.index, truth.kind, strict=True)}
    for (i, j), kind in matched.items():
        for step in ((1, 0), (0, 1), (1, -1)):
            assert matched.get((i + step[0], j + step[1]), -1) != kind
    np.testing.assert_allclose(truth.radius, 12.0 * np.array(spec.kinds)[truth.kind], rtol=1e-6)


def test_no_lens_stands_in_unlit_surrounds(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    light, truth = white_pictures.draw_light(white_pictures.WhiteSpec(margin=150.0), rng)
    assert truth.whole.all()
    assert light[:130].max() == light[:, -130:].max() == 0
    assert light[300].max() > 0.99


def test_the_share_of_saturated_pixels_is_the_one_asked_for(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    readout = white_pictures.Readout(saturated=0.02)
    spec = white_pictures.WhiteSpec(rounding=0.2, readout=readout)
    picture, truth = white_pictures.draw_white(spec, rng)
    assert np.mean(picture == 65535) == truth.saturated == pytest.approx(0.02, rel=0.3)


@pytest.mark.ci
def test_random_whites_hold_enough_lenses_and_do_not_saturate(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    layouts: set[str] = set()
    for _ in range(8):
        spec = white_pictures.random_spec(rng)
        picture, truth = white_pictures.draw_white(spec, rng)
        layouts.add(spec.layout)
        assert picture.shape == spec.shape
        assert truth.whole.sum() >= 20
        assert truth.saturated == 0
        assert truth.lattice.pitch == pytest.approx(spec.pitch, rel=1e-5)
    assert len(layouts) == 3


def test_hardness_of_nothing_leaves_only_noise(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.random_spec(rng, 0.0)
    ideal = white_pictures.WhiteSpec()
    for name in ("scatter", "brightness", "slope", "rounding", "second_stop", "halo", "bend"):
        assert getattr(spec, name) == getattr(ideal, name)
    assert (spec.dead, spec.half_covered, spec.missing) == (0, 0, 0)


def test_pictures_that_are_no_whites_are_pictures(
    white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    for name, make in white_pictures.NOT_WHITES.items():
        picture = make((420, 500), rng)
        assert (picture.shape, picture.dtype) == ((420, 500), np.uint16), name


@pytest.mark.parametrize("name", ["GUV-like", "R12-like", "touching", "unlit surrounds"])
def test_a_named_white_can_be_drawn(
    name: str, white_pictures: ModuleType, rng: np.random.Generator
) -> None:
    spec = white_pictures.NAMED[name]
    picture, truth = white_pictures.draw_white(spec, rng)
    assert picture.shape == spec.shape
    assert truth.lattice.pitch == pytest.approx(spec.pitch, rel=1e-5)

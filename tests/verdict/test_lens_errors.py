"""Arrays whose lenses differ: what a drawn array shows, against arrays built lens by lens."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import Bench, read_bench
from flflab.bench_uncertainty import WorkmanshipDescription
from flflab.lens_errors import EQUAL_LENSES, LensErrors, numbers_of
from flflab.optics.camera import microlens_centres
from flflab.optics.light import Spectrum
from flflab.verdict.prediction import (
    contrast_draws,
    placements,
    predicted_view_indices,
    view_draws,
)
from flflab.verdict.sources import drawn_errors

BENCH = Path(__file__).parents[2] / "examples" / "benches" / "simulated.yaml"
SHARP = {"main_lens.z": 0.0, "array.z": 60.0, "sensor.z": 61.15, "target.z": -506.701556}
DRAWS = 4000


def stated(scale: float) -> Bench:
    """The built-in bench with this workmanship and stages that are where they say."""
    bench = read_bench(BENCH)
    description = bench.description.model_copy(
        update={"workmanship": WorkmanshipDescription(scale=scale)}
    )
    return replace(bench, description=description)


def test_without_workmanship_every_draw_is_as_before() -> None:
    bench = read_bench(BENCH)
    plain, equal = (
        drawn_errors(one, 30, np.random.default_rng(1)) for one in (bench, stated(scale=0.0))
    )
    assert plain.lenses == equal.lenses == EQUAL_LENSES
    assert np.array_equal(plain.attitude, equal.attitude)
    assert np.array_equal(plain.optics.pitch, np.ones(30))


def test_the_scale_of_the_whole_moves_the_pitch_of_every_draw() -> None:
    drawn = drawn_errors(stated(scale=1e-4), DRAWS, np.random.default_rng(2))
    assert np.std(drawn.optics.pitch) == pytest.approx(1e-4, rel=0.05)
    assert np.array_equal(drawn.of_the_stages_alone().optics.pitch, np.ones(DRAWS))


def test_lenses_of_many_focal_lengths_show_less_contrast_in_focus() -> None:
    bench = read_bench(BENCH)
    errors = drawn_errors(bench, 1, np.random.default_rng(3)).of_the_stages_alone()
    where = placements(bench, SHARP, errors)  # pyright: ignore[reportArgumentType]
    where = replace(where, gap=np.array([1.15]), array=np.array([60.0]))
    frequencies = np.array([2.0, 5.0, 8.0])

    def read(factor: float) -> np.ndarray:
        longer = replace(where, optics=replace(where.optics, focal=np.array([factor])))
        return contrast_draws(bench.optics, longer, frequencies)

    found = LensErrors(focal_length=0.01).mean_of(read, 10**9, 1)[0]
    far = np.linspace(-6, 6, 1201)
    density = np.exp(-(far**2) / 2) / np.sum(np.exp(-(far**2) / 2))
    shown = np.array([read(1 + 0.01 * t)[0] for t in far])
    mean = density @ shown
    scatter = np.sqrt(density @ (shown - mean) ** 2)
    assert np.all(found < read(1.0)[0])
    assert found == pytest.approx(mean, abs=2e-3)
    arrays = LensErrors(focal_length=0.01, seed=5).mean_of(
        lambda factor: np.repeat(read(factor), DRAWS, axis=0), 16, DRAWS
    )
    assert np.std(arrays, axis=0) == pytest.approx(scatter / 4, rel=0.1)


def test_every_frequency_may_be_seen_through_a_lens_of_its_own() -> None:
    bench = read_bench(BENCH)
    errors = drawn_errors(bench, 2, np.random.default_rng(3)).of_the_stages_alone()
    where = placements(bench, SHARP, errors)  # pyright: ignore[reportArgumentType]
    frequencies, factors = (
        np.array([2.0, 5.0, 8.0]),
        np.array([[1.01, 0.98, 1.0], [1.0, 1.02, 0.99]]),
    )
    found = contrast_draws(bench.optics, where, frequencies, longer=factors)
    for (draw, k), factor in np.ndenumerate(factors):
        longer = replace(where, optics=replace(where.optics, focal=np.full(2, factor)))
        alone = contrast_draws(bench.optics, longer, frequencies[k : k + 1])
        assert found[draw, k] == pytest.approx(alone[draw, 0], rel=1e-12)


def test_a_lens_has_one_number_in_every_picture() -> None:
    one, other = np.array([[0, 0], [-3, 2], [5, -1]]), np.array([[5, -1], [0, 0]])
    assert numbers_of(one)[[2, 0]].tolist() == numbers_of(other).tolist()
    assert len(set(numbers_of(one).tolist())) == 3


def test_a_lattice_is_off_as_a_fit_to_drawn_places_is() -> None:
    centres = microlens_centres(read_bench(BENCH).optics.array)
    rng = np.random.default_rng(6)
    design = np.stack([np.ones(len(centres)), *centres.T], axis=1)
    solve = np.linalg.pinv(design)
    fits = np.array([solve @ (centres + rng.normal(0, 3e-4, centres.shape)) for _ in range(2000)])
    found = LensErrors(position=3e-4, seed=7).of_the_lattice(centres, DRAWS, 0.3)
    assert np.std(found[:, 0]) == pytest.approx(np.std(fits[:, 1, 0]), rel=0.06)
    assert np.std(found[:, 1]) == pytest.approx(np.std(fits[:, 2, 1]), rel=0.06)
    roll = (fits[:, 1, 1] - fits[:, 2, 0]) / 2
    assert np.std(found[:, 2]) == pytest.approx(np.std(roll), rel=0.06)


def test_decentred_apertures_stretch_the_parallax_as_a_fitted_slope_says() -> None:
    centres = microlens_centres(read_bench(BENCH).optics.array)
    lenses = np.array([310, 311, 312, 336, 337, 338])
    errors = LensErrors(aperture_decentre=2e-4, seed=8)
    found = errors.of_the_parallax(centres[lenses], lenses, 50)
    for draw, aside in enumerate(errors.drawn(lenses, 50)[..., 2:4]):
        x, y = centres[lenses], centres[lenses] + aside
        x, y = (x - x.mean(axis=0)).ravel(), (y - y.mean(axis=0)).ravel()
        assert found[draw] == pytest.approx(np.linalg.lstsq(x[:, None], y)[0][0] - 1, abs=1e-12)
    assert not LensErrors(position=1.0).of_the_parallax(centres[lenses], lenses, 50).any()


def test_a_lens_has_the_same_errors_in_every_configuration_and_another_seed_others() -> None:
    errors = LensErrors(3e-4, 1e-4, 0.01, seed=9)
    some, others = np.array([3, 5, 700]), np.array([700, 8])
    assert np.array_equal(errors.drawn(some, 20)[:, 2], errors.drawn(others, 20)[:, 0])
    moved = replace(errors, seed=10).drawn(some, 20)
    assert not np.isclose(moved, errors.drawn(some, 20)).any()
    spread = errors.drawn(np.arange(400), 100).std(axis=(0, 1))
    assert spread == pytest.approx([3e-4, 3e-4, 1e-4, 1e-4, 0.01], rel=0.02)


def test_view_counts_change_where_a_view_is_at_its_limit_and_nowhere_else() -> None:
    bench = read_bench(BENCH)
    drawn = drawn_errors(bench, 200, np.random.default_rng(11))
    errors = drawn.of_the_stages_alone()
    still = {name: (0 * zero, 0 * scale) for name, (zero, scale) in errors.stages.items()}
    errors = replace(errors, stages=still)
    where = placements(bench, SHARP, errors)  # pyright: ignore[reportArgumentType]
    rough = LensErrors(position=2e-3, seed=12)

    def counts(points: np.ndarray, lenses: LensErrors) -> np.ndarray:
        return view_draws(bench.optics, where, errors.attitude, points, lenses)

    line = np.stack([np.linspace(-4, 4, 81), np.full(81, 0.37)], axis=1)
    number = np.array([len(s) for s in predicted_view_indices(bench.optics, 506.701556, line)])
    step = int(np.flatnonzero(np.diff(number))[0])
    edge = line[step : step + 2].mean(axis=0)
    for _ in range(12):  # where the count changes, found by halving
        low, middle = (
            len(predicted_view_indices(bench.optics, 506.701556, np.array([point]))[0])
            for point in (line[step], edge)
        )
        if low == middle:
            line[step] = edge
        else:
            line[step + 1] = edge
        edge = line[step : step + 2].mean(axis=0)
    assert np.ptp(counts(edge[None], EQUAL_LENSES)) == 0
    assert np.ptp(counts(edge[None], rough)) >= 1


def test_light_of_several_lines_shows_the_mean_of_what_each_shows() -> None:
    bench = read_bench(BENCH)
    errors = drawn_errors(bench, 4, np.random.default_rng(13))
    where = placements(bench, SHARP, errors)  # pyright: ignore[reportArgumentType]
    frequencies = np.array([2.0, 6.0])

    def show(*lines: tuple[float, float]) -> np.ndarray:
        lengths, weights = zip(*lines, strict=True)
        return contrast_draws(bench.optics, where, frequencies, Spectrum(lengths, weights))

    blue, red = show((450e-6, 1.0)), show((620e-6, 1.0))
    assert show((450e-6, 0.25), (620e-6, 0.75)) == pytest.approx(0.25 * blue + 0.75 * red)
    assert np.all(red < blue)

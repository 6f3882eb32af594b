"""What settings repeat to, of numbers that were drawn with a known scatter."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import Bench, read_bench
from flflab.bench_uncertainty import RepeatabilityDescription
from flflab.verdict.prediction import as_described, placements
from flflab.verdict.properties.values import Values
from flflab.verdict.repeats import averaged, mean_draws, reference_of, repeatability
from flflab.verdict.sources import approached, drawn_errors

BENCH = Path(__file__).parents[2] / "examples" / "benches" / "simulated.yaml"
SETTINGS, TIMES = 6, 5
SLOPES = {"bright_field_mm": -0.18, "total_field_mm": 0.81, "image_pitch_mm": 0.0068}  # of the gap
NOISE = {"bright_field_mm": 1.7e-5, "total_field_mm": 1.6e-5, "image_pitch_mm": 1.1e-5}


def stated(stages_um: float) -> Bench:
    bench = read_bench(BENCH)
    repeats = RepeatabilityDescription.model_validate({"stages": f"{stages_um} um"})
    description = bench.description.model_copy(update={"repeatability": repeats})
    return replace(bench, description=description)


def number(index: int, quantity: str, value: float, noise: float, draws: np.ndarray) -> Values:
    return Values(
        index, quantity, "white", np.array([value]), np.array([[noise**2]]), np.array([0.0]),
        draws[:, None], (None,), (None,),
    )  # fmt: skip


def numbers(
    rng: np.random.Generator, repeat: float, noisy: float, lamp: float
) -> tuple[Values, ...]:
    """Every setting once: fields that follow a gap off by ``repeat`` (mm), and the light."""
    found: list[Values] = []
    for index in range(SETTINGS):
        gap = rng.normal() * repeat * math.sqrt(2)  # of array and sensor
        found += [
            number(
                index, quantity, slope * gap + rng.normal() * NOISE[quantity] * noisy,
                NOISE[quantity], np.zeros(2),
            )
            for quantity, slope in SLOPES.items()
        ]  # fmt: skip
        found.append(number(index, "light", 1 + rng.normal() * lamp, 1e-5, np.zeros(2)))
    return tuple(found)


def moved(rng: np.random.Generator, repeat: float) -> tuple[Values, ...]:
    """What the model says of stages that repeat so."""
    found: list[Values] = []
    for index in range(SETTINGS):
        gap = rng.normal(size=4000) * repeat * math.sqrt(2)
        found += [
            number(index, name, 0.0, NOISE[name], slope * gap) for name, slope in SLOPES.items()
        ]
    return tuple(found)


@pytest.mark.parametrize("says", [1.0, 0.0], ids=["stated", "nothing stated"])
def test_stages_that_repeat_five_times_worse_than_stated_are_found_and_counted(says: float) -> None:
    bench, rng = stated(says), np.random.default_rng(3)
    times = [numbers(rng, 5e-3, 1.0, 0.004) for _ in range(TIMES)]
    found = repeatability(times, moved(rng, reference_of(bench).stages), bench)
    freedom = SETTINGS * (TIMES - 1)
    assert found.stages_dof == freedom
    assert found.stages == pytest.approx(5e-3, rel=3 / math.sqrt(2 * freedom))
    assert found.stages_used == pytest.approx(found.stages * math.sqrt(freedom / (freedom - 2)))
    assert found.of_bench(bench).description.repeatability.stages == found.stages_used
    assert found.pictures_used == 1
    assert found.light == pytest.approx(0.004, rel=0.5)
    assert found.light_used == found.light_stated == 0.005
    first = found.sentences[0]
    assert f"{says:.2g} um is stated" in first
    assert first.endswith(f"{1e3 * found.stages_used:.2g} um is used.")


def test_of_stages_light_and_pictures_as_stated_what_is_stated_is_used() -> None:
    bench, larger = stated(1.0), 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        times = [numbers(rng, 1e-3, 1.0, 0.005) for _ in range(TIMES)]
        found = repeatability(times, moved(rng, 1e-3), bench)
        larger += found.stages_used > found.stages_stated
        larger += found.light_used > found.light_stated
        larger += found.pictures_used > 1
    assert larger <= 5  # of 120, each in one of a hundred


def test_a_lamp_and_pictures_that_scatter_more_are_told_from_the_stages() -> None:
    bench, rng = stated(1.0), np.random.default_rng(5)
    times = [numbers(rng, 1e-3, 2.0, 0.03) for _ in range(TIMES)]
    found = repeatability(times, moved(rng, 1e-3), bench)
    assert found.stages_used == found.stages_stated
    assert found.pictures_used == pytest.approx(2.0, rel=0.25)
    assert found.light_used == pytest.approx(0.03, rel=0.5)
    assert "scatter" in found.sentences[-1]


def test_a_mean_of_several_times_keeps_the_pictures_scatter_and_the_floor() -> None:
    rng = np.random.default_rng(6)
    times = [numbers(rng, 0.0, 1.0, 0.0) for _ in range(TIMES)]
    floor = 3e-5
    whole = tuple(replace(one, noise=one.noise + floor**2) for one in times[0])
    for one, *each in zip(averaged(whole, times, 2.0), *times, strict=True):
        assert one.measured == pytest.approx(np.mean([other.measured for other in each]))
        noise = 4 * each[0].noise[0, 0]
        assert one.noise[0, 0] == pytest.approx(noise + floor**2)


def test_each_configuration_stops_elsewhere() -> None:
    bench, draws = stated(2.0), 4000
    worlds = {"main_lens.z": 0.0, "array.z": 60.0, "sensor.z": 61.15, "target.z": -507.0}
    repeats = bench.description.repeatability
    described = as_described(draws)
    gaps = [
        placements(bench, worlds, approached(described, repeats, bench, index)).gap  # pyright: ignore[reportArgumentType]
        for index in range(2)
    ]
    assert np.std(gaps[0]) == pytest.approx(2e-3 * math.sqrt(2), rel=0.05)
    assert abs(np.corrcoef(gaps[0], gaps[1])[0, 1]) < 0.06
    # nor does it stop where errors of the stages, drawn from the same number, put it
    for seed in range(3):
        shared = drawn_errors(bench, draws, np.random.Generator(np.random.Philox(key=seed)))
        both = approached(shared, repeats, bench, seed)
        for element, (zero, _) in shared.stages.items():
            own = both.stages[element][0] - zero
            assert np.std(own) == pytest.approx(2e-3, rel=0.05)
            for other, scale in shared.stages.values():
                assert abs(np.corrcoef(own, other)[0, 1]) < 0.06
                assert abs(np.corrcoef(own, scale)[0, 1]) < 0.06


def test_the_mean_of_contrasts_that_all_fall_is_lower_than_the_contrast_in_the_mean_place() -> None:
    rng = np.random.default_rng(8)
    times = [
        (number(0, "mtf", 1.0, 1e-3, 1 - rng.normal(size=4000) ** 2),) for _ in range(TIMES)
    ]  # fmt: skip
    (found,) = mean_draws(times)
    assert found.expected == pytest.approx(0.0, abs=0.05)
    assert found.draws.std() == pytest.approx(math.sqrt(2 / TIMES), rel=0.1)

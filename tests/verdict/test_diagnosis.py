"""Which change of a bench is named, told from numbers that are the errors themselves: a pitch as a
share, an angle in mrad.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from flflab.bench import Bench, Element, read_bench
from flflab.verdict.diagnosis import diagnose, likeliest
from flflab.verdict.geometry import geometry
from flflab.verdict.prediction import (
    Errors,
    as_described,
    placements,
)
from flflab.verdict.properties.values import Values, single
from flflab.verdict.sources import drawn_errors
from flflab.verdict.visible import visible

BENCH = Path(__file__).parents[2] / "examples" / "benches" / "full.yaml"


@pytest.fixture(scope="module")
def bench() -> Bench:
    return read_bench(BENCH)


def benches(bench: Bench) -> Errors:
    """Draws of what the bench file states."""
    return drawn_errors(bench, 1000, np.random.default_rng(5))


def planted(change: str, size: float) -> Errors:
    """A hundred benches as described but for one thing."""
    exact = as_described(100)
    if change == "target.z":
        moved = np.full(100, size), np.zeros(100)
        return replace(exact, stages=exact.stages | {"target.z": moved})
    if change == "dots":
        return replace(exact, dots=np.full(100, 1 + size))
    larger = {change: np.full(100, 1 + size)}
    return replace(exact, optics=replace(exact.optics, **larger))


def numbers(
    share: float, angle: float, pitches: npt.NDArray[np.float64], angles: npt.NDArray[np.float64]
) -> list[Values]:
    """Measured pitches of microlenses (over those described) and of the array (mrad), with the
    model's draws of them.
    """
    return [
        single(0, "image_pitch_mm", "white", share, 1e-5, pitches),
        single(0, "array_pitch_mrad", "white", angle, 0.01, 1e3 * angles),
    ]


@pytest.mark.parametrize(
    ("share", "angle", "named", "size"),
    [
        (1.01, 0.0, "pitch of the microlenses", 0.01),
        (1.0, 4.0, "pitch of the array (its tilt along y)", 0.004),
    ],
)
def test_a_pitch_of_the_microlenses_and_a_pitch_of_the_array_are_two_things(
    bench: Bench, share: float, angle: float, named: str, size: float
) -> None:
    drawn = np.random.default_rng(1).normal(size=(2, 1000))

    def told(errors: Errors) -> list[Values]:
        return numbers(share, angle, errors.optics.pitch, errors.attitude[:, 2])

    found = numbers(share, angle, 1 + 1e-4 * drawn[0], 1e-4 * drawn[1])
    suspects = likeliest(diagnose(found, geometry(bench, benches(bench), told)))
    assert [suspect.what for suspect in suspects] == [named]
    assert suspects[0].size == pytest.approx(size, rel=0.05)
    assert suspects[0].chi2 < 2


def sharp_and_large(errors: Errors, bench: Bench) -> list[Values]:
    """Where the image of the target lies behind the main lens, mm, and how large it is, by the
    formulas of a thin lens.
    """
    focal = bench.optics.main_lens.focal_length * errors.optics.lens_focal
    worlds: dict[Element, float] = {
        "main_lens.z": 0.0,
        "array.z": 50.0,
        "sensor.z": 51.0,
        "target.z": -507.0,
    }
    away = placements(bench, worlds, errors).distance
    behind = 1 / (1 / focal - 1 / away)
    return [
        single(0, "image_pitch_mm", "white", 0.0, 1e-4, behind),
        single(0, "dot_scale", "four-dot", 0.0, 1e-6, behind / away * errors.dots),
    ]


@pytest.mark.parametrize(
    ("change", "size", "named"),
    [
        ("lens_focal", 0.01, {"focal length of the main lens (its f-number as set)",
                              "focal length of the main lens (its stop as it is)"}),
        ("target.z", 8.0, {"zero of target_stage"}),
        ("dots", 0.02, {"spacing of the dots"}),
    ],
)  # fmt: skip
def test_the_size_of_dots_tells_a_longer_lens_from_a_nearer_target(
    bench: Bench, change: str, size: float, named: set[str]
) -> None:
    errors = benches(bench)
    drawn = sharp_and_large(errors, bench)
    truth = sharp_and_large(planted(change, size), bench)
    found = [
        replace(one, measured=true.draws[0].astype(float))
        for one, true in zip(drawn, truth, strict=True)
    ]
    effects = geometry(bench, errors, lambda drawn: sharp_and_large(drawn, bench))
    assert {one.what for one in likeliest(diagnose(found, effects))} == named


def test_a_run_says_how_large_a_change_must_be_to_be_seen(bench: Bench) -> None:
    """Five standard deviations of a number that is the error itself; what moves none is hidden."""
    drawn = np.random.default_rng(1).normal(size=(2, 1000))
    found = numbers(1.0, 0.0, 1 + 1e-4 * drawn[0], 1e-4 * drawn[1])

    def told(errors: Errors) -> list[Values]:
        return numbers(1.0, 0.0, errors.optics.pitch, errors.attitude[:, 2])

    seen = {one.what: one for one in visible(found, bench, told)}
    assert seen["pitch of the microlenses"].smallest == pytest.approx(5e-2, rel=0.1)
    assert seen["pitch of the microlenses"].unit == "%"
    by_hand = np.degrees(5e-3 * np.hypot(0.1, 0.01))
    assert seen["pitch of the array (its tilt along y)"].smallest == pytest.approx(by_hand, rel=0.1)
    assert seen["pixel size"].words == "not at all"

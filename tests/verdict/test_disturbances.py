"""Diffraction, blur and an unsteady lamp as suspects, and what a suspect says of itself."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flflab.digits import plus_minus, two_digits
from flflab.verdict.diagnosis import Effect, Suspect, changed, diagnose, heading, likeliest
from flflab.verdict.next_step import next_step
from flflab.verdict.properties.values import single

SUSPECT = Suspect(
    "pitch", 0.01, "(1.00 ± 0.10) % larger", 20.0, 2000.0, 24, 1e-3, 0.7, True, "calibrate"
)


def found_with(measured: list[float], sizes: np.ndarray) -> tuple[Suspect, ...]:  # type: ignore[type-arg]
    """Numbers known to 0.01 that only an effect changes: the k-th by k + 1 times its size."""
    rng = np.random.default_rng(4)
    draws = 1e-6 * rng.normal(size=(1000, len(measured)))
    values = [single(0, "light", "white", one, 0.01, draws[:, k]) for k, one in enumerate(measured)]
    rise = np.arange(1, len(measured) + 1)
    words = changed("of ({}) %", 100.0)
    return diagnose(values, (Effect("a rise", sizes, lambda x: x[:, None] * rise, words, "lamp"),))


def test_a_change_that_explains_everything_has_its_size_and_uncertainty() -> None:
    noise = 0.01 * np.random.default_rng(1).normal(size=6)
    rise = np.arange(1, 7)
    best = found_with(list(0.2 * rise + noise), np.linspace(-1, 1, 41))[0]
    assert best.what == "a rise"
    by_hand = 0.01 / np.sqrt(np.sum(rise**2))  # of a straight line through the origin
    assert best.uncertainty == pytest.approx(by_hand, rel=0.3)  # enlarged at most by the misfit
    assert abs(best.size - 0.2) < 4 * by_hand
    assert best.explains
    assert re.search(r"of \(\d+\.\d+ ± 0\.\d\d\) %: removes", best.sentence)
    assert "is within the uncertainties" in best.sentence


def test_a_change_that_leaves_what_would_be_rejected_does_not_explain() -> None:
    rise = np.arange(1, 7)
    bent = 0.2 * rise + np.array([0.1, 0, 0, 0, 0, -0.1])
    suspects = found_with(list(bent), np.linspace(-1, 1, 41))
    assert not suspects[0].explains
    assert suspects[0].p_left < 1e-6
    assert "but does not explain it: what is left (chi²" in suspects[0].sentence
    assert suspects[0].sentence.startswith("a rise of about 19 %: removes")
    assert heading(likeliest(suspects)) == "Closest single change, which does not explain it:"


@pytest.mark.parametrize(
    ("words", "size", "u", "said"),
    [
        ("({}) % larger than described", -1.85, 0.021, "(1.850 ± 0.021) % smaller than described"),
        ("({}) more than 1", -0.2, 0.01, "(0.200 ± 0.010) less than 1"),
        ("({}) mm farther along z", -0.0269782, float("nan"), "about 0.027 mm less far along z"),
    ],
)
def test_a_change_says_its_sign_in_words(words: str, size: float, u: float, said: str) -> None:
    assert changed(words)(size, u) == said


def test_causes_that_fit_equally_well_stand_together() -> None:
    other = replace(SUSPECT, what="aperture", chi2=23.0)
    assert heading((SUSPECT, other)).startswith("Equally likely causes")
    assert heading((SUSPECT,)) == "Most likely cause:"
    assert likeliest((SUSPECT, other, replace(SUSPECT, chi2=90.0))) == (SUSPECT, other)
    assert likeliest((SUSPECT, replace(other, explains=False))) == (SUSPECT,)
    assert heading(()).startswith("No single change explains it")


@pytest.mark.parametrize(
    ("remedy", "command"),
    [
        ("calibrate", "flflab calibrate --bench run/bench.yaml"),
        ("align", "flflab align --bench run/bench.yaml"),
        ("light", "flflab report run --bench my-bench.yaml"),
        ("lenses", "flflab accuracy model --camera run/camera.yaml"),
        ("lamp", "flflab validate run/study.yaml --bench run/bench.yaml"),
    ],
)
def test_a_rejection_ends_in_a_command_to_copy(remedy: str, command: str) -> None:
    step = next_step(False, (replace(SUSPECT, remedy=remedy),), Path("run"), simulated=False)
    assert step.command == command


def test_an_accepted_run_and_an_unexplained_one_have_a_next_step_too() -> None:
    assert "export" in next_step(True, (), Path("run"), simulated=False).command
    assert "new bench" in next_step(True, (), Path("run"), simulated=True).command
    assert "bench check" in next_step(False, (), Path("run"), simulated=True).command


@pytest.mark.parametrize(
    ("value", "u", "said"),
    [
        (1.8512, 0.0203, "1.851 ± 0.020"),
        (12345.6, 340.0, "12350 ± 340"),
        (0.5, 0.0, "0.5"),
        (50.0003, 0.00996, "50.000 ± 0.010"),
        (2.0, float("nan"), "2"),
    ],
)
def test_an_uncertainty_has_two_digits_and_its_value_the_same_place(
    value: float, u: float, said: str
) -> None:
    assert plus_minus(value, u) == said


def test_an_uncertainty_alone_has_two_digits() -> None:
    assert [two_digits(u) for u in (0.0203, 344.0, 1.23e-8, 2.0)] == [
        "0.020",
        "340",
        "1.2e-08",
        "2.0",
    ]

"""First suspects of a rejected run: diffraction, blur, the lamp, exchanged targets."""

from dataclasses import replace

import numpy as np
import pytest

from flflab.bench import Bench
from flflab.optics.airy import diffraction_contrast
from flflab.record import Run
from flflab.report.facts import notes
from flflab.study import Study
from flflab.verdict.diagnosis import Effect
from flflab.verdict.disturbances import disturbances, through_gamma
from flflab.verdict.evaluation import Evaluation
from flflab.verdict.properties.values import Values, joined


@pytest.fixture
def values(evaluation: Evaluation) -> list[Values]:
    return [one for one in evaluation.values if one.quantity in ("mtf", "light")]


def suspected(evaluation: Evaluation, values: list[Values], bench: Bench) -> dict[str, Effect]:
    found = disturbances(values, evaluation.measured, evaluation.predicted, bench)
    return {one.what.partition(" (")[0]: one for one in found}


def test_diffraction_is_a_suspect_only_where_no_light_is_stated(
    evaluation: Evaluation, values: list[Values], bench: Bench
) -> None:
    found = suspected(evaluation, values, bench)
    assert {"a blur beyond the model", "gamma", "unequal light", "settings exchanged"} <= set(found)
    lit = bench.description.model_copy(update={"light": object()})
    fewer = suspected(evaluation, values, replace(bench, description=lit))
    assert set(found) - set(fewer) == {"diffraction"}


def test_diffraction_dims_the_contrast_as_a_perfect_lens_does(
    evaluation: Evaluation, values: list[Values], bench: Bench
) -> None:
    measured, predicted = evaluation.measured, evaluation.predicted
    diffraction = suspected(evaluation, values, bench)["diffraction"]
    plain = joined(values)[2].mean(axis=0)
    dimmed = diffraction.expected(np.array([500e-6]))[0]
    place = 0
    for one in values:
        count = len(one.measured)
        here = slice(place, place + count)
        place += count
        if one.quantity == "light":
            np.testing.assert_array_equal(dimmed[here], plain[here])
            continue
        seen, model = measured[one.configuration], predicted[one.configuration]
        assert seen.curve is not None
        left = diffraction_contrast(model.camera, model.distance, seen.curve.cycles_per_px, 500e-6)
        np.testing.assert_allclose(dimmed[here], plain[here] * left, rtol=1e-12)


def test_an_unsteady_lamp_changes_light_alone_and_a_blur_of_0_nothing(
    evaluation: Evaluation, values: list[Values], bench: Bench
) -> None:
    every = suspected(evaluation, values, bench)
    blur, lamp = every["a blur beyond the model"], every["unequal light"]
    plain = joined(values)[2].mean(axis=0)
    np.testing.assert_allclose(blur.expected(np.zeros(1))[0], plain, rtol=1e-12)
    drifted = lamp.expected(np.array([0.1]))[0] / plain
    is_light = np.concatenate(
        [np.full(len(one.measured), one.quantity == "light") for one in values]
    )
    assert np.all(drifted[~is_light] == 1)
    np.testing.assert_allclose(drifted[is_light], [0.95, 1.0, 1.05], rtol=1e-12)


def test_exchanged_settings_show_each_other_s_numbers(
    evaluation: Evaluation, values: list[Values], bench: Bench
) -> None:
    light = [one for one in values if one.quantity == "light"]
    exchanged = suspected(evaluation, light, bench)["settings exchanged"]
    plain = joined(light)[2].mean(axis=0)
    np.testing.assert_array_equal(exchanged.expected(np.array([1.0]))[0], plain[[1, 0, 2]])
    assert exchanged.in_words(1.0, 0.0) == "(configurations 0 and 1)"


def test_a_gamma_of_two_doubles_nothing_sharp_and_squares_half_light() -> None:
    """The square of 1/2 + a cos has the first harmonic a; of sharp bars a power changes nothing."""
    np.testing.assert_allclose(through_gamma(np.array([0.3]), 2.0), 1.0, rtol=1e-12)
    # 1/2 + a cos to the power 3: 3/4 a + 3/4 a^3 of a
    a = 2 / np.pi * 0.3
    np.testing.assert_allclose(through_gamma(np.array([0.3]), 3.0), 0.75 + 0.75 * a**2, rtol=1e-12)


def test_targets_that_show_nowhere_are_suspected_to_be_exchanged(
    evaluation: Evaluation, run: Run, study: Study, bench: Bench
) -> None:
    blind = tuple(replace(one, curve=None) for one in evaluation.measured)
    said = " ".join(notes(replace(evaluation, measured=blind), run, study, bench))
    assert "No bars could be measured in any configuration: are the targets exchanged" in said
    assert "exchanged" not in " ".join(notes(evaluation, run, study, bench))

"""Numbers of a property: differences and ratios between configurations, what they share, and the
diagnosis.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flflab.bench import read_bench
from flflab.errors import InputError
from flflab.verdict.diagnosis import Effect, diagnose, likeliest
from flflab.verdict.geometry import geometry
from flflab.verdict.prediction import Errors, as_described
from flflab.verdict.properties.values import Values, differences, joined, ratios, single

BENCH = Path(__file__).parents[2] / "examples" / "benches" / "simulated.yaml"


def curve(
    measured: list[float], frequencies: list[float], shared: float, noise: float = 0.01
) -> Values:
    """A curve whose draws share one error."""
    middle = np.array(measured)
    draws = middle + shared * np.random.default_rng(0).normal(size=(4000, 1))
    return Values(
        1,
        "mtf",
        "bars",
        middle,
        noise**2 * np.eye(len(middle)),
        middle,
        draws,
        (None,) * len(middle),
        tuple(frequencies),
    )


def test_an_error_common_to_two_configurations_leaves_their_difference() -> None:
    between = differences(curve([0.5, 0.4], [1.0, 2.0], 0.1), curve([0.6, 0.3], [1.0, 2.0], 0.1))
    assert between.quantity == "difference_mtf"
    assert between.measured.tolist() == pytest.approx([-0.1, 0.1])
    assert between.uncertainty.tolist() == pytest.approx([0.01 * 2**0.5] * 2)


def test_only_what_both_configurations_have_is_set_against_each_other() -> None:
    between = differences(
        curve([0.5, 0.4, 0.3], [1.0, 2.0, 3.0], 0.0), curve([0.6, 0.1], [2.0, 4.0], 0.0)
    )
    assert between.cycles_per_mm == (2.0,)
    assert between.measured.tolist() == pytest.approx([-0.2])


def test_a_ratio_over_what_may_be_nothing_is_not_formed() -> None:
    between = ratios(curve([0.5, 0.4], [1.0, 2.0], 0.0), curve([0.25, 0.02], [1.0, 2.0], 0.0))
    assert between.cycles_per_mm == (1.0,)
    assert between.measured.tolist() == pytest.approx([2.0])
    assert between.uncertainty[0] == pytest.approx(np.hypot(0.01, 2 * 0.01) / 0.25)


def test_a_count_s_spread_is_about_the_nominal_count() -> None:
    draws = np.array([[3], [3], [4], [3]], dtype=np.int64)
    counted = Values(
        0,
        "views",
        "four-dot",
        np.array([3.0]),
        np.zeros((1, 1)),
        np.array([3.0]),
        draws,
        (0,),
        (None,),
    )
    assert counted.spread[0] == pytest.approx(((1 + 1) / 5) ** 0.5)


def test_nothing_is_no_property() -> None:
    with pytest.raises(InputError, match="no values"):
        joined([])


def changes_of(numbers: Callable[[Errors], list[Values]]) -> tuple[Effect, ...]:
    """Changes of the geometry of benches that are as described."""
    return geometry(read_bench(BENCH), as_described(500), numbers)


def numbers_of(errors: Errors) -> list[Values]:
    """Two numbers a configuration that a longer microlens, a wider one and a shifted sensor change
    in different ways.
    """
    shift = errors.stages["sensor.z"][0]
    first = 1 + 3 * (errors.optics.focal - 1) + (errors.optics.aperture - 1) + 0.5 * shift
    second = 2 - 2 * (errors.optics.focal - 1) + (errors.optics.aperture - 1) + 0.4 * shift
    return [
        single(0, "bright_field_mm", "white", 0.0, 1e-4, first),
        single(0, "total_field_mm", "white", 0.0, 1e-4, second),
    ]


@pytest.mark.parametrize(
    ("focal", "aperture", "named"),
    [
        (1.02, 1.0, r"focal length of the microlenses \(2\.000. ± 0\.00..\) % larger"),
        (1.0, 0.97, r"aperture of the microlenses \((3\.000.|2\.999.) ± 0\.00..\) % smaller"),
    ],
)
def test_the_one_change_that_explains_everything_is_named(
    focal: float, aperture: float, named: str
) -> None:
    expected = (1.0, 2.0)
    measured = (1 + 3 * (focal - 1) + (aperture - 1), 2 - 2 * (focal - 1) + (aperture - 1))
    rng = np.random.default_rng(2)
    found = [
        single(0, quantity, "white", value, 1e-4, due + 1e-5 * rng.normal(size=500))
        for quantity, value, due in zip(
            ("bright_field_mm", "total_field_mm"), measured, expected, strict=True
        )
    ]
    suspects = diagnose(found, changes_of(numbers_of))
    assert re.match(named, suspects[0].sentence)
    assert suspects[0].chi2 < 2 < 100 < suspects[1].chi2
    assert likeliest(suspects) == suspects[:1]


def test_what_no_single_change_explains_is_blamed_on_none() -> None:
    rng = np.random.default_rng(2)
    found = [
        single(0, quantity, "white", due + 0.1, 1e-4, due + 1e-5 * rng.normal(size=500))
        for quantity, due in (
            ("bright_field_mm", 1.0),
            ("total_field_mm", 2.0),
            ("image_pitch_mm", 3.0),
        )
    ]

    def numbers(errors: Errors) -> list[Values]:
        third = np.full(len(errors.optics.focal), 3.0)
        return [*numbers_of(errors), single(0, "image_pitch_mm", "white", 0.0, 1e-4, third)]

    suspects = diagnose(found, changes_of(numbers))
    assert suspects[0].chi2_before - suspects[0].chi2 > 1e5
    assert likeliest(suspects) == ()


def test_changes_that_explain_equally_well_are_all_named() -> None:
    rng = np.random.default_rng(2)
    found = [single(0, "bright_field_mm", "white", 1.03, 1e-3, 1 + 1e-5 * rng.normal(size=500))]
    alike = likeliest(diagnose(found, changes_of(lambda errors: numbers_of(errors)[:1])))
    assert {
        "focal length of the microlenses",
        "aperture of the microlenses",
        "zero of sensor_stage",
    } <= {one.what for one in alike}

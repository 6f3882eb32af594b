"""A number and one unit in, a plain number out; anything else is refused with what is allowed."""

import math

import pytest

from flflab.errors import InputError
from flflab.units import Dimension, parse_quantity, show_quantity


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("400 um", "length", 0.4), ("400um", "length", 0.4), ("1.66 µm", "length", 1.66e-3),
        ("6 cm", "length", 60.0), ("1 in", "length", 25.4),
        ("infinity", "length", math.inf), ("-10 mm", "length", -10.0),
        ("1e-3 m", "length", 1.0), (0, "length", 0.0),
        ("180 deg", "angle", math.pi), ("20 ms", "time", 0.02), ("10 cycles/mm", "frequency", 10.0),
        ("10 mm/s", "speed", 10.0),
        ("5 %", "ratio", 0.05), (0.05, "ratio", 0.05), ("0.05", "ratio", 0.05),
        ("10 ppm", "ratio", 1e-5),
    ],
)  # fmt: skip
def test_a_quantity_is_read_in_the_unit_used_inside(
    text: object, dimension: object, value: float
) -> None:
    assert parse_quantity(text, dimension) == pytest.approx(value)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("text", "dimension", "says"),
    [
        (400, "length", "has no unit"), ("400", "length", "has no unit"),
        ("4 px", "length", "not a unit known here"),
        ("1 deg", "length", "unit of angle"),
        ("50 Mm", "length", "not a unit known here"),
        ("1 cycle/mm", "frequency", "not a unit known here"),
        ("five mm", "length", "not a quantity"), ("nan mm", "length", "not a quantity"),
        (None, "length", "not a quantity"),
        (True, "length", "not a quantity"), ("1e400 mm", "length", "too large"),
        ([1], "time", "not a quantity"), ("", "length", "not a quantity"),
    ],
)  # fmt: skip
def test_what_is_no_quantity_is_refused_and_says_what_is_allowed(
    text: object, dimension: object, says: str
) -> None:
    with pytest.raises(InputError, match=says) as refusal:
        parse_quantity(text, dimension)  # pyright: ignore[reportArgumentType]
    assert f"a {dimension} is a number and a unit of" in str(refusal.value)


def test_infinity_is_shown_in_words() -> None:
    assert show_quantity(math.inf, "mm") == "infinity"
    assert show_quantity(506.7016, "mm") == "506.702 mm"


@pytest.mark.parametrize("letter", ["\u00b5", "\u03bc", "u"], ids=["micro sign", "Greek mu", "u"])
@pytest.mark.parametrize(
    ("unit", "dimension"), [("m", "length"), ("s", "time"), ("m/s", "speed"), ("rad", "angle")]
)
def test_both_letters_mu_stand_for_a_millionth_in_every_unit(
    letter: str, unit: str, dimension: Dimension
) -> None:
    inside = {"length": 1e-3, "time": 1e-6, "speed": 1e-3, "angle": 1e-6}[dimension]
    for space in ("", " "):
        assert parse_quantity(f"5{space}{letter}{unit}", dimension) == pytest.approx(5 * inside)

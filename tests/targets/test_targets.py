import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flflab.errors import InputError
from flflab.targets import Bars, Black, Chirp, Edge, FourDot, Picture, Target, White


def test_four_dots_are_white_discs_at_half_the_spacing() -> None:
    dots = FourDot()
    assert dots.centres.tolist() == [[-4, -4], [4, -4], [-4, 4], [4, 4]]
    assert dots.radiance([4.0, 4.5, 4.51, 0.0], [4.0, 4.0, 4.0, 0.0]).tolist() == [1, 1, 0, 0]
    places = (np.arange(2000) + 0.5) / 100 - 10
    assert dots.radiance(places[:, None], places).mean() * 400 == pytest.approx(math.pi, rel=1e-3)


def test_bars_begin_bright_at_the_left_edge_and_end_at_the_right() -> None:
    bars = Bars((1.0, 1.0), width=4.0, height=2.0)
    assert bars.radiance([-2.01, -1.9, -1.4, -0.9, 1.6, 1.9, 2.01], 0.0).tolist() == [
        0,
        1,
        0,
        1,
        0,
        0,
        0,
    ]
    assert bars.radiance(-1.9, [0.99, 1.01]).tolist() == [1, 0]


@given(st.floats(0.1, 20), st.floats(0.1, 20), st.floats(0, 1))
def test_phase_is_the_integral_of_the_frequency_and_position_its_inverse(
    left: float, right: float, share: float
) -> None:
    bars = Bars((left, right), width=5.0)
    x = 5.0 * (share - 0.5)
    steps = np.linspace(-2.5, x, 2001)
    assert float(bars.phase(x)) == pytest.approx(
        float(np.trapezoid(bars.frequency(steps), steps)), abs=1e-9
    )
    assert float(bars.position(bars.phase(x))) == pytest.approx(x, abs=1e-12)


def test_the_chirp_is_the_sine_of_the_same_law() -> None:
    x = np.linspace(-10, 10, 501)
    assert np.allclose(Chirp().radiance(x, 0.0), 0.5 + 0.5 * np.sin(2 * np.pi * Bars().phase(x)))


def test_the_edge_is_white_on_the_right_and_turns_with_its_angle() -> None:
    assert Edge(0.0).radiance([-0.1, 0.1], [5.0, -5.0]).tolist() == [0, 1]
    assert Edge(math.pi / 4).radiance([-1.0, -1.0], [0.99, 1.01]).tolist() == [0, 1]


def test_a_pictures_columns_rise_with_x_and_its_rows_with_y() -> None:
    picture = Picture(np.array([[0.1, 0.2], [0.3, 0.4]]), 2.0)
    assert picture.radiance([-0.5, 0.5, -0.5, 0.5, 1.5], [-0.5, -0.5, 0.5, 0.5, 0.0]).tolist() == [
        0.1,
        0.2,
        0.3,
        0.4,
        0.0,
    ]
    assert (picture.texel, picture.height) == (1.0, 2.0)


@pytest.mark.parametrize(
    "target", [FourDot(), Bars(), Chirp(), Edge(), White(), Black(), Picture(np.ones((2, 3)), 1.0)]
)
def test_radiance_lies_from_0_to_1_and_has_the_shape_of_the_places(target: Target) -> None:
    x, y = np.meshgrid(np.linspace(-12, 12, 50), np.linspace(-12, 12, 40))
    values = target.radiance(x, y)
    assert values.shape == x.shape
    assert values.min() >= 0
    assert values.max() <= 1


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: FourDot(diameter=0.0), "diameter"),
        (lambda: FourDot(diameter=2.0, spacing=1.0), "spacing"),
        (lambda: FourDot(spacing=math.inf), "spacing"),
        (lambda: Bars((0.0, 1.0)), "cycles_per_mm"),
        (lambda: Bars(width=-1.0), "width"),
        (lambda: Chirp(height=math.nan), "height"),
        (lambda: Bars((1.0, 1e9)), "cycles"),
        (lambda: Edge(math.nan), "angle"),
        (lambda: Picture(np.array([[2.0]]), 1.0), "values"),
        (lambda: Picture(np.ones(3), 1.0), "shape"),
        (lambda: Picture(np.ones((1, 1)), 0.0), "width"),
        (lambda: Picture(np.array([[np.nan]]), 1.0), "values"),
    ],
)
def test_impossible_targets_are_refused_by_kind_and_field(make: object, field: str) -> None:
    with pytest.raises(InputError, match=rf"target '\S+': .*{field}"):
        make()  # pyright: ignore[reportCallIssue, reportUnknownVariableType]

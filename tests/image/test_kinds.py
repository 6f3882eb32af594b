"""How much light changes with the size of the pattern it is spread by, which tells how unlike
microlenses may share a table.
"""

import math

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.diffraction.kinds import largest_change
from flflab.targets import FourDot, Picture

Array = npt.NDArray[np.float64]


def light_of_a_dot(radius: float, away: Array, blur: float) -> Array:
    """Share of a blur's disc that lies on a dot so far away, by the two segments that they have in
    common.
    """

    def segment(round_by: float, to_chord: Array) -> Array:
        inside = np.clip(to_chord / round_by, -1, 1)
        return round_by**2 * (np.arccos(inside) - inside * np.sqrt(1 - inside**2))

    to_chord = (away**2 + blur**2 - radius**2) / (2 * away)
    return (segment(blur, to_chord) + segment(radius, away - to_chord)) / (math.pi * blur**2)


@pytest.mark.parametrize("times", [2.0, 3.0, 5.0, 20.0])
def test_a_large_dot_changes_a_little_more_than_an_edge(times: float) -> None:
    away, step = np.linspace(times - 1.001, times + 1.001, 4001), 1e-4
    change = np.abs(
        light_of_a_dot(times, away, math.exp(step)) - light_of_a_dot(times, away, math.exp(-step))
    ) / (2 * step)
    said = largest_change(FourDot(2 * times, 10 * times), 1.0)
    assert 0.95 * said < change.max() < said


@pytest.mark.parametrize("times", [2.0, 2.5, 4.0, 6.0])
def test_large_texels_change_most_at_a_corner(times: float) -> None:
    """Whatever is black and white: all texels are white on which the circle has a larger share than
    the disc.
    """
    turns = (np.arange(3000) + 0.5) / 3000 * 2 * np.pi
    x, y = np.meshgrid(*2 * ((np.arange(200) + 0.5) / 100 - 1,))
    inside = np.hypot(x, y) < 1
    most = 0.0
    for right in np.linspace(0, times / 2, 9):
        for up in np.linspace(0, right, 5):

            def texel(x: Array, y: Array, right: float = right, up: float = up) -> Array:
                return np.floor((x + right) / times) * 100 + np.floor((y + up) / times)

            on_circle, in_disc = texel(np.cos(turns), np.sin(turns)), texel(x[inside], y[inside])
            shares = [
                float(np.mean(on_circle == one) - np.mean(in_disc == one))
                for one in np.unique(in_disc)
            ]
            most = max(most, 2 * sum(max(share, 0.0) for share in shares))
    said = largest_change(Picture(np.ones((4, 4)), 4 * times), 1.0)
    assert 0.85 * said < most < 1.02 * said


def test_small_dots_and_texels_may_change_by_all_they_have() -> None:
    assert (
        largest_change(FourDot(2.0, 20.0), 1.0)
        == largest_change(Picture(np.ones((4, 4)), 4.0), 1.0)
        == 2.0
    )


def test_two_dots_within_one_pattern_are_not_large() -> None:
    assert largest_change(FourDot(20.0, 21.0), 1.0) == 2.0

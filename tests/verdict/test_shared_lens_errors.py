"""Errors of single microlenses are the same in every configuration that they show dots in."""

import numpy as np
import pytest

from flflab.verdict.properties.values import Shared, Values, joined

ZEROS = np.zeros((100, 2))


def read(place: int, by: np.ndarray, which: np.ndarray) -> Values:
    return Values(
        place, "dot_distance_mm", "four-dot", np.zeros(2), by @ by.T + np.eye(2), np.zeros(2),
        ZEROS, (0, 1), (None, None), Shared("lenses of the dots", by, which),
    )  # fmt: skip


def test_only_lenses_seen_in_both_configurations_move_both() -> None:
    one = read(0, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.array([7, 3, 9]))
    other = read(1, np.array([[10.0, 20.0], [30.0, 40.0]]), np.array([9, 7]))
    noise = joined([one, other])[1]
    # lens 7 is the first of the one and the second of the other, 9 the third and the first
    expected = np.array([[1 * 20 + 3 * 10, 1 * 40 + 3 * 30], [4 * 20 + 6 * 10, 4 * 40 + 6 * 30]])
    assert noise[:2, 2:] == pytest.approx(expected)
    assert noise[2:, :2] == pytest.approx(expected.T)

"""The Pareto front against enumeration of every pair of points."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flflab.design.front import Front, empty_front, merged

Array = npt.NDArray[np.float64]


def undominated(values: Array) -> list[int]:
    """By comparing every point with every other one."""
    no_worse = (values[:, None, :] >= values[None, :, :]).all(axis=2)
    better = (values[:, None, :] > values[None, :, :]).any(axis=2)
    return np.flatnonzero(~(no_worse & better).any(axis=0)).tolist()


def streamed(values: Array, epsilon: float, parts: int, seed: int = 0) -> Front:
    front = empty_front(values.shape[1], epsilon)
    for part in np.array_split(np.random.default_rng(seed).permutation(len(values)), parts):
        front = merged(front, part.astype(np.int64), values[part])
    return front


@pytest.mark.parametrize("objectives", [1, 2, 4])
@pytest.mark.parametrize("levels", [3, 1000])
def test_with_epsilon_zero_it_is_exact_equal_points_included(objectives: int, levels: int) -> None:
    values = (
        np.random.default_rng(objectives)
        .integers(1, levels + 1, (2000, objectives))
        .astype(np.float64)
    )
    assert streamed(values, 0.0, 7).numbers.tolist() == undominated(values)


@given(st.integers(0, 10_000), st.integers(1, 9), st.sampled_from([0.0, 0.02, 0.3]))
@settings(max_examples=30, deadline=None)
def test_it_is_the_same_in_whatever_order_the_points_come(
    seed: int, parts: int, epsilon: float
) -> None:
    values = np.random.default_rng(seed).lognormal(size=(300, 3))
    one, other = streamed(values, epsilon, 1), streamed(values, epsilon, parts, seed)
    assert one.numbers.tolist() == other.numbers.tolist()


@pytest.mark.ci
@pytest.mark.parametrize("epsilon", [0.01, 0.1])
def test_everything_seen_is_dominated_within_epsilon_by_something_kept(epsilon: float) -> None:
    values = np.random.default_rng(3).lognormal(size=(5000, 4))
    front = streamed(values, epsilon, 5)
    reached = (
        (front.values[:, None, :] * (1 + epsilon) * (1 + 1e-12) >= values[None, :, :])
        .all(axis=2)
        .any(axis=0)
    )
    assert reached.all()
    assert len(front.numbers) < len(undominated(values))
    boxes = np.floor(np.log(front.values) / math.log1p(epsilon))
    assert undominated(boxes) == list(range(len(boxes)))


def test_a_point_worth_nothing_in_one_aim_is_kept_where_nothing_beats_it() -> None:
    values = np.array([[0.0, 5.0], [1.0, 4.0], [0.0, 4.0]])
    assert streamed(values, 0.0, 1).numbers.tolist() == [0, 1]
    assert streamed(values, 0.1, 1).numbers.tolist() == [0, 1]

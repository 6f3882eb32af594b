"""A verdict rejects honest benches as often as it says and no more, and dishonest ones nearly
always.
"""

import numpy as np
import pytest

from flflab.errors import InputError
from flflab.verdict.comparison import count_spread, judge, z_score

THRESHOLD = 0.05


def generator(key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=key))


def one_sided_draws(count: int, rng: np.random.Generator) -> np.ndarray:
    """Contrast near focus: it falls whichever way the stage is off, so its distribution is
    skewed.
    """
    off = rng.normal(size=(count, 1))
    return 0.8 - np.array([[0.01, 0.03, 0.06]]) * off**2


def verdict_rate(bias: float, trials: int) -> float:
    noise = np.diag([0.002, 0.003, 0.004]) ** 2
    draws = one_sided_draws(2000, generator(1))
    rejected = 0
    for trial in range(trials):
        rng = generator(100 + trial)
        measured = one_sided_draws(1, rng)[0] + rng.multivariate_normal(np.zeros(3), noise) + bias
        rejected += not judge("mtf", measured, noise, draws, THRESHOLD, rng).accepted
    return rejected / trials


def test_honest_benches_are_rejected_as_often_as_stated() -> None:
    # 400 trials of probability 0.05: three standard deviations are 0.033.
    assert verdict_rate(0.0, 400) == pytest.approx(THRESHOLD, abs=0.033)


def test_a_bench_that_is_off_by_more_than_its_uncertainty_is_rejected() -> None:
    assert verdict_rate(0.05, 40) >= 0.95


def test_counts_without_doubt_accept_equal_counts_and_reject_others() -> None:
    draws = np.full((400, 4), 6.0)
    doubt = np.diag(np.full(4, 1 / 400))
    assert judge("views", np.full(4, 6.0), doubt, draws, THRESHOLD, generator(1)).accepted
    assert not judge(
        "views", np.array([6, 6, 6, 5.0]), doubt, draws, THRESHOLD, generator(1)
    ).accepted


def test_a_count_that_no_draw_ever_missed_still_has_a_finite_uncertainty() -> None:
    spread = count_spread(np.full((399, 2), 6), np.array([6, 6]))
    assert spread == pytest.approx([0.05, 0.05])


def test_z_of_no_difference_is_zero_even_without_uncertainty() -> None:
    assert z_score(0.0, 0.0) == 0.0
    assert z_score(1.0, 0.5) == 2.0
    assert z_score(-1.0, 0.0) == -np.inf


def test_values_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(InputError, match="do not fit together"):
        judge("mtf", np.zeros(2), np.eye(3), np.zeros((200, 2)), THRESHOLD, generator(1))

"""Frames until an accuracy is reached: as many as it takes, no bias by stopping, an end in any
case.
"""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flflab.measurement.sequential import Look, frames_due

Array = npt.NDArray[np.float64]


def looked(per_frame: float, lasting: float, wanted: float, first: int, most: int) -> list[Look]:
    """Every look of a point whose uncertainty follows u^2 = a / n + c exactly."""
    looks: list[Look] = []
    due = first
    while not looks or due > looks[-1].frames:
        looks.append(Look(due, math.sqrt(per_frame / due + lasting)))
        due = frames_due(tuple(looks), wanted, most)
    return looks


@given(
    st.floats(1e-6, 1.0),
    st.floats(0, 1e-2),
    st.floats(1e-3, 0.3),
    st.integers(1, 8),
    st.integers(8, 500),
)
def test_it_takes_as_many_frames_as_are_needed_and_hardly_more_and_always_ends(
    per_frame: float, lasting: float, wanted: float, first: int, most: int
) -> None:
    looks = looked(per_frame, lasting, wanted, first, most)
    assert len(looks) <= 4
    assert [look.frames for look in looks] == sorted({look.frames for look in looks})
    last = looks[-1]
    assert last.frames <= most
    needed = math.inf if wanted**2 <= lasting else per_frame / (wanted**2 - lasting)
    if last.frames < most:
        assert last.uncertainty <= wanted
        assert last.frames <= max(first, math.ceil(needed * (1 + 1e-6)) + 1)
    elif needed <= most * (1 - 1e-6):
        assert last.uncertainty <= wanted


def test_where_no_number_of_frames_is_enough_it_takes_the_most_and_stops() -> None:
    looks = looked(1e-4, 4e-4, 0.01, 1, 64)
    assert looks[-1].frames == 64
    assert looks[-1].uncertainty > 0.01


@pytest.mark.parametrize(
    "electrons",
    [30.0, *(pytest.param(electrons, marks=pytest.mark.ci) for electrons in (3.0, 3000.0))],
)
def test_stopping_by_the_uncertainty_biases_the_contrast_by_less_than_a_twentieth_of_it(
    electrons: float,
) -> None:
    """Sine bars of contrast 0.6 in 400 pixels of photons, the noise computed from the very pixels
    as the fit does it: 4000 runs each.
    """
    contrast, pixels, runs, most = 0.6, 400, 4000, 64
    wanted = 0.5 / math.sqrt(electrons * pixels)  # some eight frames
    rng = np.random.default_rng(5)
    wave = np.cos(2 * np.pi * 7.3 * np.arange(pixels) / pixels)
    design = np.stack([np.ones(pixels), wave], axis=1)
    sums = np.zeros((runs, pixels))
    looks: list[tuple[Look, ...]] = [()] * runs
    due, found, fixed = np.full(runs, 2), np.full((runs, 2), np.nan), np.full(runs, np.nan)
    for taken in range(1, most + 1):
        sums += rng.poisson(electrons * (1 + contrast * wave), (runs, pixels))
        for run in np.flatnonzero(due == taken):
            value, uncertainty = measured(sums[run] / taken, taken, design)
            looks[run] = (*looks[run], Look(taken, uncertainty))
            due[run] = frames_due(looks[run], wanted, most)
            if due[run] == taken:
                found[run] = value, uncertainty
                due[run] = 0
        if taken == 8:
            fixed[:] = [measured(row / taken, taken, design)[0] for row in sums]
        if not due.any() and taken >= 8:
            break
    errors = found[:, 0] - contrast
    assert (
        abs(errors.mean() - (fixed.mean() - contrast)) < 0.05 * wanted
    )  # chance alone makes some 0.01
    assert 4 < np.mean([run[-1].frames for run in looks]) < 16
    assert np.quantile(found[:, 1], 0.99) <= wanted
    assert (errors / found[:, 1]).std() == pytest.approx(1, abs=0.06)


def measured(mean: Array, frames: int, design: Array) -> tuple[float, float]:
    """Contrast and its standard uncertainty by weighted least squares, weights from a first
    unweighted fit.
    """
    level, swing = np.linalg.lstsq(design, mean, rcond=None)[0]
    model = np.maximum(design @ [level, swing], 0.05 * level)
    weight = frames / model
    covariance = np.linalg.inv(design.T @ (design * weight[:, None]))
    level, swing = covariance @ (design.T @ (weight * mean))
    gradient = np.array([-swing / level**2, 1 / level])
    return swing / level, float(np.sqrt(gradient @ covariance @ gradient))

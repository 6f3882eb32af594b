"""From the sweep's disparity to the best one, its uncertainty, and which places keep a value.

Every place has information A and score B about its disparity. Over a window the best common one is
sum(A delta + B) / sum(A). Its variance follows from how scores scatter from block to block, not
from the noise alone: views that are blurred or lit differently misfit by more than noise.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter, uniform_filter1d

from flflab.depth_map.kernels import BY_PLACES, INFORMATION, PRETENDED, SCORE, VIEWS
from flflab.depth_map.steps import jumps, settle_steps
from flflab.depth_map.sweep import WINDOW, Swept
from flflab.depth_map.views import Views

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

ROUNDS = 3
LARGEST_STEP_PX = 1.0  # of one round, at a baseline of one pitch
BLOCKS = ((5, 5), (9, 1), (1, 9))  # places over which scores are summed for their scatter
SCATTER_WINDOW = 25  # places a side over which that scatter is averaged
# Accepted are places whose cost is this many times smaller than the second best, whose information
# is this many times what noise alone pretends, and whose sigma is below this, px a pitch.
LEAST_RATIO, LEAST_INFORMATION, LARGEST_SIGMA_PX = 1.3, 2.5, 0.25
JUMP_PX = 0.6  # px a pitch between neighbours: depth steps there


@dataclass(frozen=True)
class Refined:
    """The best disparity of every place, NaN where there is none.

    Attributes:
        disparity: virtual disparity.
        sigma: its standard uncertainty.
        views: number of views that were compared.
    """

    disparity: Array
    sigma: Array
    views: Array


def refine(
    views: Views, swept: Swept, pitch_px: float, floor_px: float, progress: Callable[[float], None]
) -> Refined:
    """Refine, state an uncertainty, and keep what can be trusted.

    Args:
        views: the picture.
        swept: the sweep's result.
        pitch_px: of the array, px of the sensor.
        floor_px: smallest uncertainty stated, px at a baseline of one pitch.
        progress: called with the share done.
    """
    delta = swept.disparity
    sums = np.zeros(0)
    for index in range(ROUNDS):
        sums = views.scores(delta)
        information = _box(sums[INFORMATION], delta)
        weighted = _box(sums[INFORMATION] * np.nan_to_num(delta) + sums[SCORE], delta)
        most = LARGEST_STEP_PX / pitch_px
        with np.errstate(invalid="ignore", divide="ignore"):
            step = _box(sums[SCORE], delta) / information
            moved = weighted / information
            near = np.abs(moved - delta) < 4 * most
        moved = np.where(near, moved, delta + np.clip(step, -most, most))
        delta = np.where(np.isfinite(moved), moved, np.nan)
        progress((index + 1) / (ROUNDS + 1))
    sums = views.scores(delta)
    least = JUMP_PX / pitch_px
    mixed = jumps(delta, least)
    sigma = np.sqrt(_sigma(sums, delta, mixed) ** 2 + sums[BY_PLACES] + (floor_px / pitch_px) ** 2)
    information = _box(sums[INFORMATION], delta)
    pretended = _box(sums[PRETENDED], delta)
    with np.errstate(invalid="ignore"):
        trusted = (
            (swept.ratio >= LEAST_RATIO)
            & (information >= LEAST_INFORMATION * pretended)
            & (sigma < LARGEST_SIGMA_PX / pitch_px)
            & (sums[VIEWS] >= 2)
            & np.isfinite(delta)
        )
    delta, sigma, trusted = settle_steps(views, delta, sigma, trusted, sums, mixed, least, WINDOW)
    progress(1.0)
    return Refined(
        np.where(trusted, delta, np.nan),
        np.where(trusted, sigma, np.nan),
        np.where(trusted, sums[VIEWS], 0.0),
    )


def _box(values: Array, delta: Array) -> Array:
    """Sum over a window; values without a disparity count as zero."""
    return WINDOW**2 * uniform_filter(
        np.where(np.isfinite(delta), values, 0.0), WINDOW, mode="constant"
    )


def _sigma(sums: Array, delta: Array, jump: Flags) -> Array:
    """Standard uncertainty of a window's disparity.

    Scores are taken against the mean disparity around: at a window's own they add up to nothing.
    Scores summed over blocks of b places have the variance b k A, A the information a place: their
    largest k over the shapes of blocks makes the window's variance k / sum(A). What noise adds to A
    is taken off.
    """
    information = np.where(jump, 0.0, sums[INFORMATION])
    wide = uniform_filter(information, SCATTER_WINDOW, mode="constant")
    here = np.nan_to_num(delta)
    score = np.where(jump, 0.0, sums[SCORE])
    with np.errstate(invalid="ignore", divide="ignore"):
        around = uniform_filter(information * here + score, SCATTER_WINDOW, mode="constant") / wide
    score = score + information * (here - np.nan_to_num(around))
    worst = np.zeros_like(score)
    for shape in BLOCKS:
        number = shape[0] * shape[1]
        rows = uniform_filter1d(score, shape[0], axis=0, mode="constant")
        block = number * uniform_filter1d(rows, shape[1], axis=1, mode="constant")
        worst = np.maximum(
            worst, uniform_filter(block**2 / number, SCATTER_WINDOW, mode="constant")
        )
    told = WINDOW**2 * uniform_filter(sums[INFORMATION] - sums[PRETENDED], WINDOW, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = worst / wide
        return np.where(
            told > 0, np.sqrt(scatter * (_whole(sums[INFORMATION]) / told) / told), np.inf
        )


def _whole(values: Array) -> Array:
    return WINDOW**2 * uniform_filter(values, WINDOW, mode="constant")

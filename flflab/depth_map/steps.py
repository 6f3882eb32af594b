"""Where depth steps: windows that hold a step mix both sides, so a place there takes the value of
a whole window on the side that its own views agree with, else none.
"""

import warnings

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from flflab.depth_map.kernels import MISFIT, VIEWS
from flflab.depth_map.views import Views

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

OWN_WINDOW = 5  # places a side that speak for a side
CLEARER = 1.5  # times smaller must one side's misfit be than the other's
WORSE = 2.0  # times the misfit around: views of one place disagree
MARGIN = 5  # places a side by which what looks steep is widened
AT_MOST = 3.0  # times the misfit of the whole window it is taken from


def jumps(disparity: Array, least: float) -> Flags:
    """Places whose window mixes two depths: there the disparity changes by more than ``least`` from
    place to place.
    """
    high = maximum_filter(np.where(np.isfinite(disparity), disparity, -np.inf), 3)
    low = minimum_filter(np.where(np.isfinite(disparity), disparity, np.inf), 3)
    with np.errstate(invalid="ignore"):
        steep = (high - low > least) & np.isfinite(disparity)
    return np.asarray(maximum_filter(steep, MARGIN), dtype=np.bool_)


def settle_steps(
    views: Views,
    disparity: Array,
    sigma: Array,
    trusted: Flags,
    sums: Array,
    mixed: Flags,
    jump: float,
    window: int,
) -> tuple[Array, Array, Flags]:
    """Give mixed places the value of a side, or none.

    The sides are the whole windows that hold the place, apart by more than a jump; their values are
    means. Each place's own views, in a small window, say which side it is on.

    Args:
        views: the picture.
        disparity: of every place.
        sigma: its uncertainty.
        trusted: which are.
        sums: of ``sum_scores`` at these disparities.
        mixed: see ``jumps``.
        jump: difference of disparity that makes two sides.
        window: places a side of the windows.

    Returns:
        disparity, sigma, trusted.
    """
    rows, columns = np.nonzero(mixed)
    if not len(rows):
        return disparity, sigma, trusted
    cost = _cost(sums, window)
    whole = trusted & ~mixed & ~_occluded(cost, trusted & ~mixed, mixed, window)
    found = _around(np.where(whole, disparity, np.nan), rows, columns, window)
    doubt = _around(np.where(whole, sigma, np.nan), rows, columns, window)
    usual = _around(np.where(whole, cost, np.nan), rows, columns, window)
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where there is no whole window: NaN
        high, low = np.nanmax(found, axis=1), np.nanmin(found, axis=1)
        least = np.nanmedian(usual, axis=1)
        middle = (high + low)[:, None] / 2
        sides = [
            (_mean(found, chosen), _mean(doubt, chosen))
            for chosen in (found >= middle, found <= middle)
        ]
    costs: list[Array] = []
    for value, _ in sides:
        tried = np.full(disparity.shape, np.nan)
        tried[rows, columns] = value
        costs.append(_cost(views.scores(tried), OWN_WINDOW)[rows, columns])
    with np.errstate(invalid="ignore"):
        fits = [cost < AT_MOST * least for cost in costs]
        alike = high - low < jump
        first = fits[0] & (alike | (costs[0] * CLEARER < costs[1]))
        second = fits[1] & ~alike & (costs[1] * CLEARER < costs[0])
    disparity, sigma = disparity.copy(), sigma.copy()
    for taken, (value, own) in ((first, sides[0]), (second, sides[1])):
        place = rows[taken], columns[taken]
        disparity[place], sigma[place], whole[place] = value[taken], own[taken], True
    return disparity, sigma, whole


def _occluded(cost: Array, whole: Flags, mixed: Flags, window: int) -> Flags:
    """Places beside a step whose views agree less well than those around: some microlenses see the
    nearer side in front of them.
    """
    own = np.where(whole & np.isfinite(cost), cost, 0.0)
    wide = 3 * window
    with np.errstate(invalid="ignore", divide="ignore"):
        usual = uniform_filter(own, wide) / uniform_filter((own > 0).astype(np.float64), wide)
        beside = np.asarray(maximum_filter(mixed, 2 * window + 1), dtype=np.bool_)
        return beside & (cost > WORSE * usual)


def _around(
    values: Array, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64], window: int
) -> Array:
    """Values of the windows round some places, shape (places, window^2)."""
    padded = np.pad(values, window // 2, constant_values=np.nan)
    every = np.lib.stride_tricks.sliding_window_view(padded, (window, window))
    return every[rows, columns].reshape(len(rows), -1)


def _mean(values: Array, chosen: Flags) -> Array:
    return np.nansum(np.where(chosen, values, 0.0), axis=1) / np.sum(chosen, axis=1)


def _cost(sums: Array, window: int) -> Array:
    """Misfit over number of views less one, in windows."""
    free = np.maximum(sums[VIEWS] - 1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return uniform_filter(sums[MISFIT], window, mode="constant") / uniform_filter(
            free, window, mode="constant"
        )

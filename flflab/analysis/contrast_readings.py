"""Two readings of eq. (2), (max - min)/(max + min): off the fitted wave over all phases, and off the noisy pixels as a baseline."""

import math

import numpy as np
import numpy.typing as npt

from flflab.analysis.contrast_fit import ChirpData, Knots, Template

Array = npt.NDArray[np.float64]


def fitted_extremes(curve: Array, covariance: Array, knots: Knots, frequency: Array, template: Template, bars: bool) -> tuple[Array, Array]:
    """Largest excursion of the fitted wave at each frequency and its uncertainty."""
    top = knots.first + knots.step * (knots.count - 3)
    phase = (np.arange(256) + 0.5) / 512
    largest, spread = np.zeros(len(frequency)), np.zeros(len(frequency))
    for n, nu in enumerate(frequency):
        orders = np.arange(1, max(2.0, top / nu + 1e-9), 2) if bars else np.array([1.0])
        waves = np.sin(2 * np.pi * np.outer(phase, orders)) * (4 / (np.pi * orders) if bars else 1.0)
        rows = waves @ knots.design(orders * nu, template)
        rows[:, 0] = template.bars(phase, nu) if bars else 0.0
        at = int(np.argmax(np.abs(rows @ curve)))
        largest[n], spread[n] = abs(float(rows[at] @ curve)), math.sqrt(max(0.0, float(rows[at] @ covariance @ rows[at])))
    return largest, spread


def read_extremes(data: ChirpData, lens: npt.NDArray[np.int64], frequency: Array, knots: Array, step: float) -> tuple[Array, Array]:
    """(max - min)/(max + min) of each view's pixels near each frequency: mean over the views and its scatter."""
    mean, spread = np.full(len(knots), np.nan), np.full(len(knots), np.nan)
    for n, nu in enumerate(knots):
        near = np.abs(frequency - nu) <= step / 2
        views = lens[near]
        counts = np.bincount(views)
        high, low = np.full(len(counts), -np.inf), np.full(len(counts), np.inf)
        np.maximum.at(high, views, data.read[near])
        np.minimum.at(low, views, data.read[near])
        held = counts >= max(4, counts.max(initial=0) / 2)
        if held.any():
            readings = (high[held] - low[held]) / np.maximum(high[held] + low[held], 1e-300)
            mean[n] = readings.mean()
            spread[n] = readings.std(ddof=1) / math.sqrt(held.sum()) if held.sum() > 1 else np.nan
    return mean, spread

"""Least squares fit of a chirp seen through many micro-images.

The views' own numbers are normally distributed; how widely, their own scatter says. They are
eliminated view by view from the normal equations of what is common.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.model import (
    ACROSS,
    BLUR,
    DISC,
    LIGHT,
    NUMBERS,
    SHIFT,
    Fit,
    Model,
    Seen,
    derivatives,
    look_at,
    weights,
)
from flflab.measurement.contrast.runs import Runs
from flflab.measurement.solver import settle

Array = npt.NDArray[np.float64]

# standard deviation from view to view before any is seen, in the model's units
LOOSE = np.array([1.0, 0.3, 0.3, 0.3, 1.0, 0.01, 30.0])
MOST_LOOKS = 25
STRANGE = 3.0  # times the noise: a view that departs so far is looked for anew
DISCS, SHIFTS, STEPS_ALONE = (0.0, 2.0, 4.0, 6.0, 8.0), (0.0, -0.6, 0.6), 4  # px to start from


@dataclass(frozen=True)
class Equations:
    """Normal equations of V views, one by one, priors of their own numbers counted in.

    Attributes:
        own: matrix of each view's own numbers, shape (V, 7, 7).
        mixed: own against common, shape (V, 7, P).
        normal: of the common parameters, shape (V, P, P).
        right: its right side, shape (V, P).
        own_right: of each view's own numbers, shape (V, 7).
        inverse: of ``own``, where the views' own numbers were eliminated from ``normal`` and
            ``right``, else empty.
    """

    own: Array
    mixed: Array
    normal: Array
    right: Array
    own_right: Array
    inverse: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))


def equations(
    runs: Runs, model: Model, fit: Fit, seen: Seen, weight: Array
) -> tuple[Equations, float]:
    """The views' normal equations where a fit sees the runs, and chi squared without the common
    prior.
    """
    root = np.sqrt(weight)
    g, h = (part * root[:, None] for part in derivatives(runs, model, fit, seen))
    rest, tie, ends = (runs.read - seen.due) * root, model.tie, runs.ends
    cost = float(rest @ rest) + float(np.sum(fit.own**2 @ tie))
    views = [slice(*pair) for pair in itertools.pairwise(ends)]
    own = np.array([h[at].T @ h[at] for at in views]) + np.diag(tie)
    mixed = np.array([h[at].T @ g[at] for at in views])
    normal = np.array([g[at].T @ g[at] for at in views])
    right = np.array([rest[at] @ g[at] for at in views])
    pull = np.array([rest[at] @ h[at] for at in views]) - fit.own * tie
    return Equations(own, mixed, normal, right, pull), cost


def eliminated(raw: Equations, damping: float = 0.0) -> Equations:
    """With the views' own numbers eliminated."""
    inverse = inverse_of(raw.own * (1 + damping * np.eye(NUMBERS)))
    through = np.einsum("vip,vij->vpj", raw.mixed, inverse)
    return replace(
        raw,
        inverse=inverse,
        normal=raw.normal - through @ raw.mixed,
        right=raw.right - np.einsum("vpj,vj->vp", through, raw.own_right),
    )


def fitted(
    runs: Runs, model: Model, fit: Fit, rounds: int, close: float
) -> tuple[Fit, Model, Array]:
    """The fit of all runs, from one near by; the model with the views' spread, and the weights.

    Args:
        runs: of pixels.
        model: what is known.
        fit: where to begin.
        rounds: of weights and spreads.
        close: fall of chi squared below which each has ended.
    """
    loose, weight = LOOSE * model.units, np.zeros(0)
    model = replace(model, spread=loose)
    for _ in range(rounds):
        seen = look_at(runs, model, fit)
        weight = weights(runs, seen)[1]
        # a view that departs from the model has more noise than its pixels
        misfit = _misfit((runs.read - seen.due) ** 2 * weight, runs)
        weight = weight / np.maximum(misfit, 1.0)[runs.view]
        fit = _centred(settle(fit, _looker(runs, model, weight), close, MOST_LOOKS))
        raw, _ = equations(runs, model, fit, look_at(runs, model, fit), weight)
        doubt = np.einsum("vii->vi", inverse_of(raw.own))
        spread = np.minimum(np.sqrt(np.mean(fit.own**2 + doubt, axis=0)), loose)
        spread[LIGHT] = loose[LIGHT]  # light has no mean that all views come near
        model = replace(model, spread=spread)
    return fit, model, weight


def each_alone(runs: Runs, model: Model, fit: Fit) -> Fit:
    """Every view's own numbers beside common parameters that are held; of a view that departs from
    the fit the best of several blurs and shifts to start from.
    """
    own, misfit = _alone(runs, model, fit)
    for disc, shift in itertools.product(DISCS, SHIFTS):
        bad = misfit > STRANGE
        if not bad.any():
            break
        start = np.zeros((np.count_nonzero(bad), NUMBERS))
        start[:, SHIFT] = shift * model.pixel_seen
        start[:, BLUR] = (disc * model.pixel_seen) ** 2 - fit.common[DISC]
        trial, left = _alone(runs.part(bad[runs.view]), model, Fit(fit.common, start))
        better = np.flatnonzero(bad)[left < misfit[bad]]
        own[better], misfit[better] = trial[left < misfit[bad]], left[left < misfit[bad]]
    return _centred(Fit(fit.common, own))


def _centred(fit: Fit) -> Fit:
    """The same, what the views have alike counted to what is common."""
    common, own = fit.common.copy(), fit.own.copy()
    for alike, number in ((0, SHIFT), (1, ACROSS), (DISC, BLUR)):
        middle = float(np.median(own[:, number]))
        common[alike] += middle
        own[:, number] -= middle
    return Fit(common, own)


def _alone(runs: Runs, model: Model, fit: Fit) -> tuple[Array, Array]:
    """The best own numbers of each view on a few steps from a fit, and their misfit."""
    model = replace(model, spread=LOOSE * model.units)
    own, kept, best = fit.own, fit.own.copy(), np.full(len(fit.own), np.inf)
    for _ in range(STEPS_ALONE):
        trial = Fit(fit.common, own)
        seen = look_at(runs, model, trial)
        weight = weights(runs, seen)[1]
        misfit = _misfit((runs.read - seen.due) ** 2 * weight, runs)
        kept[misfit < best], best = own[misfit < best], np.minimum(misfit, best)
        raw, _ = equations(runs, model, trial, seen, weight)
        own = own + np.einsum("vij,vj->vi", inverse_of(raw.own), raw.own_right)
        own[:, BLUR] = np.maximum(own[:, BLUR], -fit.common[DISC])
    return kept, best


def _misfit(squares: Array, runs: Runs) -> Array:
    """Mean of what the runs of each view leave, shape (V,)."""
    return np.bincount(runs.view, squares) / np.diff(runs.ends)


def _looker(
    runs: Runs, model: Model, weight: Array
) -> Callable[[Fit], tuple[float, Callable[[float], Fit]]]:
    """Chi squared of a fit, its priors counted in, and where a damped step leads from there."""
    precision = model.doubt**-2.0

    def look(fit: Fit) -> tuple[float, Callable[[float], Fit]]:
        raw, cost = equations(runs, model, fit, look_at(runs, model, fit), weight)
        off = model.mean - fit.common

        def step(damping: float) -> Fit:
            found = eliminated(raw, damping)
            normal = found.normal.sum(axis=0) + np.diag(precision)
            normal += damping * np.diag(raw.normal.sum(axis=0).diagonal() + precision)
            moved = inverse_of(normal) @ (found.right.sum(axis=0) + precision * off)
            own = np.einsum("vij,vj->vi", found.inverse, raw.own_right - raw.mixed @ moved)
            common, values = fit.common + moved, fit.own + own
            common[DISC] = max(common[DISC], 0.0)
            values[:, BLUR] = np.maximum(values[:, BLUR], -common[DISC])
            return Fit(common, values)

        return cost + float(off**2 @ precision), step

    return look


def inverse_of(normal: Array) -> Array:
    """Of normal matrices whose parameters have very different units, shape (..., P, P)."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", normal), 1e-30))
    scale = scale[..., :, None] * scale[..., None, :]
    return np.linalg.inv(normal / scale + 1e-12 * np.eye(normal.shape[-1])) / scale

"""What the views of bars have each for itself: light, place, magnification and blur, where lenses
differ by more than the noise shows.

Every view has six numbers beside the common fit (``NUMBERS``), normally distributed over the views.
How wide, their own scatter says (expectation maximisation). They are eliminated view by view from
the normal equations of the common parameters. How far these hang on single views is what deleting
one group of views after the other changes (the jackknife).
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.data import ChirpData
from flflab.measurement.contrast.fit import (
    CURVE,
    GEOMETRY,
    MOST_CYCLES_A_STEP,
    ChirpFit,
    ChirpModel,
    Prior,
    derivatives,
    expected,
    inverse_of,
    strength_of,
    variance_and_weight,
)

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# light, its slope and its bend over half a field along x, as shares; shift, mm on the target;
# magnification, mm on the target a mm; square of the disc of blur, mm^2
NUMBERS = 6
SHIFT, MAGNIFICATION, BLUR = 3, 4, 5
LOOSE = np.array([0.3, 0.1, 0.1, 3.0, 0.02, 30.0])  # expected at first, in the units of ``_units``
CLEARLY = 3.0  # standard deviations of chi squared by which views must differ
MOST_STEPS, SETTLED = 15, 2e-4
MOST_WIDER = 3.0  # px^2 by which a step may change the square of a disc
GOOD = 0.4  # logarithm of the misfit, in the mean of views: then no other start is tried
LEAST_GAIN = 0.05  # of chi squared in all: then a fit has ended
SHORTER = (1.0, 0.3, 0.1, 0.03)  # shares of a step, the first that helps
STRENGTH = 0.02  # of the template's over the whole transfer's
FARTHEST = 5.0  # of the spread of views that a single one may be off
DISCS, STEPS_ALONE = (0.0, 2.0, 4.0, 7.0), 5  # px of blur to start from
STRANGE = 4.0  # times the usual misfit: a view that departs so far counts less
MOST_GROUPS = 60


@dataclass(frozen=True)
class Views:
    """The views' own numbers.

    Attributes:
        lenses: position of each view in the lattice, shape (V,).
        values: shape (V, 6).
        spread: standard deviation from view to view, shape (6,); 0: they do not differ.
        excess: by how much more than usual each departs from the model, at least 1, shape (V,).
        half: half of a field, mm on the sensor.
    """

    lenses: Whole
    values: Array
    spread: Array
    excess: Array
    half: float

    @property
    def differ(self) -> bool:
        """Whether views differ by more than the noise."""
        return bool(self.spread.any())

    def those(self, data: ChirpData) -> Whole:
        """Which view each run belongs to."""
        return np.searchsorted(self.lenses, data.lens)

    def seen_in(self, data: ChirpData) -> ChirpData:
        """The runs as their own views see the target."""
        view = self.those(data)
        own, t = self.values[view], data.places[:, 1] / self.half
        lit, excess = 1 + own[:, 0] + t * (own[:, 1] + t * own[:, 2]), self.excess[view]
        return replace(
            data,
            light=data.light * lit[:, None],
            aside=own[:, SHIFT] + own[:, MAGNIFICATION] * data.places[:, 1],
            wider=own[:, BLUR],
            dark=data.dark * excess,
            shot=data.shot * excess,
        )


@dataclass(frozen=True)
class _Sum:
    """Of one view: normal matrices of its own numbers and of the common ones, and right sides."""

    own: Array
    mixed: Array
    common: Array
    right: Array
    common_right: Array
    misfit: float


def _sums(data: ChirpData, views: Views, model: ChirpModel, fit: ChirpFit) -> list[_Sum]:
    seen, (more, step) = views.seen_in(data), model.blurred
    blurred = len(model.edges) > 0
    level, wave, g = derivatives(seen, model, fit, model.top)
    due, t = level * (1 + wave), data.places[:, 1] / views.half
    wider = (expected(seen, more, fit) - due) / step if blurred else np.zeros(len(due))
    h = np.stack([due, t * due, t * t * due, g[:, 0], g[:, 1], wider], axis=1)
    _, weight = variance_and_weight(seen, level, due)
    root = np.sqrt(weight)
    rest, g, h = (data.read - due) * root, g * root[:, None], h * root[:, None]
    order = np.argsort(views.those(data), kind="stable")
    ends = np.searchsorted(views.those(data)[order], np.arange(len(views.lenses) + 1))
    found = list[_Sum]()
    for first, last in itertools.pairwise(ends):
        at = order[first:last]
        G, H, r = g[at], h[at], rest[at]
        misfit = float(np.mean(r * r))
        found.append(_Sum(H.T @ H, H.T @ G, G.T @ G, H.T @ r, G.T @ r, misfit))
    return found


def _tied(views: Views) -> Array:
    """Inverse variance of each number; one that does not differ is held."""
    return 1 / np.maximum(views.spread, 1e-15) ** 2


def views_of(data: ChirpData, model: ChirpModel, fit: ChirpFit) -> Views:
    """The views of a fit of all alike, and whether they differ clearly."""
    lenses, half = np.unique(data.lens), float(np.abs(data.places[:, 1]).max(initial=1e-9))
    pixel = model.template.pixel
    units = np.array([1.0, 1.0, 1.0, pixel, abs(float(fit.geometry[1])), pixel**2])
    units[BLUR] *= len(model.edges) > 0
    even = np.zeros((len(lenses), NUMBERS)), LOOSE * units, np.ones(len(lenses))
    views = Views(lenses, *even, half)
    sums = _sums(data, views, model, fit)
    inverse = np.array([inverse_of(one.own + np.diag(_tied(views))) for one in sums])
    free = np.einsum("nij,nj->ni", inverse, [one.right for one in sums])
    chi2 = np.mean(free**2 / np.maximum(np.einsum("nii->ni", inverse), 1e-300), axis=0)
    differ = (chi2 > 1 + CLEARLY * math.sqrt(2 / len(lenses))) & (len(lenses) > 2)
    # a fit gone astray does not say in what they differ
    return replace(views, spread=views.spread * bool(differ.any()))


def with_views(
    views: Views,
    data: ChirpData,
    model: ChirpModel,
    fit: ChirpFit,
    prior: Prior,
    found: tuple[tuple[ChirpModel, Array], ...],
) -> tuple[Views, ChirpModel, ChirpFit]:
    """The views' own numbers, and model and fit beside them; the runs themselves stay.

    Args:
        views: that differ.
        data: the runs.
        model: with the blur that suits all.
        fit: of all views alike.
        prior: of the common parameters.
        found: other models and geometries to start from, where views that differ led that astray.
    """
    # first with the template alone, whose contrast is near 1, then with the free curve
    curve = np.eye(len(fit.curve))[0]
    tried = list[tuple[float, Views, ChirpModel, ChirpFit]]()
    for seen, geometry in ((model, fit.geometry), *found):
        alone = ChirpFit(geometry, fit.brightness, curve)
        begun = _each_alone(data, views, seen, alone, (0.0,))
        one = _settled(data, begun, seen, alone, _template_alone(prior))
        misfit = float(np.mean(np.log([each.misfit for each in _sums(data, *one)])))
        tried.append((misfit, *one))
        if misfit < GOOD:
            break
    _, views, model, fit = min(tried, key=lambda one: one[0])
    if np.any(views.excess > 1):
        views = _each_alone(data, views, model, fit, (-0.6, 0.0, 0.6))
    return _settled(data, views, model, fit, as_strong(prior, model, fit))


def _each_alone(
    data: ChirpData, views: Views, model: ChirpModel, fit: ChirpFit, shifts: tuple[float, ...]
) -> Views:
    """Every view's own numbers beside a common fit that is held: the best of several blurs and
    shifts (px) to start from, each view for itself.
    """
    pixel, tie = model.template.pixel, _tied(views)
    kept, best = views.values.copy(), np.full(len(views.lenses), math.inf)
    starts = [views.values]
    for disc, shift in itertools.product(DISCS if views.spread[BLUR] > 0 else (0.0,), shifts):
        own = np.zeros_like(views.values)
        own[:, SHIFT] = shift * pixel
        own[:, BLUR] = (disc * pixel) ** 2 - model.template.blur**2
        starts.append(own)
    for own in starts:
        for _ in range(STEPS_ALONE):
            sums = _sums(data, replace(views, values=own), model, fit)
            misfit = np.array([one.misfit for one in sums])
            better = misfit < best
            kept[better], best[better] = own[better], misfit[better]
            step = [
                inverse_of(one.own + np.diag(tie)) @ (one.right - tie * mine)
                for one, mine in zip(sums, own, strict=True)
            ]
            # a view that shows next to nothing goes no farther than views may differ
            own = np.nan_to_num(own + np.array(step))
            own = np.clip(own, -FARTHEST * views.spread, FARTHEST * views.spread)
            own[:, BLUR] = np.maximum(own[:, BLUR], -(model.template.blur**2))
    return replace(views, values=kept, excess=np.ones(len(kept)))


def _settled(
    data: ChirpData, views: Views, model: ChirpModel, fit: ChirpFit, prior: Prior
) -> tuple[Views, ChirpModel, ChirpFit]:
    sums = _sums(data, views, model, fit)
    for step in range(MOST_STEPS):
        before, tried, seen = _misfit(sums), (views, model, fit, 0.0), sums
        for part in SHORTER:
            tried = _stepped(data, views, model, fit, prior, sums, part)
            seen = _sums(data, *tried[:3])
            if _misfit(seen) < before:
                break
        (views, model, fit, moved), sums = tried, seen
        if step > 2:
            misfit = np.array([one.misfit for one in sums]) * views.excess
            usual = STRANGE * float(np.median(misfit))
            views = replace(views, excess=np.maximum(1.0, misfit / usual))
            sums = _sums(data, views, model, fit)
        gained = (before - _misfit(sums)) * len(data.read)
        if step > 3 and (moved < SETTLED or gained < LEAST_GAIN):
            break
    return views, model, fit


def _template_alone(prior: Prior) -> Prior:
    mean, spread = prior.mean.copy(), prior.spread.copy()
    mean[CURVE], spread[CURVE], spread[CURVE + 1 :] = 1.0, 0.1, 1e-4
    return Prior(mean, spread)


def as_strong(prior: Prior, model: ChirpModel, fit: ChirpFit) -> Prior:
    """The prior by which the template is as strong as the whole transfer: only then does a view's
    blur change as much as it should.
    """
    mean, spread = prior.mean.copy(), prior.spread.copy()
    if len(model.edges):
        mean[CURVE], spread[CURVE] = strength_of(model, fit), STRENGTH
    return Prior(mean, spread)


def _misfit(sums: list[_Sum]) -> float:
    return float(np.mean([one.misfit for one in sums]))


def _stepped(
    data: ChirpData,
    views: Views,
    model: ChirpModel,
    fit: ChirpFit,
    prior: Prior,
    sums: list[_Sum],
    share: float,
) -> tuple[Views, ChirpModel, ChirpFit, float]:
    """A share of a step of Gauss-Newton for all parameters, and how far it moved any place, in
    cycles.
    """
    tie = _tied(views)
    inverse = [inverse_of(one.own + np.diag(tie)) for one in sums]
    pulled = [one.right - tie * own for one, own in zip(sums, views.values, strict=True)]
    normal, right = np.diag(prior.spread**-2.0), np.zeros(len(prior.spread))
    right += normal @ (prior.mean - np.concatenate([fit.geometry, fit.brightness, fit.curve]))
    for one, inv, pull in zip(sums, inverse, pulled, strict=True):
        normal += one.common - one.mixed.T @ inv @ one.mixed
        right += one.common_right - one.mixed.T @ (inv @ pull)
    step = inverse_of(normal) @ right
    own = np.array(
        [
            inv @ (pull - one.mixed @ step)
            for one, inv, pull in zip(sums, inverse, pulled, strict=True)
        ]
    )
    view = views.those(data)
    shift = data.places @ step[:GEOMETRY] + own[view, SHIFT]
    shift += own[view, MAGNIFICATION] * data.places[:, 1]
    cycles = float(np.abs(shift * model.frequency(data.seen_at(fit.geometry))).max())
    part = share * min(1.0, 3 * MOST_CYCLES_A_STEP / max(cycles, 1e-300))
    step, own = part * step, part * own
    widest = MOST_WIDER * model.template.pixel**2
    own[:, BLUR] = np.clip(own[:, BLUR], -widest, widest)
    values = views.values + own
    doubt = np.array([np.diag(inv) for inv in inverse])
    spread = np.where(views.spread > 0, np.sqrt(np.mean(values**2 + doubt, axis=0)), 0.0)
    # what all views share is the common model's
    wider = float(values[:, BLUR].mean())
    square = max(model.template.blur**2 + wider, 0.0)
    values[:, BLUR] = np.maximum(values[:, BLUR] - wider, -square)
    model = model.with_blur(float(np.sqrt(square)))
    fit = ChirpFit(
        fit.geometry + step[:GEOMETRY],
        fit.brightness + step[GEOMETRY:CURVE],
        fit.curve + step[CURVE:],
    )
    return replace(views, values=values, spread=spread), model, fit, cycles


def jackknife(
    data: ChirpData, views: Views, model: ChirpModel, fit: ChirpFit, prior: Prior
) -> Array:
    """Covariance of the common parameters by leaving out one group of views after the other.

    Linearised where the fit ended: without a group's share of the normal equations the parameters
    move by what that group pulled.
    """
    tie, groups = np.diag(_tied(views)), min(len(views.lenses), MOST_GROUPS)
    size = len(prior.spread)
    normal, right = np.zeros((groups, size, size)), np.zeros((groups, size))
    for n, one in enumerate(_sums(data, views, model, fit)):
        inv = inverse_of(one.own + tie)
        pull = one.right - np.diag(tie) * views.values[n]
        normal[n % groups] += one.common - one.mixed.T @ inv @ one.mixed
        right[n % groups] += one.common_right - one.mixed.T @ (inv @ pull)
    whole = normal.sum(axis=0) + np.diag(prior.spread**-2.0)
    moves = np.array([-inverse_of(whole - normal[n]) @ right[n] for n in range(groups)])
    moves -= moves.mean(axis=0)
    return (groups - 1) / groups * moves.T @ moves


def unsure_blurs(data: ChirpData, views: Views, model: ChirpModel, fit: ChirpFit) -> Array:
    """Standard uncertainty of the square of every view's disc, mm^2, shape (V,): bars of two or
    four pixels hardly show it.
    """
    tie = np.diag(_tied(views))
    inverse = [inverse_of(one.own + tie)[BLUR, BLUR] for one in _sums(data, views, model, fit)]
    return np.sqrt(np.array(inverse))

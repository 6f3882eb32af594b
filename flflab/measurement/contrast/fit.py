"""Least squares fit of a chirp seen through many micro-images.

A run that looks at the target's x reads light (1 + bars(x)), with bars(x) the target seen through
the pixel and its view's disc of blur, so much of it as is common to all views, and what a free
curve of contrast against frequency, common too, adds where blur is no disc, as by diffraction.
Evaluated at the true places of the pixels, so frequencies beyond half a cycle a pixel need no
special case.

Every view has its own light, place, magnification and disc. They are eliminated view by view from
the normal equations of what is common.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.wave import seen_through
from flflab.measurement.solver import settle
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

NODES = 10  # of the free curve, evenly spaced over the target's frequencies
# common: shift, across x and y, along x and y; square of the disc of blur, mm^2; strength of bars
# through it; the free curve at its nodes
GEOMETRY, DISC, STRENGTH, FREE, COMMON = slice(0, 5), 5, 6, slice(7, 7 + NODES), 7 + NODES
# what a view has more: light, its slope and bend over half a field along x, its slope along y, as
# shares; shift, mm on the target; magnification, mm on the target a mm; square of its disc, mm^2
LIGHT, SHIFT, ACROSS, BLUR, OWN = slice(0, 4), 4, 5, 6, 7
# standard deviation from view to view: of light as shares, px on the target, share, px^2
LOOSE = np.array([1.0, 0.3, 0.3, 0.3, 0.2, 0.002, 30.0])
HIGHEST = 9  # harmonic of bars that the free curve counts
MOST_LOOKS = 12


@dataclass(frozen=True)
class Fit:
    """Common parameters, shape (17,), and every view's own, shape (V, 7)."""

    common: Array
    own: Array

    def moved(self, common: Array, own: Array) -> "Fit":
        """The fit with so much added; no square of a disc is below 0."""
        common, own = self.common + common, self.own + own
        common[DISC] = max(common[DISC], 0.0)
        own[:, BLUR] = np.maximum(own[:, BLUR], -common[DISC])
        return Fit(common, own)

    @property
    def squares(self) -> Array:
        """Of each view's disc of blur, mm^2, shape (V,)."""
        return self.common[DISC] + self.own[:, BLUR]


@dataclass(frozen=True)
class Model:
    """What is known of a picture of a chirp before it is fitted.

    Attributes:
        target: what stood there.
        pixel: of the sensor, mm.
        half: half of a bright field, mm on the sensor.
        level: the light's unit, DN.
        mean: of the common parameters, shape (17,).
        doubt: their standard deviation, shape (17,).
        spread: standard deviation of the views' own numbers, shape (7,).
    """

    target: Bars
    pixel: float
    half: float
    level: float
    mean: Array
    doubt: Array
    spread: Array

    def pixel_seen(self, fit: Fit) -> float:
        """A pixel on the target, mm."""
        return abs(float(fit.common[1])) * self.pixel


@dataclass(frozen=True)
class Seen:
    """What a fit makes of every run: where it looks, mm, what grey would read there, DN, and what
    the run should read, DN; each of shape (n,). Its derivatives by what is common, (n, 17), and by
    what is its view's own, (n, 7).
    """

    x: Array
    level: Array
    due: Array
    by_common: Array
    by_own: Array


def look_at(runs: Runs, model: Model, fit: Fit) -> Seen:
    """Runs as a fit has them."""
    own, across = fit.own[runs.view], runs.places[:, 1]
    x = runs.places @ fit.common[GEOMETRY] + own[:, SHIFT] + own[:, ACROSS] * across
    pixel, strength = model.pixel_seen(fit), fit.common[STRENGTH]
    bars, slope, wider = seen_through(model.target, x, pixel, fit.squares[runs.view])
    nodes, bent = _free_curve(model.target, x, fit.common[FREE])
    t, up = across / model.half, runs.places[:, 2] / model.half
    terms = np.stack([np.ones_like(t), t, t * t, up], axis=1)
    level = model.level * (1 + np.sum(terms * own[:, LIGHT], axis=1))
    light = 1 + strength * bars + nodes @ fit.common[FREE]
    moved, blurred = level * (strength * slope + bent), level * strength * wider
    by_common = [moved[:, None] * runs.places, blurred[:, None], (level * bars)[:, None]]
    by_common += [nodes * level[:, None]]
    by_own = [terms * (model.level * light)[:, None]]
    by_own += [part[:, None] for part in (moved, moved * across, blurred)]
    return Seen(x, level, level * light, np.hstack(by_common), np.hstack(by_own))


def amplitude(target: Bars) -> float:
    """Of the fundamental of a target of amplitude 1."""
    return 4 / math.pi if target.kind == "bars" else 1.0


def nodes_of(target: Bars) -> Array:
    """Frequencies at which the free curve is given, cycles/mm, shape (10,), rising."""
    return np.linspace(min(target.cycles_per_mm), max(target.cycles_per_mm), NODES)


def _free_curve(target: Bars, x: Array, contrast: Array) -> tuple[Array, Array]:
    """What bars show at x mm by contrast 1 at each node alone, shape (n, 10), and the slope of what
    they show by these contrasts, 1/mm, shape (n,). Harmonics count as far as the nodes reach.
    """
    nodes, frequency, turn = nodes_of(target), target.frequency(x), 2 * np.pi * target.phase(x)
    shown, slope = np.zeros((len(x), NODES)), np.zeros(len(x))
    for order in range(1, HIGHEST + 1, 2) if target.kind == "bars" else (1,):
        place = (order * frequency - nodes[0]) / (nodes[1] - nodes[0])
        here = np.flatnonzero(place <= NODES - 1)
        node = np.clip(place[here].astype(np.int64), 0, NODES - 2)
        part, size = place[here] - node, amplitude(target) / order
        wave = size * np.sin(order * turn[here])
        shown[here, node] += (1 - part) * wave
        shown[here, node + 1] += part * wave
        steep = size * 2 * np.pi * order * frequency[here] * np.cos(order * turn[here])
        slope[here] += ((1 - part) * contrast[node] + part * contrast[node + 1]) * steep
    return shown, slope


def weights(runs: Runs, seen: Seen) -> tuple[Array, Array]:
    """Variance of every run, DN^2, and its weight, that of grey: what a fit lacks of bars then
    tells nothing of their light.
    """
    dark, shot = runs.dark, runs.shot
    grey = dark + shot * np.maximum(seen.level, 0.0)
    return dark + shot * np.maximum(seen.due, 0.0), 1 / grey


def misfit_of(runs: Runs, seen: Seen, weight: Array) -> Array:
    """Mean of what the runs of each view leave, over its noise, shape (V,)."""
    return np.bincount(runs.view, (runs.read - seen.due) ** 2 * weight) / np.diff(runs.ends)


@dataclass(frozen=True)
class Equations:
    """Normal equations, priors counted in: of what is common, matrix (17, 17) and right side (17,);
    of each view's own numbers, (V, 7, 7) and (V, 7); own against common, (V, 7, 17); chi squared.
    """

    common: Array
    right: Array
    own: Array
    own_right: Array
    mixed: Array
    cost: float

    def step(self, damping: float) -> tuple[Array, Array]:
        """How far what is common and the views' own numbers move on a damped step."""
        inverse, left, right = self.eliminated(damping)
        common = inverse_of(left) @ right
        own = np.einsum("vij,vj->vi", inverse, self.own_right - self.mixed @ common)
        return common, own

    def eliminated(self, damping: float = 0.0) -> tuple[Array, Array, Array]:
        """The inverse of the views' own matrices, and matrix and right side of what is common
        without the views' own numbers.
        """
        inverse = inverse_of(self.own * (1 + damping * np.eye(OWN)))
        through = np.einsum("vip,vij->pvj", self.mixed, inverse)
        left = self.common + damping * np.diag(np.diag(self.common))
        left = left - np.einsum("pvj,vjq->pq", through, self.mixed)
        return inverse, left, self.right - np.einsum("pvj,vj->p", through, self.own_right)


def equations(runs: Runs, model: Model, fit: Fit, seen: Seen, weight: Array) -> Equations:
    """Where a fit sees the runs."""
    rest, root = (runs.read - seen.due)[:, None], np.sqrt(weight)[:, None]
    columns = np.hstack([seen.by_common, seen.by_own, rest]) * root
    sums = np.array([columns[a:b].T @ columns[a:b] for a, b in itertools.pairwise(runs.ends)])
    precision, tie, off = model.doubt**-2.0, model.spread**-2.0, model.mean - fit.common
    return Equations(
        sums[:, :COMMON, :COMMON].sum(axis=0) + np.diag(precision),
        sums[:, :COMMON, -1].sum(axis=0) + precision * off,
        sums[:, COMMON:-1, COMMON:-1] + np.diag(tie),
        sums[:, COMMON:-1, -1] - fit.own * tie,
        sums[:, COMMON:-1, :COMMON],
        float(sums[:, -1, -1].sum() + np.sum(fit.own**2 @ tie) + off**2 @ precision),
    )


def fitted(runs: Runs, model: Model, fit: Fit, close: float) -> tuple[Fit, Equations]:
    """The fit of all runs: where chi squared is least.

    Args:
        runs: of pixels.
        model: what is known.
        fit: where to begin.
        close: fall of chi squared below which it has ended.
    """
    seen = look_at(runs, model, fit)
    weight = weights(runs, seen)[1]
    # a view that departs from the model has more noise than its pixels
    weight = weight / np.maximum(misfit_of(runs, seen, weight), 1.0)[runs.view]

    def look(trial: Fit) -> tuple[float, Callable[[float], Fit]]:
        here = equations(runs, model, trial, look_at(runs, model, trial), weight)
        return here.cost, lambda damping: trial.moved(*here.step(damping))

    fit = settle(fit, look, close, MOST_LOOKS)
    return fit, equations(runs, model, fit, look_at(runs, model, fit), weight)


def inverse_of(normal: Array) -> Array:
    """Of normal matrices whose parameters have very different units, shape (..., P, P)."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", normal), 1e-30))
    scale = scale[..., :, None] * scale[..., None, :]
    return np.linalg.inv(normal / scale + 1e-12 * np.eye(normal.shape[-1])) / scale

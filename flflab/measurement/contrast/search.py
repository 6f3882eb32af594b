"""Finding a chirp in a picture: its place by the lowest frequencies, then all of it; and views that
went astray, again from several discs of blur.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.fit import (
    BLUR,
    COMMON,
    DISC,
    GEOMETRY,
    LIGHT,
    LOOSE,
    NODES,
    OWN,
    Equations,
    Fit,
    Model,
    equations,
    fitted,
    inverse_of,
    look_at,
    misfit_of,
    weights,
)
from flflab.measurement.contrast.frame import Frame
from flflab.measurement.contrast.readings import frequencies_of, views_of
from flflab.measurement.contrast.runs import Runs, runs_of
from flflab.measurement.contrast.wave import seen_through
from flflab.measurement.lattice.registration import PixelSet
from flflab.optics.focus import blur

Array = npt.NDArray[np.float64]

# cycles that bars may drift along a run of pixels: it takes 7e-5 of the highest frequency's
# contrast
MOST_SMEAR = 0.02
FIRST_RUN, MOST_ROWS = 16, 128  # pixels of a run while the bars' slant is not known, and after
REPAIRS = 2  # times that views which went astray are started anew
CLOSE = 0.03  # fall of chi squared that ends a part of the fit
FEWEST_RUNS = 200  # to begin with: fewer than several views' follow noise
WIDEST_SHIFT = 0.06  # of the target's width: how far the target may be off sideways
DOUBTS = np.array([0.05, 0.03, 0.01, 0.03])  # of across x and y, along x and y
UNSURE_BLUR = 6.0  # px
FREEDOM = 0.1  # of contrast at a node of the free curve
MOST_RUNS = 4000
DISCS, STEPS_ALONE = (0.0, 1.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0), 5  # px to start from
NEAR = 1.0  # fall of chi squared below which a fit of some of the frequencies has ended


def fit_of(frame: Frame, pixels: PixelSet) -> tuple[Runs, Model, Fit, Equations]:
    """The pixels that look at the target, gathered into runs, what is known of them, and their fit
    with its equations.

    Raises:
        MeasurementError: no light, or too few pixels.
    """
    runs = runs_of(frame, pixels, FIRST_RUN)
    model = _model_of(frame, runs)
    found, lenses = _search(runs, model), runs.lenses
    smear = abs(float(found.common[2])) * model.pixel * max(frame.target.cycles_per_mm)
    runs = runs_of(frame, pixels, int(np.clip(MOST_SMEAR / max(smear, 1e-9), 1, MOST_ROWS)))
    nearest = np.minimum(np.searchsorted(lenses, runs.lenses), len(lenses) - 1)
    fit, equations = fitted(runs, model, Fit(found.common, found.own[nearest]), CLOSE)
    for _ in range(REPAIRS):
        astray = views_of(runs, model, fit, equations, frequencies_of(runs, model)).astray
        if not astray.any():
            break
        own = fit.own.copy()
        own[astray] = _each_alone(runs.part(astray[runs.view]), model, Fit(fit.common, own[astray]))
        fit, equations = fitted(runs, model, Fit(fit.common, own), CLOSE)
    if frame.gains is not None:
        runs = _with_fitted_gains(runs, model, fit)
    model = replace(model, spread=_scatter(model, fit, equations))
    return runs, model, *fitted(runs, model, fit, CLOSE)


def _scatter(model: Model, fit: Fit, found: Equations) -> Array:
    """How widely those views scatter whose pixels say more than was known before, shape (7,)."""
    doubt = np.einsum("vii->vi", inverse_of(found.own))
    known = np.maximum(1 - doubt / model.spread**2, 1e-6)
    scatter = np.average(fit.own**2 + doubt, axis=0, weights=known)
    scatter *= (len(fit.own) + 1) / max(len(fit.own) - 1, 1)  # few views say less of it
    spread = np.minimum(np.sqrt(scatter), model.spread)
    spread[LIGHT] = model.spread[LIGHT]  # light has no mean that all views come near
    return spread


def _with_fitted_gains(runs: Runs, model: Model, fit: Fit) -> Runs:
    """The runs with the gains of their sub-lattices that suit the fit best: bars may lie on one
    filter's columns more than on another's.
    """
    seen = look_at(runs, model, fit)
    weight = seen.due * weights(runs, seen)[1]
    read, due = (
        np.bincount(runs.sublattice, weight * part, minlength=4) for part in (runs.read, seen.due)
    )
    ratio = (read / np.maximum(due, 1e-300))[runs.sublattice]
    return replace(runs, read=runs.read / ratio, dark=runs.dark / ratio**2, shot=runs.shot / ratio)


def _model_of(frame: Frame, runs: Runs) -> Model:
    """What is known before the fit: the nominal geometry to a few per cent, contrast of order 1."""
    target, pixel, level = frame.target, frame.sensor.pixel, float(np.mean(runs.read))
    if not level > 0:
        raise MeasurementError(
            f"{target.kind} picture: no light in it above the dark level; expose it longer"
        )
    disc = float(blur(frame.smms, 1 / frame.distance)) / frame.scale
    across, along = np.abs(frame.start[[1, 3]])
    seen = across * pixel
    doubt = WIDEST_SHIFT * target.width, *(DOUBTS * [across, across, along, along])
    doubt = *doubt, max(disc, seen) * UNSURE_BLUR * seen, 1.0, *np.full(NODES, FREEDOM)
    return Model(
        target,
        pixel,
        float(np.abs(runs.places[:, 1]).max(initial=1e-9)),
        level,
        np.array([*frame.start, disc**2, 1.0, *np.zeros(NODES)]),
        np.array(doubt),
        LOOSE * np.array([1, 1, 1, 1, seen, across, seen**2]),
    )


def _search(runs: Runs, model: Model) -> Fit:
    """From the low frequencies, where no cycle can be mistaken for its neighbour, up to the
    highest.
    """
    # at most so many runs, drawn so that no phase of the bars is preferred
    drawn = np.random.default_rng(0).random(len(runs.read)) < MOST_RUNS / len(runs.read)
    some, target = runs.part(drawn), model.target
    frequency = target.frequency(some.places @ model.mean[GEOMETRY])
    low, high = float(frequency.min()), float(frequency.max())
    enough = np.sort(frequency)[min(FEWEST_RUNS, len(frequency)) - 1]
    ceiling = min(high, max(low + 0.12 * (high - low), 1.5 * low, float(enough)))
    common, own = model.mean.copy(), np.zeros((len(runs.lenses), OWN))
    common[0] += _place(some.part(frequency <= ceiling), model, ceiling)
    while True:
        part = some.part(target.frequency(some.places @ common[GEOMETRY]) <= ceiling)
        those = np.searchsorted(runs.lenses, part.lenses)
        fit, _ = fitted(part, model, Fit(common, own[those]), NEAR)
        common, own[those] = fit.common, fit.own
        if ceiling >= high:
            return Fit(common, own)
        ceiling = min(2 * ceiling, high)


def _each_alone(runs: Runs, model: Model, fit: Fit) -> Array:
    """The best own numbers of each view that a few steps from one of several discs lead to,
    beside common parameters that are held.
    """
    own, least = fit.own, np.full(len(fit.own), np.inf)
    for disc in DISCS:
        trial = Fit(fit.common, np.zeros_like(own))
        trial.own[:, BLUR] = (disc * model.pixel_seen(fit)) ** 2 - fit.common[DISC]
        for _ in range(STEPS_ALONE):
            seen = look_at(runs, model, trial)
            weight = weights(runs, seen)[1]
            left = misfit_of(runs, seen, weight)
            own = np.where((left < least)[:, None], trial.own, own)
            least = np.minimum(left, least)
            here = equations(runs, model, trial, seen, weight)
            step = np.einsum("vij,vj->vi", inverse_of(here.own), here.own_right)
            trial = trial.moved(np.zeros(COMMON), step)
    return own


def _place(runs: Runs, model: Model, highest: float) -> float:
    """The shift by which the runs are most like the bars, mm."""
    reach = WIDEST_SHIFT * model.target.width
    trials = np.arange(-1, 1.001, 1 / max(1, math.ceil(reach * highest / 0.12))) * reach
    x, pixel = runs.places @ model.mean[GEOMETRY], abs(model.mean[1]) * model.pixel
    squares = np.full(len(x), model.mean[DISC])
    waves = np.array([seen_through(model.target, x + trial, pixel, squares)[0] for trial in trials])
    waves -= waves.mean(axis=1, keepdims=True)
    # contrast never rises far above 1, nor do bars turn black for white at low frequency
    likeness = waves @ runs.read / np.sqrt(np.sum(waves**2, axis=1) + 1e-300)
    return float(trials[likeness.argmax()])

"""Finding a chirp in a picture: its place by the lowest frequencies, then all of it."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.fit import each_alone, fitted
from flflab.measurement.contrast.model import CURVE, NUMBERS, Fit, Model, look_at
from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.wave import pattern_of
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

KNOTS = 16
FEWEST_RUNS = 200  # to begin with: fewer than several views' follow noise
WIDEST_SHIFT = 0.06  # of the target's width: how far the target may be off sideways
DOUBTS = np.array([0.05, 0.03, 0.01, 0.03])  # of across x and y, along x and y
UNSURE_BLUR = 6.0  # px
MOST_RUNS = 4000
NEAR = 1.0  # fall of chi squared below which a fit of some of the frequencies has ended
UNLIKE_TEMPLATE = 0.03  # of the transfer, while it is not known where the bars are


def model_of(runs: Runs, target: Bars, pixel: float, start: Array, blur: float) -> Model:
    """What is known before the fit: the nominal geometry to a few per cent, contrast of order 1.

    Args:
        runs: of pixels.
        target: what stood there.
        pixel: of the sensor, mm.
        start: shift, across x and y, along x and y, nominal, shape (5,).
        blur: diameter of the disc on the target, nominal, mm.

    Raises:
        MeasurementError: there is no light in the picture.
    """
    frequency = target.frequency(runs.places @ start)
    low, high = float(frequency.min()), float(frequency.max())
    step = max((high - low) / (KNOTS - 1), 1e-3 * high)
    level = float(np.mean(runs.read))
    if not level > 0:
        raise MeasurementError(
            f"{target.kind} picture: no light in it above the dark level; expose it longer"
        )
    knots = low + step * np.arange(-3, KNOTS + 3)
    across, along = abs(float(start[1])), abs(float(start[3]))
    # a sine has no harmonics by which its blur could be known
    unsure = UNSURE_BLUR if target.kind == "bars" else 0.1
    square = blur**2
    doubt = [
        WIDEST_SHIFT * target.width,
        *(DOUBTS * [across, across, along, along]),
        (max(blur, across * pixel) * unsure * across * pixel),
        *np.ones(1 + KNOTS + 2),
    ]
    return Model(
        pattern_of(target),
        np.asarray(knots, dtype=np.float64),
        pixel,
        float(np.abs(runs.places[:, 1]).max(initial=1e-9)),
        level,
        np.array([*start, square, 1.0, *np.zeros(KNOTS + 2)]),
        np.array(doubt),
        np.zeros(NUMBERS),
    )


def scattered(runs: Runs, most: int) -> Runs:
    """At most so many runs, scattered so that no phase of the bars is preferred."""
    count = len(runs.read)
    if count <= most:
        return runs
    order = np.arange(count, dtype=np.uint64) * np.uint64(2654435761) % np.uint64(2**32)
    return runs.part(order < np.uint64(2**32 * most // count))


def search(runs: Runs, model: Model, target: Bars) -> Fit:
    """From the low frequencies, where no cycle can be mistaken for its neighbour, up to the
    highest.

    Raises:
        MeasurementError: no bars are there.
    """
    start = model.mean[:5]
    frequency = target.frequency(runs.places @ start)
    low, high = float(frequency.min()), float(frequency.max())
    enough = np.sort(frequency)[min(FEWEST_RUNS, len(frequency)) - 1]
    ceiling = min(high, max(low + 0.12 * (high - low), 1.5 * low, float(enough)))
    common, own = model.mean.copy(), np.zeros((len(runs.lenses), NUMBERS))
    common[0] = _place(runs.part(frequency <= ceiling), model, target, ceiling)
    doubt = model.doubt.copy()
    doubt[CURVE + 1 :] = UNLIKE_TEMPLATE
    model = replace(model, doubt=doubt)
    while True:
        part = runs.part(target.frequency(runs.places @ common[:5]) <= ceiling)
        those = np.searchsorted(runs.lenses, part.lenses)
        fit = each_alone(part, model, Fit(common, own[those]))
        fit, _, _ = fitted(part, model, fit, 2, NEAR)
        common, own[those] = fit.common, fit.own
        if ceiling >= high:
            return Fit(common, own)
        ceiling = min(2 * ceiling, high)


def _place(runs: Runs, model: Model, target: Bars, highest: float) -> float:
    """The shift by which the runs are most like the bars."""
    reach = WIDEST_SHIFT * target.width
    best, shift = 0.0, math.nan
    even = np.zeros((len(runs.lenses), NUMBERS))
    for trial in np.arange(-1, 1.001, 1 / max(1, math.ceil(reach * highest / 0.12))) * reach:
        common = model.mean.copy()
        common[0] += trial
        # contrast never rises far above 1, nor do bars turn black for white at low frequency
        wave = look_at(runs, model, Fit(common, even)).wave
        wave = wave - wave.mean()
        likeness = float(runs.read @ wave) / math.sqrt(float(wave @ wave) + 1e-300)
        if likeness > best:
            best, shift = likeness, float(trial)
    if math.isnan(shift):
        raise MeasurementError(
            f"{target.kind} picture: no bars of the target's law were found; check target and"
            " distance"
        )
    return float(model.mean[0]) + shift

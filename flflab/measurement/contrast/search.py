"""Finding a chirp in a picture: its place by the lowest frequencies, then all of it, then the blur
that it shows.
"""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.data import ChirpData, Field
from flflab.measurement.contrast.fit import (
    BLUR_STEP,
    CURVE,
    LIGHT,
    ChirpFit,
    ChirpModel,
    Knots,
    Prior,
    expected,
    followed,
    gauss_newton_step,
    least_misfit,
    noise_covariance,
    through_others,
    waves,
)
from flflab.measurement.contrast.template import Template, edges_of
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import defocus_apart, defocus_by_tilt, tilted_scales
from flflab.measurement.lowest import lowest
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.contrast import disc_transfer
from flflab.optics.focus import blur, signed_blur
from flflab.optics.smms import Smms
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

KNOTS = 16
FEWEST_RUNS = (
    200  # to begin with: fewer than several views' follow noise, and lead the light astray
)
WIDEST_SHIFT = 0.06  # of the target's width: how far the target may be off sideways
WIDEST_BLUR = 6.0  # pixels
DISCS = 100  # of blur, up to the widest: how closely it is looked for in the transfer
SAME_BLUR = 5e-4  # pixels: views that differ by less are blurred alike
MOST_SHARPENINGS = 12
MOST_STEPS = 20  # of Gauss-Newton
SETTLED = 1e-4  # cycles that a step may still move a pixel's place


@dataclass(frozen=True)
class Frame:
    """A picture and what is known before it is measured.

    Attributes:
        values: DN, [row, col].
        lattice: of the micro-images.
        field: which pixels count.
        camera: nominal.
        smms: the kind of microlens that is measured.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.
        gains: of a colour filter's four sub-lattices, None without filters.
        start: shift mm, across x and y, along x and y, nominal, shape (5,).
        wavelength: of the light, mm; None where diffraction is too little to count.
    """

    values: npt.NDArray[np.generic]
    lattice: Lattice
    field: Field
    camera: Camera
    smms: Smms
    target: Bars
    distance: float
    noise: SensorNoise
    gains: Array | None
    start: Array
    wavelength: float | None


def model_of(frame: Frame, data: ChirpData) -> ChirpModel:
    """The target as seen nominally, with knots over the frequencies that the pixels look at."""
    target, start, pixel = frame.target, frame.start, frame.camera.sensor.pixel
    frequency = target.frequency(data.places @ start)
    low, high = float(frequency.min()), float(frequency.max())
    step = max((high - low) / (KNOTS - 1), 1e-3 * high)
    bars = target.kind == "bars"
    top = 3 * high if bars else high
    template = Template(
        abs(float(start[1])) * pixel,
        abs(float(start[1])) * float(blur(frame.smms, 1 / frame.distance)),
    )
    left, right = target.cycles_per_mm
    return ChirpModel(
        law=(left, (right - left) / target.width, -target.width / 2),
        span=(low, high),
        top=top,
        edges=edges_of(target) if bars else np.zeros(0),
        template=template,
        knots=Knots(low, step, math.ceil((top - low) / step) + 3),
    )


def scattered(data: ChirpData, most: int) -> ChirpData:
    """At most so many runs, scattered so that no phase of the bars is preferred."""
    count = len(data.read)
    if count <= most:
        return data
    scattered = np.arange(count, dtype=np.uint64) * np.uint64(2654435761) % np.uint64(2**32)
    return data.part(scattered < np.uint64(2**32 * most // count))


def search(frame: Frame, data: ChirpData, model: ChirpModel) -> ChirpFit:
    """From the low frequencies, where no cycle can be mistaken for its neighbour, up to the
    highest.
    """
    target, start = frame.target, frame.start
    low, high = model.span
    frequency = target.frequency(data.places @ start)
    enough = (
        float(np.partition(frequency, FEWEST_RUNS - 1)[FEWEST_RUNS - 1])
        if len(frequency) > FEWEST_RUNS
        else high
    )
    low = min(high, max(low + 0.12 * (high - low), 1.5 * low, enough))
    part = data.part(frequency <= low)
    size = 1 + model.knots.count
    mean = float(np.mean(data.read))
    if not mean > 0:
        raise MeasurementError(
            f"{target.kind} picture: no light in it above the dark level; expose it longer"
        )
    unit, prior = np.zeros(size), prior_of(frame, data, model.knots)
    unit[0] = 1.0
    if target.kind == "chirp":
        unit[:] = 1.0  # the splines add up to 1
    reach = WIDEST_SHIFT * target.width
    best, shift = 0.0, math.nan
    for trial in np.arange(-1, 1.001, 1 / max(1, math.ceil(reach * low / 0.12))) * reach:
        # contrast never rises far above 1, nor do bars turn black for white at low frequency
        wave = waves(part, model, start + np.array([trial, 0, 0, 0, 0]), unit, low)
        wave = wave - wave.mean()
        likeness = float(part.read @ wave) / math.sqrt(float(wave @ wave) + 1e-300)
        if likeness > best:
            best, shift = likeness, float(trial)
    if math.isnan(shift):
        raise MeasurementError(
            f"{target.kind} picture: no bars of the target's law were found; check target and"
            " distance"
        )
    brightness = np.zeros(LIGHT)
    brightness[0] = mean
    fit = ChirpFit(start + np.array([shift, 0, 0, 0, 0]), brightness, np.zeros(size))
    ceiling = low
    while True:
        part = weighed = data.part(target.frequency(data.seen_at(fit.geometry)) <= ceiling)
        for step in range(4):
            fit = gauss_newton_step(weighed, model, fit, ceiling, prior, step > 0)
            weighed = _as_unsure_as_fitted(part, model, fit)
        if ceiling >= high:
            return fit
        ceiling = min(1.6 * ceiling, high)


def _as_unsure_as_fitted(data: ChirpData, model: ChirpModel, fit: ChirpFit) -> ChirpData:
    """The runs with as much noise as the fit leaves: harmonics beyond the ceiling, taken for light,
    outweighed what geometry can be.
    """
    told = expected(data, model, fit)
    excess = max(
        1.0,
        float(np.mean((data.read - told) ** 2 / (data.dark + data.shot * np.maximum(told, 0.0)))),
    )
    return replace(data, dark=data.dark * excess, shot=data.shot * excess)


def settle(frame: Frame, data: ChirpData, fit: ChirpFit, model: ChirpModel) -> ChirpFit:
    """All harmonics, until no pixel's place on the target moves any more."""
    prior = prior_of(frame, data, model.knots)
    for step in range(MOST_STEPS):
        before, fit = fit, gauss_newton_step(data, model, fit, model.top, prior, True)
        moved = float(np.abs(data.places @ (fit.geometry - before.geometry)).max()) * model.span[1]
        if step > 0 and moved < SETTLED:  # light and curve follow the first step's geometry
            break
    return fit


def with_fitted_gains(data: ChirpData, fit: ChirpFit, model: ChirpModel) -> ChirpData:
    """The runs with the gains of their sub-lattices that suit the fit best: bars may lie on one
    filter's columns more than on another's.
    """
    told = expected(data, model, fit)
    weight = 1 / (data.dark + data.shot * np.maximum(told, 0.0))
    seen, due = (
        np.bincount(data.sublattice, weights=weight * told * part, minlength=4)
        for part in (data.read, told)
    )
    ratio = (seen / np.maximum(due, 1e-300))[data.sublattice]
    return replace(data, read=data.read / ratio, dark=data.dark / ratio**2, shot=data.shot / ratio)


def with_fitted_blur(
    frame: Frame, data: ChirpData, fit: ChirpFit, model: ChirpModel
) -> tuple[ChirpModel, ChirpFit]:
    """The model whose disc of blur leaves the least misfit, and its fit.

    The measured transfer, each frequency as far as it is known, up to one factor, says the disc to
    a tenth of a pixel. The harmonics, seen through the template alone, then show it to a
    thousandth: left to the first guess, the misfit was up to four times the noise's.
    """
    pixel = (
        abs(float(fit.geometry[1])) * frame.camera.sensor.pixel
    )  # the stages' errors change the magnification too
    template, prior = replace(model.template, pixel=pixel), prior_of(frame, data, model.knots)
    model = replace(model, template=template)
    nu = np.linspace(*model.span, 2 * KNOTS)
    design = model.knots.design(nu, template)
    covariance, _ = noise_covariance(data, model, fit, prior)
    whiten = np.linalg.inv(
        np.linalg.cholesky(design @ covariance[CURVE:, CURVE:] @ design.T + 1e-8 * np.eye(len(nu)))
    )
    measured = whiten @ design @ fit.curve
    discs = np.linspace(0.0, max(WIDEST_BLUR * template.pixel, 2 * template.blur), DISCS)
    shapes = np.sinc(nu * template.pixel) * disc_transfer(discs[:, None], nu) @ whiten.T
    likeness = (shapes @ measured) ** 2 / np.sum(shapes**2, axis=1)
    guess, away = float(discs[int(np.argmax(likeness))]), BLUR_STEP * template.pixel

    def misfit(square: float) -> float:
        return least_misfit(data, model.with_blur(math.sqrt(square)), fit, prior)

    squares = [(max(guess, away) + step * away) ** 2 for step in (-1, 0, 1)]
    best = model.with_blur(math.sqrt(lowest(misfit, squares, 0.0)))
    return best, settle(frame, data, fit, best)


def as_sharp_as_the_axis(
    frame: Frame, data: ChirpData, fit: ChirpFit, model: ChirpModel, before: ChirpFit
) -> tuple[ChirpData, ChirpModel, ChirpFit, Array]:
    """The runs as they would read if every view were blurred as on the axis, what fits them, and
    what the tilt's uncertainty makes of it.

    Behind a tilted array the views' discs of blur are wider on one side and narrower on the other,
    by as much as the tilt says that the lattice shows. Which side is the wider tells on which side
    of the focus the sensor stands: the axis's disc is fitted with a sign.

    Args:
        frame: what is known.
        data: the runs.
        fit: of one disc for all views.
        model: with that disc.
        before: the fit before that disc was looked for.

    Returns:
        The runs, the model, the fit, and how its parameters move with one standard uncertainty of
        each slope, shape (2, parameters).
    """
    scale = model.template.pixel / frame.camera.sensor.pixel
    wider = defocus_apart(frame.lattice, frame.smms, frame.distance)[data.lens] * scale
    if float(np.abs(wider).max()) > SAME_BLUR * model.template.pixel:
        data, model, fit = _with_signed_blur(frame, data, (before, fit), model, wider)
    prior, template = prior_of(frame, data, model.knots), model.template
    pixels = np.full(len(wider), template.pixel)
    moves = [
        followed(
            data,
            model,
            fit,
            prior,
            through_others(
                data, model, fit, pixels, np.abs(template.blur + scale * apart[data.lens])
            ),
        )
        for apart in defocus_by_tilt(frame.lattice, frame.smms, frame.distance)
    ]
    return data, model, fit, np.array(moves)


def _with_signed_blur(
    frame: Frame, data: ChirpData, fits: tuple[ChirpFit, ...], model: ChirpModel, wider: Array
) -> tuple[ChirpData, ChirpModel, ChirpFit]:
    """The runs as through the axis's pixel and disc of blur, that disc which leaves the least
    misfit, and their fit.

    A view's pixels are as much larger on the target as they lie further apart there; its disc is
    wider by ``wider``, mm. The disc fitted to all views alike, on either side of the focus, may be
    astray where they differ much, and the bars' place with it: it is looked for from the nominal
    one too, and from each of the fits.
    """
    prior, away, near = (
        prior_of(frame, data, model.knots),
        BLUR_STEP * model.template.pixel,
        model.template.blur,
    )
    larger = tilted_scales(frame.lattice, frame.smms, frame.distance)[data.lens]
    pixels = model.template.pixel * larger

    def alike(disc: float, fit: ChirpFit) -> tuple[ChirpData, ChirpModel]:
        seen = model.with_blur(abs(disc))
        return (
            replace(
                data,
                read=data.read
                - through_others(data, seen, fit, pixels, np.abs(disc + wider) * larger),
            ),
            seen,
        )

    def settled(disc: float, fit: ChirpFit) -> ChirpFit:
        runs, seen = alike(disc, fit)
        return settle(frame, runs, fit, seen)

    def misfit(disc: float, fit: ChirpFit) -> float:
        return least_misfit(*alike(disc, fit), fit, prior)

    nominal = (
        float(signed_blur(frame.smms, 1 / frame.distance))
        * model.template.pixel
        / frame.camera.sensor.pixel
    )
    tried = [(disc, settled(disc, one)) for one in fits for disc in (nominal, near, -near)]
    best, fit = min(tried, key=lambda one: misfit(*one))
    for _ in range(MOST_SHARPENINGS):
        before, best = (
            best,
            lowest(partial(misfit, fit=fit), [best - away, best, best + away], -math.inf),
        )
        fit = settled(best, fit)
        if abs(best - before) < SAME_BLUR * model.template.pixel:
            break
    return *alike(best, fit), fit


def prior_of(frame: Frame, data: ChirpData, knots: Knots) -> Prior:
    """The nominal geometry to a few per cent, light even to a tenth, contrast of order 1: nothing
    the pixels see is bound by it.
    """
    target, start, light = frame.target, frame.start, float(np.mean(data.read))
    geometry = [
        WIDEST_SHIFT * target.width,
        0.05 * abs(start[1]),
        0.03 * abs(start[1]),
        0.01 * abs(start[3]),
        0.03 * abs(start[3]),
    ]
    sharp = (
        1.0 if target.kind == "bars" else 1e-9
    )  # a sine has no harmonics for the template to carry
    spread = np.concatenate(
        [geometry, [math.inf], np.full(LIGHT - 1, 0.1 * light), [sharp], np.full(knots.count, 1.0)]
    )
    return Prior(np.concatenate([start, [light], np.zeros(len(spread) - len(start) - 1)]), spread)

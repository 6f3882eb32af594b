"""Contrast against frequency from a picture of bars or of a sine chirp, by a fit of the known chirp; max and min as a baseline."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from flflab.analysis.contrast_fit import CURVE, GEOMETRY, LIGHT, ChirpData, ChirpFit, Knots, Prior, Template, gauss_newton_step
from flflab.analysis.contrast_readings import fitted_extremes, read_extremes
from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.registration import (
    PixelSet,
    bright_pixels,
    require_picture,
    same_type_as_central,
    sensor_position,
    target_scales,
)
from flflab.errors import MeasurementError
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.targets import Bars, Chirp

Array = npt.NDArray[np.float64]

KNOTS = 16
FEWEST_PIXELS = 300
MOST_PIXELS = 200_000
MOST_PIXELS_WHILE_SEARCHING = 20_000
WIDEST_SHIFT = 0.06  # of the target's width: how far the target may be off sideways
WORST_UNCERTAINTY = 0.25
WORST_CHI2 = 50.0
REFINEMENTS = 2
WIDEST_BLUR = 6.0  # pixels
BLUR_SEARCH = 0.2  # pixels
FIT_ERROR = 3e-4  # of contrast, added to its uncertainty: what the fit's approximations leave in exact pictures in focus
FIT_ERROR_BLUR = 0.5  # and how much more for each px of blur


@dataclass(frozen=True)
class ContrastCurve:
    """Contrast of the image over that of the target at K frequencies.

    Attributes:
        cycles_per_mm: frequencies on the target, shape (K,).
        cycles_per_px: the same on the sensor by the camera's nominal magnification, shape (K,).
        contrast: modulation of the image's fundamental over the target's, signed (negative: bars look reversed), shape (K,).
        covariance: of ``contrast``, from noise and registration together, shape (K, K).
        extremes: (max - min)/(max + min) of the fitted noise-free bars over all phases (eq. 2's quantity), shape (K,).
        extremes_uncertainty: standard uncertainties, shape (K,).
        classic: (max - min)/(max + min) read off the noisy pixels, a baseline with bias; nan where no view holds 4 pixels of it.
        classic_uncertainty: scatter of the views' readings over the root of their number, shape (K,).
        geometry: shift mm, across x and y, along x and y (see ``flflab.analysis.registration``), shape (5,).
        geometry_uncertainty: standard uncertainties, shape (5,).
        chi2_per_pixel: about 1 where the model holds; the covariance is already scaled up by it where above 1.
        pixels: number of pixels used.
    """

    cycles_per_mm: Array
    cycles_per_px: Array
    contrast: Array
    covariance: Array
    extremes: Array
    extremes_uncertainty: Array
    classic: Array
    classic_uncertainty: Array
    geometry: Array
    geometry_uncertainty: Array
    chi2_per_pixel: float
    pixels: int

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainties of ``contrast``, shape (K,)."""
        return np.sqrt(np.diag(self.covariance))


def fit_contrast(
    picture: npt.NDArray[np.generic], lattice: Lattice, camera: Camera, target: Bars | Chirp, distance: float, noise: SensorNoise
) -> ContrastCurve:
    """Measure contrast against frequency in every bright field that sees the target.

    The target's place is found within 6 % of its width, its magnification within a few per cent; both are fitted together with
    the curve. Saturated pixels are left out.

    Args:
        picture: DN, [row, col], in the camera's resolution.
        lattice: measured from a white picture of the same configuration.
        camera: nominal.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: wrong shape, target at infinity, too few pixels in bright fields on the target, or no bars in them.
    """
    values = require_picture(picture, camera, target.kind)
    across, along = target_scales(camera, distance)
    start = np.array([0.0, across, 0.0, along, 0.0])
    pixels = _thinned(_pixels_on_target(values, lattice, camera, target, distance, noise, start))
    data = _data(values, lattice, camera, pixels, noise)
    frequency = target.frequency(data.places @ start)
    span = (float(frequency.min()), float(frequency.max()))
    step = max((span[1] - span[0]) / (KNOTS - 1), 1e-3 * span[1])
    top = 3 * span[1] if target.kind == "bars" else span[1]
    knots = Knots(span[0], step, math.ceil((top - span[0]) / step) + 3)
    template = Template(abs(across) * camera.sensor.pixel, abs(across) * float(blur(central_smms(camera), 1 / distance)))
    few = _part(data, np.ones(len(data.read), dtype=np.bool_), MOST_PIXELS_WHILE_SEARCHING)
    fit = _settle(few, target, start, _fit(data, target, start, span, knots, template, noise), span, top, knots, template, noise)
    for _ in range(REFINEMENTS if target.kind == "bars" else 0):
        # The stages' errors blur differently from what is nominal, and the highest harmonics are seen through the template alone.
        other = _with_measured_blur(template, fit, knots, span)
        again = _settle(few, target, start, replace(fit, curve=np.zeros_like(fit.curve)), span, top, knots, other, noise)
        if again.chi2 >= fit.chi2:
            break
        template, fit = other, again
    if target.kind == "bars":
        # Dark pixels are so quiet that even a tenth of a pixel of wrong blur shows at the bars' corners: the pixels decide.
        def rest(disc: float) -> float:
            trial = replace(template, blur=disc)
            return _settle(few, target, start, replace(fit, curve=np.zeros_like(fit.curve)), span, top, knots, trial, noise).chi2

        near = (max(0.0, template.blur - BLUR_SEARCH * template.pixel), template.blur + BLUR_SEARCH * template.pixel)
        found: Any = minimize_scalar(rest, bounds=near, method="bounded", options={"xatol": 0.005 * template.pixel, "maxiter": 12})
        if found.fun < fit.chi2:
            template = replace(template, blur=float(found.x))
            fit = replace(fit, curve=np.zeros_like(fit.curve))
    fit = _settle(data, target, start, fit, span, top, knots, template, noise)
    return _curve(fit, data, pixels, camera, target, distance, knots, template, span)


def _pixels_on_target(
    values: Array, lattice: Lattice, camera: Camera, target: Bars, distance: float, noise: SensorNoise, start: Array
) -> PixelSet:
    """Unsaturated pixels of bright fields that look at the target well within its edges."""
    smms = central_smms(camera)
    chosen = same_type_as_central(lattice, camera)
    # The profile is smooth: a margin of 1 px keeps the averaging of the rim's pixels out.
    pixels = bright_pixels(lattice, (values.shape[0], values.shape[1]), 1.0, chosen)
    scale = float(magnification(smms, 1 / distance))
    margin = (float(blur(smms, 1 / distance)) / 2 + 3 * camera.sensor.pixel) / scale + 0.01 * target.width
    centre = sensor_position(camera.sensor, lattice.centres_px)[pixels.lens]
    place = sensor_position(camera.sensor, np.stack([pixels.columns, pixels.rows], axis=1).astype(np.float64))
    seen = start[1] * (place - centre) + start[3] * centre
    keep = (np.abs(seen[:, 0]) < target.width / 2 - margin) & (np.abs(seen[:, 1]) < target.height / 2 - margin)
    keep &= ~noise.saturated(values[pixels.rows, pixels.columns])
    kept = pixels.kept(keep)
    if len(kept.rows) < FEWEST_PIXELS:
        raise MeasurementError(
            f"{target.kind} picture: only {len(kept.rows)} unsaturated pixels of bright fields look at the target, "
            f"{FEWEST_PIXELS} are due; check exposure, f-number and the target's distance"
        )
    return kept


def _thinned(pixels: PixelSet) -> PixelSet:
    """At most MOST_PIXELS of them, scattered so that no phase of the bars is preferred: more would cost time and tell little more."""
    count = len(pixels.rows)
    if count <= MOST_PIXELS:
        return pixels
    scattered = np.arange(count, dtype=np.uint64) * np.uint64(2654435761) % np.uint64(2**32)
    return pixels.kept(scattered < np.uint64(2**32 * MOST_PIXELS // count))


def _data(values: Array, lattice: Lattice, camera: Camera, pixels: PixelSet, noise: SensorNoise) -> ChirpData:
    place = sensor_position(camera.sensor, np.stack([pixels.columns, pixels.rows], axis=1).astype(np.float64))
    centre = sensor_position(camera.sensor, lattice.centres_px)[pixels.lens]
    inside = place - centre
    height, width = values.shape
    u = (pixels.columns - (width - 1) / 2) * 2 / max(width, height)
    v = (pixels.rows - (height - 1) / 2) * 2 / max(width, height)
    places = np.stack([np.ones(len(u)), inside[:, 0], inside[:, 1], centre[:, 0], centre[:, 1]], axis=1)
    light = np.stack([np.ones(len(u)), u, v, u * u, u * v, v * v], axis=1)
    return ChirpData(values[pixels.rows, pixels.columns] - noise.offset_dn, places, light)


def _part(data: ChirpData, which: npt.NDArray[np.bool_], most: int) -> ChirpData:
    index = np.flatnonzero(which)
    index = index[:: max(1, -(-len(index) // most))]
    return ChirpData(data.read[index], data.places[index], data.light[index])


def _fit(
    data: ChirpData,
    target: Bars,
    start: Array,
    span: tuple[float, float],
    knots: Knots,
    template: Template,
    noise: SensorNoise,
) -> ChirpFit:
    """From the low frequencies, where no cycle can be mistaken for its neighbour, up to the highest."""
    prior = _prior(start, float(np.mean(data.read)), target, knots, 0.5)

    def advance(part: ChirpData, fit: ChirpFit, ceiling: float, move: bool) -> ChirpFit:
        return _advance(part, target, fit, knots, template, ceiling, noise, move, prior)

    brightness = np.zeros(LIGHT)
    brightness[0] = float(np.mean(data.read))
    size = CURVE + 1 + knots.count
    fit = ChirpFit(start, brightness, np.zeros(1 + knots.count), np.zeros((size, size)), math.inf)
    low = min(span[1], max(span[0] + 0.12 * (span[1] - span[0]), 1.5 * span[0]))
    frequency = target.frequency(data.places @ start)
    part = _part(data, frequency <= low, MOST_PIXELS_WHILE_SEARCHING // 8)
    best = fit
    for shift in np.arange(-1, 1.001, 1 / max(1, math.ceil(WIDEST_SHIFT * target.width * low / 0.12))) * WIDEST_SHIFT * target.width:
        trial = replace(fit, geometry=start + np.array([shift, 0, 0, 0, 0]))
        trial = advance(part, advance(part, advance(part, trial, low, move=False), low, move=False), low, move=False)
        # contrast never rises far above 1, nor do bars turn black for white at low frequency
        if trial.chi2 < best.chi2 and float((knots.design(np.array([low]), template) @ trial.curve)[0]) > 0:
            best = trial
    if not math.isfinite(best.chi2):
        raise MeasurementError(f"{target.kind} picture: no bars of the target's law were found; check target and distance")
    fit, ceiling = best, low
    while True:
        part = _part(data, target.frequency(data.places @ fit.geometry) <= ceiling, MOST_PIXELS_WHILE_SEARCHING)
        fit = advance(part, fit, ceiling, move=False)
        for _ in range(4):
            fit = advance(part, fit, ceiling, move=True)
        if ceiling >= span[1]:
            break
        ceiling = min(1.6 * ceiling, span[1])
    return fit


def _settle(
    data: ChirpData,
    target: Bars,
    start: Array,
    fit: ChirpFit,
    span: tuple[float, float],
    top: float,
    knots: Knots,
    template: Template,
    noise: SensorNoise,
) -> ChirpFit:
    """All harmonics, until no pixel's place on the target moves any more."""
    prior = _prior(start, float(np.mean(data.read)), target, knots, 1.0)
    # A curve that starts at zero says nothing of the geometry yet.
    fit = _advance(data, target, fit, knots, template, top, noise, False, prior)
    for step in range(6):
        before = data.places @ fit.geometry
        fit = _advance(data, target, fit, knots, template, top, noise, True, prior)
        # The first step's chi2 is that of where it started.
        if step > 0 and float(np.abs(data.places @ fit.geometry - before).max()) * span[1] < 1e-4:
            break
    return fit


def _advance(
    data: ChirpData,
    target: Bars,
    fit: ChirpFit,
    knots: Knots,
    template: Template,
    ceiling: float,
    noise: SensorNoise,
    move: bool,
    prior: Prior,
) -> ChirpFit:
    x = data.places @ fit.geometry
    bars = target.kind == "bars"
    variance = (noise.dark_variance, noise.dn_per_electron)
    reach = ceiling if bars else math.inf
    return gauss_newton_step(data, target.phase(x), target.frequency(x), fit, knots, template, reach, bars, variance, prior, move)


def _with_measured_blur(template: Template, fit: ChirpFit, knots: Knots, span: tuple[float, float]) -> Template:
    """The template whose disc of blur comes nearest to the measured transfer, up to one factor, each frequency as far as it is known."""
    nu = np.linspace(span[0], span[1], 2 * KNOTS)
    design = knots.design(nu, template)
    spread = design @ fit.covariance[CURVE:, CURVE:] @ design.T + _fit_error(template) ** 2 * np.eye(len(nu))
    whiten = np.linalg.inv(np.linalg.cholesky(spread))
    measured = whiten @ design @ fit.curve

    def misfit(disc: float) -> float:
        shape = whiten @ replace(template, blur=disc).transfer(nu)
        return float(np.sum((measured - shape * (shape @ measured) / (shape @ shape)) ** 2))

    widest = max(WIDEST_BLUR * template.pixel, 2 * template.blur)
    steps = np.linspace(0.0, widest, 25)
    best = steps[int(np.argmin([misfit(disc) for disc in steps]))]
    found: Any = minimize_scalar(misfit, bounds=(max(0.0, best - steps[1]), best + steps[1]), method="bounded")
    return replace(template, blur=float(found.x))


def _fit_error(template: Template) -> float:
    return FIT_ERROR * (1 + FIT_ERROR_BLUR * template.blur / template.pixel)


def _prior(start: Array, light: float, target: Bars, knots: Knots, loose: float) -> Prior:
    """The nominal geometry to a few per cent, light even to a tenth, contrast of order 1: nothing the pixels see is bound by it."""
    geometry = [WIDEST_SHIFT * target.width, 0.05 * abs(start[1]), 0.03 * abs(start[1]), 0.01 * abs(start[3]), 0.03 * abs(start[3])]
    sharp = loose if target.kind == "bars" else 1e-9  # a sine has no harmonics for the template to carry
    spread = np.concatenate([geometry, [math.inf], np.full(LIGHT - 1, 0.1 * light), [sharp], np.full(knots.count, loose)])
    return Prior(np.concatenate([start, [light], np.zeros(len(spread) - len(start) - 1)]), spread)


def _curve(
    fit: ChirpFit,
    data: ChirpData,
    pixels: PixelSet,
    camera: Camera,
    target: Bars,
    distance: float,
    knots: Knots,
    template: Template,
    span: tuple[float, float],
) -> ContrastCurve:
    x = data.places @ fit.geometry
    frequency = target.frequency(x)
    chi2 = fit.chi2 / max(1, len(x) - len(fit.covariance))
    covariance = fit.covariance * max(1.0, chi2)
    spline = slice(CURVE, None)
    # The target's own grid, not the picture's, so that two pictures of one target can be compared frequency by frequency.
    nu = np.linspace(*target.cycles_per_mm, KNOTS + 2)[1:-1]
    nu = nu[(nu >= span[0]) & (nu <= span[1])]
    design = knots.design(nu, template)
    spread = design @ covariance[spline, spline] @ design.T + _fit_error(template) ** 2 * np.eye(len(nu))
    near = np.array([np.count_nonzero(np.abs(frequency - one) <= knots.step / 2) for one in nu])
    if chi2 > WORST_CHI2:
        raise MeasurementError(
            f"{target.kind} picture: the fit leaves {chi2:.0f} times the noise's variance; check exposure, target and distance"
        )
    keep = (near >= FEWEST_PIXELS / KNOTS) & (np.sqrt(np.diag(spread)) < WORST_UNCERTAINTY)
    if not keep.any() or not np.isfinite(fit.geometry).all():
        raise MeasurementError(f"{target.kind} picture: the fit of the bars did not settle; check exposure, focus, target and distance")
    nu = nu[keep]
    extremes, extremes_spread = fitted_extremes(fit.curve, covariance[spline, spline], knots, nu, template, target.kind == "bars")
    classic, classic_spread = read_extremes(data, pixels.lens, frequency, nu, knots.step)
    scale = float(magnification(central_smms(camera), 1 / distance))
    return ContrastCurve(
        cycles_per_mm=nu,
        cycles_per_px=nu * camera.sensor.pixel / scale,
        contrast=design[keep] @ fit.curve,
        covariance=spread[np.ix_(keep, keep)],
        extremes=extremes,
        extremes_uncertainty=extremes_spread,
        classic=classic,
        classic_uncertainty=classic_spread,
        geometry=fit.geometry,
        geometry_uncertainty=np.sqrt(np.diag(covariance)[:GEOMETRY]),
        chi2_per_pixel=chi2,
        pixels=len(x),
    )

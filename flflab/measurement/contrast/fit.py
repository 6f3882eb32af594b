"""Least squares fit of a chirp seen through many micro-images: geometry, brightness and transfer
curve together.

A pixel that looks at the target's x reads offset + light (1 + g bars(x) + sum over odd h of w_h D(h
nu) sin(2 pi h phase(x))), with bars(x) the target seen through a template of pixel and disc, w_h =
4/(pi h), or w_1 = 1 alone for a sine, which needs no template. Evaluated at the true places of the
pixels, so frequencies beyond half a cycle a pixel need no special case. The transfer is C(nu) = g
T(nu) + D(nu): T the template's, D a free cubic B-spline up to three times the highest frequency,
which takes up whatever differs from the template; beyond it the template alone carries the
harmonics. As the frequency changes by r a mm across the blur itself, each sine comes with -h r
D''(h nu)/(4 pi) of its cosine, the next term of the same integral. light is a polynomial of second
degree over the picture, x linear in the pixel's place in its micro-image and in the micro-image's
centre.
"""

import math
from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.data import ChirpData
from flflab.measurement.contrast.template import Template, bars_at

Array = npt.NDArray[np.float64]

GEOMETRY = 5  # shift, across x and y, along x and y
LIGHT = 6
MOST_CYCLES_A_STEP = 0.1
BLUR_STEP = 0.1  # pixels: how well the transfer shows the disc of blur
MORE_BLUR = 0.05  # pixels, added in squares: how what blur does is found
# of the light; keeps the mean of many dark pixels, almost without noise, from outweighing all
# others
MODEL_ERROR = 1e-3
MOST_HARMONICS = 999  # that a fit looks at
BLOCK = 4096  # runs whose derivatives are held at a time
CURVE = GEOMETRY + LIGHT  # first of the curve's parameters: g, then the spline's coefficients


@dataclass(frozen=True)
class Knots:
    """Uniform cubic B-splines on the frequency: ``count`` coefficients, the first spline's middle
    at ``first`` - ``step``.
    """

    first: float
    step: float
    count: int

    def design(self, frequency: Array, template: Template) -> Array:
        """Share of g and of every spline in the transfer at every frequency, shape (frequencies, 1
        + count).
        """
        place = (np.asarray(frequency, dtype=np.float64) - self.first) / self.step
        t = np.abs(place[:, None] - (np.arange(self.count) - 1)[None, :])
        splines = np.where(
            t < 1, 2 / 3 - t**2 + t**3 / 2, np.where(t < 2, np.maximum(2 - t, 0) ** 3 / 6, 0.0)
        )
        return np.concatenate([template.transfer(frequency)[:, None], splines], axis=1)


@dataclass(frozen=True)
class ChirpModel:
    """What is known of the target and kept while fitting.

    Attributes:
        law: frequency at the target's left edge, cycles/mm; its growth, cycles/mm^2; that edge, mm.
        span: lowest and highest frequency that pixels look at, cycles/mm.
        top: harmonics above this frequency are left to the template, cycles/mm.
        edges: places of the bars' edges, mm; empty for a sine.
        template: what the harmonics above the ceiling are seen through.
        knots: of the transfer curve.
    """

    law: tuple[float, float, float]
    span: tuple[float, float]
    top: float
    edges: Array
    template: Template
    knots: Knots

    def frequency(self, x: Array) -> Array:
        """Cycles/mm at x mm."""
        return self.law[0] + self.law[1] * (x - self.law[2])

    def phase(self, x: Array) -> Array:
        """Cycles from the left edge to x mm."""
        return (x - self.law[2]) * (self.law[0] + self.law[1] * (x - self.law[2]) / 2)

    @property
    def drawn(self) -> tuple[tuple[float, float, float], Array, float, float]:
        """Law, edges, pixel and disc, as the kernels take them."""
        return self.law, self.edges, self.template.pixel, self.template.blur

    def with_blur(self, disc: float) -> "ChirpModel":
        """The same seen through a template whose disc is so wide, mm."""
        return replace(self, template=replace(self.template, blur=disc))

    @property
    def blurred(self) -> tuple["ChirpModel", float]:
        """The same with a little more blur, and how much more its square is, mm^2."""
        more = MORE_BLUR * self.template.pixel
        return self.with_blur(math.hypot(self.template.blur, more)), more**2


@dataclass(frozen=True)
class Prior:
    """What is known before the fit, parameter by parameter in the fit's order: mean and standard
    deviation (infinite: nothing).
    """

    mean: Array
    spread: Array


@dataclass(frozen=True)
class ChirpFit:
    """Parameters of the fit: geometry, light, curve (g and the spline's coefficients)."""

    geometry: Array
    brightness: Array
    curve: Array


@numba.njit(nogil=True, cache=True)
def _wave(
    x: float,
    law: tuple[float, float, float],
    edges: Array,
    pixel: float,
    disc: float,
    curve: Array,
    first: float,
    step: float,
    ceiling: float,
    shares: Array,
) -> tuple[float, float, int, int]:  # pragma: no cover - compiled
    """The wave, its slope by x and, in ``shares``, its derivatives by the curve's parameters; the
    first and last spline that count.
    """
    along = x - law[2]
    phase, frequency = along * (law[0] + law[1] * along / 2), law[0] + law[1] * along
    shares[:] = 0.0
    wave, slope = 0.0, 0.0
    low, high = len(shares), -1
    bars = len(edges) > 0
    if bars:
        shares[0], edge_slope = bars_at(x, phase, edges, pixel, disc)
        wave, slope = curve[0] * shares[0], curve[0] * edge_slope
    turn = 2.0 * np.pi * (phase - np.floor(phase))
    s, c, twice = np.sin(turn), np.cos(turn), 2.0 * np.cos(2.0 * turn)
    s_before, c_before = -s, c
    h = 1
    # off the target's end the law has no frequency, and no end of harmonics
    while h == 1 or (h < MOST_HARMONICS and 0.0 < h * frequency <= ceiling):
        weight = 4.0 / (np.pi * h) if bars else 1.0
        place = (h * frequency - first) / step
        cell = int(np.floor(place))
        t = place - cell
        r = 1.0 - t
        splines = (
            r**3 / 6.0,
            2.0 / 3.0 - t * t + t**3 / 2.0,
            2.0 / 3.0 - r * r + r**3 / 2.0,
            t**3 / 6.0,
        )
        bends = (r, 1.0 - 3.0 * r, 1.0 - 3.0 * t, t)
        swept = h * law[1] / (4.0 * np.pi * step * step)
        for m in range(4):
            k = 1 + cell + m
            if 1 <= k < len(shares):
                share = weight * (splines[m] * s - swept * bends[m] * c)
                shares[k] += share
                wave += curve[k] * share
                slope += curve[k] * splines[m] * weight * c * 2.0 * np.pi * h * frequency
                low, high = min(low, k), max(high, k)
        if not bars:
            break
        s, s_before = twice * s - s_before, s
        c, c_before = twice * c - c_before, c
        h += 2
    return wave, slope, low, high


@numba.njit(nogil=True, cache=True)
def _derivatives(
    places: Array,
    aside: Array,
    wider: Array,
    light: Array,
    law: tuple[float, float, float],
    edges: Array,
    pixel: float,
    disc: float,
    geometry: Array,
    brightness: Array,
    curve: Array,
    first: float,
    step: float,
    ceiling: float,
) -> tuple[Array, Array, Array]:  # pragma: no cover - compiled
    """What white would read at every run, the wave there, and the derivatives of what the run
    should read by all parameters.
    """
    base = GEOMETRY + LIGHT
    count = len(places)
    levels, wave, g = np.zeros(count), np.zeros(count), np.zeros((count, base + len(curve)))
    shares = np.zeros(len(curve))
    for n in range(count):
        level, x = 0.0, aside[n]
        for k in range(LIGHT):
            level += brightness[k] * light[n, k]
        for k in range(GEOMETRY):
            x += geometry[k] * places[n, k]
        own = np.sqrt(max(disc * disc + wider[n], 0.0))
        wave[n], slope, low, high = _wave(
            x, law, edges, pixel, own, curve, first, step, ceiling, shares
        )
        levels[n] = level
        for k in range(GEOMETRY):
            g[n, k] = level * slope * places[n, k]
        for k in range(LIGHT):
            g[n, GEOMETRY + k] = light[n, k] * (1.0 + wave[n])
        g[n, base] = level * shares[0]
        for k in range(low, high + 1):
            g[n, base + k] = level * shares[k]
    return levels, wave, g


@numba.njit(nogil=True, cache=True)
def _waves(
    places: Array,
    aside: Array,
    wider: Array,
    law: tuple[float, float, float],
    edges: Array,
    pixel: float,
    disc: float,
    geometry: Array,
    curve: Array,
    first: float,
    step: float,
    ceiling: float,
) -> Array:  # pragma: no cover - compiled
    wave, shares = np.zeros(len(places)), np.zeros(len(curve))
    for n in range(len(places)):
        x = aside[n]
        for k in range(GEOMETRY):
            x += geometry[k] * places[n, k]
        own = np.sqrt(max(disc * disc + wider[n], 0.0))
        wave[n], _, _, _ = _wave(x, law, edges, pixel, own, curve, first, step, ceiling, shares)
    return wave


def waves(
    data: ChirpData, model: ChirpModel, geometry: Array, curve: Array, ceiling: float
) -> Array:
    """The wave at every run of pixels, 0 on average."""
    seen, knots = (data.places, data.aside, data.wider), model.knots
    return _waves(*seen, *model.drawn, geometry, curve, knots.first, knots.step, ceiling)


def gauss_newton_step(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, ceiling: float, prior: Prior, move: bool
) -> ChirpFit:
    """One step of Gauss-Newton from ``fit``; no pixel's place moves by more than a tenth of a
    cycle.

    Args:
        data: the runs of pixels.
        model: of the target.
        fit: where to start.
        ceiling: harmonics above this frequency are left to the template, cycles/mm.
        prior: keeps directions that the pixels hardly see.
        move: False keeps the geometry and solves for light and curve only.
    """
    normal, right, _ = _tied(data, model, fit, ceiling, prior)
    step = np.zeros(len(normal))
    free = slice(0 if move else GEOMETRY, None)
    step[free] = inverse_of(normal[free, free]) @ right[free]
    frequency = np.abs(model.frequency(data.seen_at(fit.geometry)))
    furthest = float(np.abs(data.places @ step[:GEOMETRY] * frequency).max())
    step *= min(1.0, MOST_CYCLES_A_STEP / max(furthest, 1e-300))
    return ChirpFit(
        fit.geometry + step[:GEOMETRY],
        fit.brightness + step[GEOMETRY:CURVE],
        fit.curve + step[CURVE:],
    )


def least_misfit(data: ChirpData, model: ChirpModel, fit: ChirpFit, prior: Prior) -> float:
    """What misfit the fit of a model comes to from near its end: that of where it is less what the
    next step takes off.
    """
    normal, right, misfit = _tied(data, model, fit, model.top, prior)
    return misfit - float(right @ inverse_of(normal) @ right)


def _tied(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, ceiling: float, prior: Prior
) -> tuple[Array, Array, float]:
    """Normal matrix, right side and misfit, all with the prior."""
    normal, _, right, misfit, _ = _sums(data, model, fit, ceiling, False)
    tied = prior.spread**-2
    off = prior.mean - np.concatenate([fit.geometry, fit.brightness, fit.curve])
    return normal + np.diag(tied), right + off * tied, misfit + float(off**2 @ tied)


def noise_covariance(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, prior: Prior
) -> tuple[Array, float]:
    """What the noise makes of the parameters, order geometry, light, curve, and the fit's misfit
    over what noise alone would make it.

    The weights allow for a model error besides the noise, so the covariance is N^-1 M N^-1, M the
    scatter that noise alone gives to the right side (White, Econometrica 48 (1980) 817, with the
    variance known).
    """
    normal, scatter, _, misfit, due = _sums(data, model, fit, model.top, True)
    tied = np.diag(prior.spread**-2)
    inverse = inverse_of(normal + tied)
    return inverse @ (scatter + tied) @ inverse, misfit / max(
        due - float(np.trace(inverse @ scatter)), 0.1 * due
    )


@numba.njit(nogil=True, cache=True)
def _bars(
    x: Array, law: tuple[float, float, float], edges: Array, pixels: Array, discs: Array
) -> Array:  # pragma: no cover - compiled
    wave = np.zeros(len(x))
    for n in range(len(x)):
        along = x[n] - law[2]
        wave[n], _ = bars_at(
            x[n], along * (law[0] + law[1] * along / 2), edges, pixels[n], discs[n]
        )
    return wave


def through_others(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, pixels: Array, discs: Array
) -> Array:
    """What every run would read more through a pixel and a disc of its own, mm, than through the
    template's, DN, shape (n,).

    Of the template as strong as the whole transfer is: g alone may be more, with a free curve that
    takes it back.
    """
    template, x = model.template, data.seen_at(fit.geometry)
    own, shared = (
        np.sqrt(np.maximum(one**2 + data.wider, 0.0))
        for one in (discs, np.full(len(x), template.blur))
    )
    seen = _bars(x, model.law, model.edges, pixels, own)
    same = _bars(x, model.law, model.edges, np.full(len(x), template.pixel), shared)
    return strength_of(model, fit) * (data.light @ fit.brightness) * (seen - same)


def strength_of(model: ChirpModel, fit: ChirpFit) -> float:
    """The whole transfer over the template's, on average."""
    design = model.knots.design(np.linspace(*model.span, model.knots.count), model.template)
    alone = design[:, 0]
    return float(alone @ design @ fit.curve / (alone @ alone))


def expected(data: ChirpData, model: ChirpModel, fit: ChirpFit) -> Array:
    """What every run should read, DN above the offset, shape (n,)."""
    return (data.light @ fit.brightness) * (
        1 + waves(data, model, fit.geometry, fit.curve, model.top)
    )


def variance_and_weight(data: ChirpData, level: Array, due: Array) -> tuple[Array, Array]:
    """Variance of every run that should read so much (DN^2), and its weight in the fit; level is
    what white would read there, DN.
    """
    variance = data.dark + data.shot * np.maximum(due, 0.0)
    return variance, 1 / (variance + (MODEL_ERROR * level) ** 2)


def followed(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, prior: Prior, change: Array
) -> Array:
    """How the parameters follow where every run reads so much more, DN, shape (n,)."""
    normal, _, right, _, _ = _sums(
        replace(data, read=expected(data, model, fit) + change), model, fit, model.top, False
    )
    return inverse_of(normal + np.diag(prior.spread**-2)) @ right


def _sums(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, ceiling: float, with_scatter: bool
) -> tuple[Array, Array, Array, float, float]:
    """Normal matrix, the noise's scatter of the right side if wanted, right side, misfit and what
    of it the noise makes.
    """
    size = CURVE + len(fit.curve)
    normal, scatter, right, misfit, noisy = (
        np.zeros((size, size)),
        np.zeros((size, size)),
        np.zeros(size),
        0.0,
        0.0,
    )
    for start in range(0, len(data.read), BLOCK):
        part = data.part(slice(start, start + BLOCK))
        level, wave, g = derivatives(part, model, fit, ceiling)
        due = level * (1 + wave)
        variance, weight = variance_and_weight(part, level, due)
        root = np.sqrt(weight)
        rest, g = (part.read - due) * root, g * root[:, None]
        normal += g.T @ g
        right += rest @ g
        misfit += float(rest @ rest)
        noisy += float(weight @ variance)
        if with_scatter:
            g *= np.sqrt(weight * variance)[:, None]
            scatter += g.T @ g
    return normal, scatter, right, misfit, noisy


def derivatives(
    data: ChirpData, model: ChirpModel, fit: ChirpFit, ceiling: float
) -> tuple[Array, Array, Array]:
    """What white would read at every run, DN, the wave there, and the derivatives of what the run
    should read by all parameters, shape (n, parameters).
    """
    seen, knots = (data.places, data.aside, data.wider, data.light), model.knots
    fitted = fit.geometry, fit.brightness, fit.curve
    return _derivatives(*seen, *model.drawn, *fitted, knots.first, knots.step, ceiling)


def inverse_of(normal: Array) -> Array:
    """Of a normal matrix whose parameters have very different units."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    return np.linalg.inv(normal / np.outer(scale, scale) + 1e-12 * np.eye(len(normal))) / np.outer(
        scale, scale
    )

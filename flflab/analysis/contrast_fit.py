"""Least squares fit of a chirp seen through many micro-images: geometry, brightness and transfer curve together.

A pixel that looks at the target's x reads offset + light (1 + sum over odd h of w_h C(h nu) sin(2 pi h phase(x))), with
w_h = 4/(pi h) for square bars and w_1 = 1 for a sine. Evaluated at the true positions of the pixels, so frequencies beyond half a
cycle a pixel need no special case. The transfer is C(nu) = g T(nu) + D(nu): T that of a template (the pixel and the nominal
disc of blur), D a free cubic B-spline up to three times the highest frequency. The template in closed form carries the harmonics
beyond those; below them D takes up whatever differs from it. light is a polynomial of second degree over the picture, x linear in
the pixel's place in its micro-image and in the micro-image's centre.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

GEOMETRY = 5  # shift, across x and y, along x and y
LIGHT = 6
STRIPS = 24
MOST_CYCLES_A_STEP = 0.1
MODEL_ERROR = 1e-3  # of the light: what the template leaves; keeps nearly dark pixels from outweighing all others
CURVE = GEOMETRY + LIGHT  # first of the curve's parameters: g, then the spline's coefficients


@dataclass(frozen=True)
class Template:
    """A pixel and a disc of blur, both in mm on the target."""

    pixel: float
    blur: float

    @property
    def strips(self) -> Array:
        """The disc cut into strips: offset (mm) and weight of each, shape (STRIPS, 2)."""
        angle = np.pi * np.arange(1, STRIPS + 1) / (STRIPS + 1)
        return np.stack([self.blur / 2 * np.cos(angle), 2 / (STRIPS + 1) * np.sin(angle) ** 2], axis=1)

    def transfer(self, frequency: Array) -> Array:
        """Transfer at frequencies in cycles/mm."""
        nu = np.asarray(frequency, dtype=np.float64)
        offset, weight = self.strips.T
        return np.sinc(nu * self.pixel) * (np.cos(2 * np.pi * np.outer(nu, offset)) @ weight)

    def bars(self, phase: Array, frequency: float) -> Array:
        """Square wave of amplitude 1 seen through the template, at phases in cycles."""

        def triangle(cycles: Array) -> Array:
            part = cycles - np.floor(cycles)
            return np.minimum(part, 1 - part)

        u = frequency * self.pixel
        places = phase[:, None] + frequency * self.strips[:, 0]
        return (triangle(places + u / 2) - triangle(places - u / 2)) / u @ self.strips[:, 1]


@dataclass(frozen=True)
class Knots:
    """Uniform cubic B-splines on the frequency: ``count`` coefficients, the first spline's middle at ``first`` - ``step``."""

    first: float
    step: float
    count: int

    def design(self, frequency: Array, template: Template) -> Array:
        """Share of g and of every spline in the transfer at every frequency, shape (frequencies, 1 + count)."""
        place = (np.asarray(frequency, dtype=np.float64) - self.first) / self.step
        t = np.abs(place[:, None] - (np.arange(self.count) - 1)[None, :])
        splines = np.where(t < 1, 2 / 3 - t**2 + t**3 / 2, np.where(t < 2, np.maximum(2 - t, 0) ** 3 / 6, 0.0))
        return np.concatenate([template.transfer(frequency)[:, None], splines], axis=1)


@dataclass(frozen=True)
class ChirpData:
    """What is fitted, one entry a pixel: reading, place in the micro-image and its centre (mm), polynomial of the light.

    Attributes:
        read: DN above the offset, shape (n,).
        places: (1, s - c x, s - c y, c x, c y), mm, shape (n, 5).
        light: (1, u, v, u^2, u v, v^2) over the picture, shape (n, 6).
    """

    read: Array
    places: Array
    light: Array


@numba.njit(nogil=True, cache=True)
def _triangle(phase: float) -> float:  # pragma: no cover - compiled
    """Integral over the phase of the square wave that is 1 in the first half of a cycle and -1 in the second."""
    part = phase - np.floor(phase)
    return part if part < 0.5 else 1.0 - part


@numba.njit(nogil=True, cache=True)
def _square(phase: float) -> float:  # pragma: no cover - compiled
    return 1.0 if phase - np.floor(phase) < 0.5 else -1.0


@numba.njit(nogil=True, cache=True)
def _accumulate(
    read: Array,
    places: Array,
    light: Array,
    phase: Array,
    frequency: Array,
    pixel: float,
    strips: Array,
    brightness: Array,
    curve: Array,
    first: float,
    step: float,
    ceiling: float,
    bars: bool,
    dark: float,
    gain: float,
) -> tuple[Array, Array, float]:  # pragma: no cover - compiled
    knots = len(curve) - 1
    base = GEOMETRY + LIGHT + 1
    size = base + knots
    normal = np.zeros((size, size))
    right = np.zeros(size)
    g = np.zeros(size)
    touched = np.zeros(size, dtype=np.int64)
    chi2 = 0.0
    for n in range(len(read)):
        level = 0.0
        for k in range(LIGHT):
            level += brightness[k] * light[n, k]
        wave = 0.0
        slope = 0.0
        low, high = knots, -1
        for k in range(knots):
            g[base + k] = 0.0
        g[base - 1] = 0.0
        if bars:
            u = frequency[n] * pixel
            sharp = 0.0
            sharp_slope = 0.0
            for k in range(len(strips)):
                ahead = phase[n] + frequency[n] * strips[k, 0] + u / 2
                sharp += strips[k, 1] * (_triangle(ahead) - _triangle(ahead - u)) / u
                sharp_slope += strips[k, 1] * (_square(ahead) - _square(ahead - u)) / u
            wave = curve[0] * sharp
            slope = curve[0] * sharp_slope
            g[base - 1] = level * sharp
        turn = 2.0 * np.pi * (phase[n] - np.floor(phase[n]))
        h = 1
        while h * frequency[n] <= ceiling:
            share = 4.0 / (np.pi * h) if bars else 1.0
            place = (h * frequency[n] - first) / step
            cell = int(np.floor(place))
            t = place - cell
            s = np.sin(h * turn) * share
            c = np.cos(h * turn) * share * 2.0 * np.pi * h
            for m in range(4):
                k = cell + m
                if k < 0 or k >= knots:
                    continue
                if m == 0:
                    b = (1.0 - t) ** 3 / 6.0
                elif m == 1:
                    b = 2.0 / 3.0 - t * t + t**3 / 2.0
                elif m == 2:
                    b = 2.0 / 3.0 - (1.0 - t) ** 2 + (1.0 - t) ** 3 / 2.0
                else:
                    b = t**3 / 6.0
                wave += curve[1 + k] * b * s
                slope += curve[1 + k] * b * c
                g[base + k] += level * b * s
                low = min(low, k)
                high = max(high, k)
            if not bars:
                break
            h += 2
        for k in range(GEOMETRY):
            g[k] = level * slope * frequency[n] * places[n, k]
        for k in range(LIGHT):
            g[GEOMETRY + k] = light[n, k] * (1.0 + wave)
        expected = level * (1.0 + wave)
        weight = 1.0 / (dark + gain * max(expected, 0.0) + (MODEL_ERROR * level) ** 2)
        rest = read[n] - expected
        chi2 += weight * rest * rest
        count = base
        for k in range(base):
            touched[k] = k
        for k in range(low, high + 1):
            if g[base + k] != 0.0:
                touched[count] = base + k
                count += 1
        for p in range(count):
            k = touched[p]
            weighted = weight * g[k]
            right[k] += weighted * rest
            for q in range(p, count):
                normal[k, touched[q]] += weighted * g[touched[q]]
    return normal, right, chi2


@dataclass(frozen=True)
class ChirpFit:
    """Parameters of the fit and their covariance, in the order geometry, light, curve (g and the spline's coefficients)."""

    geometry: Array
    brightness: Array
    curve: Array
    covariance: Array
    chi2: float


@dataclass(frozen=True)
class Prior:
    """What is known before the fit, parameter by parameter in the fit's order: mean and standard deviation (infinite: nothing)."""

    mean: Array
    spread: Array


def gauss_newton_step(
    data: ChirpData,
    phase: Array,
    frequency: Array,
    fit: ChirpFit,
    knots: Knots,
    template: Template,
    ceiling: float,
    bars: bool,
    variance: tuple[float, float],
    prior: Prior,
    move: bool,
) -> ChirpFit:
    """One step of Gauss-Newton from ``fit``; no pixel's place moves by more than a tenth of a cycle.

    Args:
        data: the pixels.
        phase: cycles at the target's x of each pixel under ``fit``.
        frequency: cycles/mm there.
        fit: where to start.
        knots: of the transfer curve.
        template: what the harmonics above the ceiling are seen through.
        ceiling: harmonics above this frequency are left to the template, cycles/mm.
        bars: square bars (all odd harmonics) or a sine.
        variance: of a dark pixel, DN^2, and its growth per DN.
        prior: keeps directions that the pixels hardly see.
        move: False keeps the geometry and solves for light and curve only.
    """
    normal, right, chi2 = _accumulate(
        data.read,
        data.places,
        data.light,
        phase,
        frequency,
        template.pixel,
        template.strips,
        fit.brightness,
        fit.curve,
        knots.first,
        knots.step,
        ceiling,
        bars,
        *variance,
    )
    normal = np.triu(normal) + np.triu(normal, 1).T + np.diag(prior.spread**-2)
    right += (prior.mean - np.concatenate([fit.geometry, fit.brightness, fit.curve])) * prior.spread**-2
    free = np.arange(0 if move else GEOMETRY, len(normal))
    scale = np.sqrt(np.maximum(np.diag(normal)[free], 1e-30))
    inverse = np.linalg.inv(normal[np.ix_(free, free)] / np.outer(scale, scale) + 1e-12 * np.eye(len(free)))
    step, covariance = np.zeros(len(normal)), np.zeros_like(normal)
    step[free] = inverse @ (right[free] / scale) / scale
    covariance[np.ix_(free, free)] = inverse / np.outer(scale, scale)
    furthest = float(np.abs(data.places @ step[:GEOMETRY] * frequency).max())
    step *= min(1.0, MOST_CYCLES_A_STEP / max(furthest, 1e-300))
    return ChirpFit(fit.geometry + step[:GEOMETRY], fit.brightness + step[GEOMETRY:CURVE], fit.curve + step[CURVE:], covariance, chi2)

"""What a run of pixels reads of a chirp seen through its micro-image, and the derivatives by what
all views share and by what each has for itself.

A run that looks at the target's x reads light (1 + g bars(x) + w T(nu) c(nu) sin(2 pi phase(x))),
with bars(x) the target seen through the pixel and its view's disc of blur, T the transfer of both,
w = 4/pi of bars, 1 of a sine. c is a cubic B-spline over the frequencies seen: the transfer is T (g
+ c), which takes up whatever blurs otherwise than a disc. Evaluated at the true places of the
pixels, so frequencies beyond half a cycle a pixel need no special case.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from flflab.measurement.contrast.runs import Runs
from flflab.measurement.contrast.wave import Pattern, transfer

Array = npt.NDArray[np.float64]

# common: shift, across x and y, along x and y; square of the disc of blur, mm^2; g and the spline
GEOMETRY, DISC, CURVE = slice(0, 5), 5, 6
# a view's own: light, its slope and bend over half a field along x, its slope along y, as shares;
# shift, mm on the target; magnification, mm on the target a mm; square of its disc, mm^2
LIGHT, SHIFT, ACROSS, BLUR, NUMBERS = slice(0, 4), 4, 5, 6, 7
MODEL_ERROR = 1e-3  # of the light; keeps dark runs, almost without noise, from outweighing others
MORE_BLUR = 0.3  # px, added in squares: how what blur does is found, in few runs at bars' corners


@dataclass(frozen=True)
class Model:
    """What is known of a picture of a chirp and kept while fitting.

    Attributes:
        pattern: the target's law.
        knots: of the transfer curve's cubic splines, cycles/mm, shape (K + 4,).
        pixel: of the sensor, mm.
        half: half of a bright field, mm on the sensor.
        level: the light's unit, DN.
        mean: of the common parameters before the fit, shape (P,).
        doubt: their standard deviation, shape (P,).
        spread: standard deviation of the views' own numbers, 0: they are alike, shape (7,).
    """

    pattern: Pattern
    knots: Array
    pixel: float
    half: float
    level: float
    mean: Array
    doubt: Array
    spread: Array

    def basis(self, frequency: Array) -> Array:
        """1 and every spline at every frequency, shape (frequencies, 1 + K)."""
        inside = np.clip(frequency, self.knots[3], self.knots[-4])
        splines = BSpline.design_matrix(inside, self.knots, 3).toarray()
        return np.concatenate([np.ones((len(inside), 1)), splines], axis=1)

    @property
    def tie(self) -> Array:
        """Inverse variance of the views' own numbers."""
        return 1 / np.maximum(self.spread, 1e-12) ** 2

    @property
    def pixel_seen(self) -> float:
        """A pixel on the target, nominally, mm."""
        return abs(float(self.mean[1])) * self.pixel

    @property
    def units(self) -> Array:
        """Of the views' own numbers: shares, pixels and their squares on the target; 0 of a sine's
        blur, which no harmonics show.
        """
        pixel = self.pixel_seen
        return np.array([1, 1, 1, 1, pixel, abs(self.mean[1]), pixel**2 * self.pattern.bars])


@dataclass(frozen=True)
class Fit:
    """Common parameters, shape (P,), and every view's own, shape (V, 7)."""

    common: Array
    own: Array

    def squares(self, view: npt.NDArray[np.int64]) -> Array:
        """Of the discs of blur of these views, mm^2."""
        return np.maximum(self.common[DISC] + self.own[view, BLUR], 0.0)


@dataclass(frozen=True)
class Seen:
    """What a fit makes of every run: where it looks, mm, what white would read there, DN, the wave,
    its slope, 1/mm, and the square of its view's disc, mm^2; each of shape (n,). How the curve's
    parameters change the wave, shape (n, K + 1).
    """

    x: Array
    level: Array
    wave: Array
    slope: Array
    squares: Array
    by_curve: Array

    @property
    def due(self) -> Array:
        """What it should read, DN."""
        return self.level * (1 + self.wave)


def light_terms(runs: Runs, model: Model) -> Array:
    """What the shares of a view's light are multiplied by, shape (n, 4)."""
    t, u = runs.places[:, 1] / model.half, runs.places[:, 2] / model.half
    return np.stack([np.ones_like(t), t, t * t, u], axis=1)


def look_at(runs: Runs, model: Model, fit: Fit) -> Seen:
    """Runs as a fit has them."""
    own = fit.own[runs.view]
    x = runs.places @ fit.common[GEOMETRY] + own[:, SHIFT] + own[:, ACROSS] * runs.places[:, 1]
    level = model.level * (1 + np.sum(light_terms(runs, model) * own[:, LIGHT], axis=1))
    squares = fit.squares(runs.view)
    wave, slope, by_curve = _wave(x, squares, model, fit)
    return Seen(x, level, wave, slope, squares, by_curve)


def _wave(x: Array, squares: Array, model: Model, fit: Fit) -> tuple[Array, Array, Array]:
    """The wave at places of the target through discs, its slope, and its derivatives by the
    curve's parameters.
    """
    pattern, curve = model.pattern, fit.common[CURVE:]
    pixel = abs(float(fit.common[1])) * model.pixel
    wave, slope = pattern.seen(x, pixel, squares)
    nu, turn = pattern.frequency(x), 2 * np.pi * pattern.phase(x)
    strong = transfer(nu, pixel, squares) * (4 / np.pi if pattern.bars else 1.0)
    basis = model.basis(nu)
    by_curve = basis * (strong * np.sin(turn))[:, None]
    by_curve[:, 0] = wave
    slope = curve[0] * slope + basis[:, 1:] @ curve[1:] * strong * np.cos(turn) * 2 * np.pi * nu
    return by_curve @ curve, slope, by_curve


def derivatives(runs: Runs, model: Model, fit: Fit, seen: Seen) -> tuple[Array, Array]:
    """Of what every run should read, by the common parameters, (n, P), and by its view's own,
    (n, 7).
    """
    step = (MORE_BLUR * model.pixel_seen) ** 2
    wider = (_wave(seen.x, seen.squares + step, model, fit)[0] - seen.wave) / step * seen.level
    moved = seen.level * seen.slope
    common = np.concatenate(
        [
            moved[:, None] * runs.places,
            wider[:, None],
            seen.level[:, None] * seen.by_curve,
        ],
        axis=1,
    )
    light = light_terms(runs, model) * (model.level * (1 + seen.wave))[:, None]
    own = [light, moved[:, None], (moved * runs.places[:, 1])[:, None], wider[:, None]]
    return common, np.concatenate(own, axis=1)


def weights(runs: Runs, seen: Seen) -> tuple[Array, Array]:
    """Variance of every run, DN^2, and its weight."""
    variance = runs.dark + runs.shot * np.maximum(seen.due, 0.0)
    return variance, 1 / (variance + (MODEL_ERROR * seen.level) ** 2)

"""Transfer function from a slanted edge whose blur is of no known kind: the fitted Gaussian plus a
smooth deviation.

The line spread is the fitted Gaussian plus a comb of lines every quarter of a pixel, each seen
through the square pixel. Where the pixels clearly show a skirt of flare, wider Gaussians take part.
The comb's heights are held by a prior that says only how smooth and how wide a deviation is; how
strong it is the pixels decide (the greatest marginal likelihood). Where the blur is a Gaussian
nothing is added and the result is as quiet as the fit of the Gaussian alone.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.edges.fit import EdgeFit, EdgePixels, edge_pixels, fit_edge, sides
from flflab.measurement.edges.profile import edge_profile, pixel_transfer, sharp_profile

Array = npt.NDArray[np.float64]

SIDE = 30.0  # px, so that slopes of a side are about as large as its light
SPACING = (
    0.25  # px between the comb's lines: what they repeat at 4 cycles/px the pixel does not pass
)
SMOOTHNESS = (0.35, 0.7, 1.4)  # px, lengths over which a deviation varies
WIDTHS = (1.0, 2.0, 4.0)  # of the fitted blur, how far it reaches
SKIRTS = (4.0, 8.0, 16.0, 32.0)  # px, standard deviations of what a skirt of flare is made of
LARGEST_SKIRT = 0.2  # of the light, standard deviation of each part
CLEAR_SKIRT = 40.0  # by which chi squared must fall
OF_SKIRT = 0.15  # of its light: its form is not known better
STRENGTHS = 10.0 ** np.arange(-6.0, 8.0, 0.5)  # of its variance over the noise's


@dataclass(frozen=True)
class FreeEdge:
    """An edge and its line spread of free form.

    Attributes:
        fit: the edge with the Gaussian blur.
        places_px: of the comb's lines across the edge, shape (K,).
        parts: of the line spread, in units of the fitted edge's height: the Gaussian's area, its
            shift (px), what its variance grows by (px^2), areas of S skirts, and the lines'
            heights, shape (3 + S + K,).
        own: covariance of all but the lines for known lines, shape (3 + S, 3 + S).
        by_lines: how these follow the lines' heights, shape (3 + S, K).
        lines_covariance: of the lines' heights, which edges fitted together share, shape (K, K).
    """

    fit: EdgeFit
    places_px: Array
    parts: Array
    own: Array
    by_lines: Array
    lines_covariance: Array

    @property
    def skirt(self) -> float:
        """Share of the light in the skirt."""
        return float(np.sum(self.parts[3 : len(self.own)]))

    def mtf(self, cycles_per_px: npt.ArrayLike) -> Array:
        """Transfer function of blur and pixel along the edge's normal; shape of the frequencies."""
        return self.mtf_and_slopes(cycles_per_px)[0]

    def mtf_uncertainty(self, cycles_per_px: npt.ArrayLike) -> Array:
        """Its standard uncertainty."""
        _, own, slopes = self.mtf_and_slopes(cycles_per_px)
        form = np.where(np.asarray(cycles_per_px) > 0, OF_SKIRT * self.skirt, 0.0)
        return np.sqrt(own**2 + variance_along(slopes, self.lines_covariance) + form**2)

    def mtf_and_slopes(self, cycles_per_px: npt.ArrayLike) -> tuple[Array, Array, Array]:
        """Transfer function, its standard uncertainty for known lines, both (F,), and its slopes by
        the lines' heights, (F, K).
        """
        f = np.asarray(cycles_per_px, dtype=np.float64)
        bell = np.exp(-2 * math.pi**2 * self.fit.blur_px**2 * f * f)
        count = len(self.own)
        skirts = [np.exp(-2 * (math.pi * wide * f) ** 2) for wide in SKIRTS[: count - 3]]
        gaussian = np.stack(
            [bell + 0j, -2j * math.pi * f * bell, -2 * math.pi**2 * f * f * bell, *skirts], axis=-1
        )
        waves = np.concatenate(
            [gaussian, np.exp(-2j * math.pi * f[..., None] * self.places_px)], axis=-1
        )
        areas = np.concatenate([[1.0, 0.0, 0.0], np.ones(count - 3 + len(self.places_px))])
        area = float(areas @ self.parts)
        pixel = pixel_transfer(f, self.fit.angle) / area
        spread = waves @ self.parts
        phase = np.conj(spread) / np.maximum(np.abs(spread), 1e-12)
        slopes = np.real((phase * pixel)[..., None] * (waves - (spread / area)[..., None] * areas))
        by_own = slopes[..., :count]
        by_lines = slopes[..., count:] + by_own @ self.by_lines
        return np.abs(spread * pixel), np.sqrt(variance_along(by_own, self.own)), by_lines


def variance_along(slopes: Array, covariance: Array) -> Array:
    """Variance of what has these slopes by parameters of this covariance; shape of the slopes
    without their last axis.
    """
    return np.maximum(np.einsum("...i,ij,...j->...", slopes, covariance, slopes), 0.0)


def fit_free_edge(
    picture: npt.NDArray[np.generic],
    mask: npt.NDArray[np.bool_] | None = None,
    deviation: npt.ArrayLike = 1.0,
) -> FreeEdge:
    """Fit one straight edge of unknown blur; arguments and errors as
    ``flflab.measurement.edges.fit.fit_edge``.
    """
    return free_forms(
        [fit_edge(picture, mask, deviation)], [edge_pixels(picture, mask, deviation)[0]]
    )[0]


def free_forms(fits: list[EdgeFit], pixels: list[EdgePixels]) -> list[FreeEdge]:
    """The line spreads of edges that have been fitted to these pixels, with one deviation from a
    Gaussian for all.

    Many edges tell the deviation better than one: what the prior leaves of it is the same in each,
    and no mean makes it smaller.
    """
    blur = math.sqrt(float(np.mean([fit.blur_px**2 for fit in fits])))
    half = math.ceil((4 * max(fit.blur_px for fit in fits) + 2) / SPACING) * SPACING
    places: Array = (
        np.arange(-round(half / SPACING), round(half / SPACING) + 1, dtype=np.float64) * SPACING
    )
    plain, seen = (
        [_seen(fit, own, places, skirts) for fit, own in zip(fits, pixels, strict=True)]
        for skirts in ((), SKIRTS)
    )
    fallen = sum(one.power - two.power for one, two in zip(plain, seen, strict=True))
    left, few = sum(one.power for one in seen), len(SKIRTS) * len(fits)
    if fallen < (CLEAR_SKIRT + 2 * few) * left / sum(one.freedom for one in seen):
        seen = plain
    normal, moment = (
        np.sum([one.normal for one in seen], axis=0),
        np.sum([one.moment for one in seen], axis=0),
    )
    power, freedom = sum(one.power for one in seen), sum(one.freedom for one in seen)
    mean, spread, noise = _averaged(
        [
            _deviation(
                places, smooth, width * math.hypot(blur, 0.3), normal, moment, power, freedom
            )
            for smooth in SMOOTHNESS
            for width in WIDTHS
        ]
    )
    return [
        FreeEdge(
            fit,
            places,
            np.concatenate([one.free + one.by_lines @ mean, mean]),
            noise * one.covariance,
            one.by_lines,
            spread,
        )
        for fit, one in zip(fits, seen, strict=True)
    ]


@dataclass(frozen=True)
class Seen:
    """What one edge's pixels say of a deviation, level, height, place and variance taken out; in
    units of its height.

    Attributes:
        normal: matrix of the normal equations of the lines' heights, shape (K, K).
        moment: their right side, shape (K,).
        power: sum of squares of what is left of the weighted pixels.
        freedom: number of pixels less that of the parameters taken out.
        free: the Gaussian's area, shift and growth of variance, and skirts' areas, where there are
            no lines, shape (3 + S,).
        covariance: theirs, over the variance of a pixel of weight 1.
        by_lines: how they follow the lines' heights, shape (3 + S, K).
    """

    normal: Array
    moment: Array
    power: float
    freedom: int
    free: Array
    covariance: Array
    by_lines: Array


def _seen(fit: EdgeFit, pixels: EdgePixels, places: Array, skirts: tuple[float, ...]) -> Seen:
    t = pixels.distance(fit.angle, fit.offset_px)
    value, slope, bend = edge_profile(t, fit.blur_px, fit.angle)
    scale = fit.height * pixels.weights[:, None]
    wide = [edge_profile(t, one, fit.angle)[0] for one in skirts]
    free = np.stack([value, -slope, 0.5 * bend, *wide, np.ones_like(t)], axis=1)
    free = np.concatenate([free, sides(pixels, value) / SIDE], axis=1) * scale
    # a skirt is no more than a part of the light
    bound = np.zeros((len(skirts), free.shape[1]))
    bound[:, 3 : 3 + len(skirts)] = np.eye(len(skirts)) * fit.residual / LARGEST_SKIRT
    free = np.concatenate([free, bound])
    lines = np.where(t[:, None] > 0, 1.0, 0.0) * np.ones_like(places)
    near = np.abs(t) < places[-1] + 1
    lines[near] = sharp_profile(t[near, None] - places, fit.angle)
    lines *= scale
    lines = np.concatenate([lines, np.zeros((len(skirts), len(places)))])
    data = np.concatenate([pixels.values * pixels.weights, np.zeros(len(skirts))])
    base, _ = np.linalg.qr(free)
    left, lines_left = data - base @ (base.T @ data), lines - base @ (base.T @ lines)
    inverse = np.linalg.pinv(free)[: 3 + len(skirts)]
    return Seen(
        normal=lines_left.T @ lines_left,
        moment=lines_left.T @ left,
        power=float(left @ left),
        freedom=len(t) - free.shape[1],
        free=inverse @ data,
        covariance=inverse @ inverse.T,
        by_lines=-(inverse @ lines),
    )


@dataclass(frozen=True)
class Deviations:
    """What one smoothness and one width of the deviation say for each of ``STRENGTHS``.

    Attributes:
        scores: logarithm of the marginal likelihood up to a constant, shape (S,).
        noise: variance of a pixel of weight 1, shape (S,).
        basis: the lines' heights for each mode, shape (K, M).
        modes: most likely mode amplitudes, shape (S, M).
        spread: their variances, shape (S, M).
    """

    scores: Array
    noise: Array
    basis: Array
    modes: Array
    spread: Array


def _deviation(
    places: Array,
    smooth: float,
    width: float,
    normal: Array,
    moment: Array,
    power: float,
    freedom: int,
) -> Deviations:
    """Deviations of given smoothness and width.

    With the prior covariance A^2 K = A^2 B B^T the normal equations B^T N B = V diag(l) V^T part:
    each mode is shrunk by A^2 l / (1 + A^2 l), A^2 in units of the noise's variance, which the
    likelihood leaves free.
    """
    prior = np.exp(
        -0.5 * ((places[:, None] - places) / smooth) ** 2
        - 0.25 * (places[:, None] ** 2 + places**2) / width**2
    )
    values, vectors = np.linalg.eigh(prior)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    strength, modes = np.linalg.eigh(root.T @ normal @ root)
    strength = np.maximum(strength, 0.0)
    along = modes.T @ (root.T @ moment)
    shrunk = STRENGTHS[:, None] / (1 + STRENGTHS[:, None] * strength)
    rest = np.maximum(power - (along**2 * shrunk).sum(axis=1), 1e-14 * power + 1e-300)
    scores = -0.5 * freedom * np.log(rest) - 0.5 * np.log1p(STRENGTHS[:, None] * strength).sum(
        axis=1
    )
    noise = rest / freedom
    return Deviations(scores, noise, root @ modes, along * shrunk, noise[:, None] * shrunk)


def _averaged(trials: list[Deviations]) -> tuple[Array, Array, float]:
    """Mean and covariance of the lines' heights, and the noise's variance, over all trials by their
    likelihood.

    The likeliest trial alone would be far too sure where the pixels hardly tell whether there is a
    deviation.
    """
    best = max(float(trial.scores.max()) for trial in trials)
    chances = [np.exp(trial.scores - best) for trial in trials]
    total = sum(float(chance.sum()) for chance in chances)
    lines = len(trials[0].basis)
    mean, second, noise = np.zeros(lines), np.zeros((lines, lines)), 0.0
    for trial, chance in zip(trials, chances, strict=True):
        weight = chance / total
        mean += trial.basis @ (weight @ trial.modes)
        second += (
            trial.basis
            @ ((trial.modes.T * weight) @ trial.modes + np.diag(weight @ trial.spread))
            @ trial.basis.T
        )
        noise += float(weight @ trial.noise)
    return mean, second - np.outer(mean, mean), noise

"""Transfer function from a slanted edge whose blur is of no known kind: the line spread is a
Gaussian plus a smooth deviation.

The deviation is a comb of lines every quarter of a pixel, each seen through the square pixel. Where
the pixels clearly show a skirt of flare, wider Gaussians take part. The comb's heights are held by
a prior that says only how smooth and how wide a deviation is; how strong it is the pixels decide
(the marginal likelihood). Where the blur is a Gaussian nothing is added and the result is nearly as
quiet as a Gaussian's fit.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.edges.edge import Edge
from flflab.measurement.edges.profile import edge_profile, pixel_transfer

Array = npt.NDArray[np.float64]

# px between the comb's lines: what they repeat at 4 cycles/px the pixel does not pass
SPACING = 0.25
BRIGHT, BEND = 3, 7  # of the free numbers: the even light of the bright side, and the variance
LINE = 0.02  # px, standard deviation of one line
SMOOTHNESS = 0.5  # px, length over which a deviation varies
REACH = 1.5  # of the fitted blur, how far it reaches
SKIRTS = (8.0, 24.0)  # px, standard deviations of what a skirt of flare is made of
CLEAR_SKIRT = 20.0  # by which chi squared must fall
OF_SKIRT = 0.15  # of its light: its form is not known better
STRENGTHS = 10.0 ** np.arange(-6.0, 8.0, 0.5)  # of its variance over the noise's


@dataclass(frozen=True)
class LineSpread:
    """What an edge says of its blur.

    Attributes:
        angle: of the edge's normal, rad.
        blur_px: standard deviation of the Gaussian, px.
        skirts_px: of the parts of a skirt, px, shape (S,), S = 0 where there is none.
        places_px: of the comb's lines across the edge, shape (K,).
        parts: what the Gaussian's variance grows by (px^2), and the light that skirts and lines
            take from it, as shares of the whole, shape (1 + S + K,).
        covariance: theirs, shape (1 + S + K, 1 + S + K).
    """

    angle: float
    blur_px: float
    skirts_px: Array
    places_px: Array
    parts: Array
    covariance: Array

    @property
    def skirt(self) -> float:
        """Share of the light in the skirt."""
        return float(self.parts[1 : 1 + len(self.skirts_px)].sum())

    def mtf(self, cycles_per_px: Array) -> tuple[Array, Array, Array]:
        """Transfer function of blur and pixel along the edge's normal, its standard uncertainty,
        and another because a skirt's form is not known (type B); shapes of the frequencies, (F,).
        """
        f = cycles_per_px[:, None]
        bell = np.exp(-2 * (math.pi * self.blur_px * f) ** 2)
        waves = np.concatenate(
            [
                -2 * (math.pi * f) ** 2 * bell,
                np.exp(-2 * (math.pi * self.skirts_px * f) ** 2) - bell,
                np.exp(-2j * math.pi * f * self.places_px) - bell,
            ],
            axis=1,
        )
        spread = bell[:, 0] + waves @ self.parts
        phase = np.conj(spread) / np.maximum(np.abs(spread), 1e-12)
        gains = (phase[:, None] * waves).real
        variance = np.einsum("fp,pq,fq->f", gains, self.covariance, gains)
        pixel = np.abs(pixel_transfer(cycles_per_px, self.angle))
        own = np.sqrt(np.maximum(variance, 0.0)) * pixel
        form = np.where(cycles_per_px > 0, OF_SKIRT * abs(self.skirt), 0.0)
        return np.abs(spread) * pixel, own, form


def line_spread(edge: Edge) -> LineSpread:
    """The line spread that an edge shows."""
    t, blur = edge.distance, edge.blur_px
    half = math.ceil((4 * blur + 2) / SPACING)
    places = np.arange(-half, half + 1, dtype=np.float64) * SPACING
    value, slope, bend = edge_profile(t, blur, edge.angle)
    wide = [edge_profile(t, skirt, edge.angle)[0] - value for skirt in SKIRTS]
    weights = edge.pixels.weights[:, None]
    scale = edge.height * weights
    free = np.stack([*edge.pixels.light(value).T, -slope, 0.5 * bend, *wide], axis=1) * scale
    lines = (_lines(edge, places) - value[:, None]) * scale
    data = edge.pixels.values * edge.pixels.weights
    root = _root_of_prior(places, REACH * math.hypot(blur, 0.3))
    plain, flared = (
        _fitted(data, columns, lines, root) for columns in (free[:, : -len(SKIRTS)], free)
    )
    clear = (plain[2] / flared[2] - 1) * len(data) > CLEAR_SKIRT
    values, covariance, _ = flared if clear else plain
    height, skirts = float(values[BRIGHT]), SKIRTS if clear else ()
    parts, covariance = values[BEND:] / height, covariance[BEND:, BEND:] / height**2
    return LineSpread(edge.angle, blur, np.array(skirts), places, parts, covariance)


def _lines(edge: Edge, places: Array) -> Array:
    """The edge as each line of the comb alone would show it, shape (n, K)."""
    t = edge.distance
    lines = np.repeat((t > 0).astype(np.float64)[:, None], len(places), axis=1)
    near = np.abs(t) < places[-1] + 1
    lines[near] = edge_profile(t[near, None] - places, LINE, edge.angle)[0]
    return lines


def _root_of_prior(places: Array, width: float) -> Array:
    """B, whose B B^T is the covariance of the lines' heights for a strength of 1, shape (K, k)."""
    apart, squares = places[:, None] - places, places**2
    prior = np.exp(
        -0.5 * (apart / SMOOTHNESS) ** 2 - 0.25 * (squares[:, None] + squares) / width**2
    )
    values, vectors = np.linalg.eigh(prior)
    kept = values > 1e-12 * values[-1]
    return vectors[:, kept] * np.sqrt(values[kept])


def _fitted(data: Array, free: Array, lines: Array, root: Array) -> tuple[Array, Array, float]:
    """Q free numbers and K heights of lines over all strengths of the deviation by their marginal
    likelihood, shape (Q + K,), their covariance, and the variance of a pixel of weight 1.

    With the prior covariance A^2 B B^T and the lines' normal equations N, free numbers taken out,
    B^T N B = V diag(l) V^T parts them: each mode is shrunk by A^2 l / (1 + A^2 l), A^2 in units of
    the noise's variance, which the likelihood leaves free. The likeliest strength alone would be
    far too sure where the pixels hardly tell whether there is a deviation.

    Args:
        data: weighted pixels, shape (n,).
        free: what each free number adds to them, shape (n, Q).
        lines: what each line adds, shape (n, K).
        root: B, shape (K, k).
    """
    base, upper = np.linalg.qr(free)
    inverse = np.linalg.pinv(upper)
    alone, follow = inverse @ (base.T @ data), -inverse @ (base.T @ lines)
    left, lines = data - base @ (base.T @ data), lines - base @ (base.T @ lines)
    power, freedom = float(left @ left), len(data) - free.shape[1]
    strength, modes = np.linalg.eigh(root.T @ (lines.T @ lines) @ root)
    strength, basis = np.maximum(strength, 0.0), root @ modes
    along = basis.T @ (lines.T @ left)
    shrunk = STRENGTHS[:, None] / (1 + STRENGTHS[:, None] * strength)
    rest = np.maximum(power - (along**2 * shrunk).sum(axis=1), 1e-14 * power + 1e-300)
    scores = -0.5 * freedom * np.log(rest)
    scores -= 0.5 * np.log1p(STRENGTHS[:, None] * strength).sum(axis=1)
    chance = np.exp(scores - scores.max())
    chance /= chance.sum()
    noise, found = rest / freedom, along * shrunk
    mean = chance @ found
    spread = (found.T * chance) @ found + np.diag((chance * noise) @ shrunk)
    basis = np.concatenate([follow, np.eye(len(root))]) @ basis
    values, covariance = basis @ mean, basis @ (spread - np.outer(mean, mean)) @ basis.T
    few, variance = len(alone), float(chance @ noise)
    values[:few] += alone
    covariance[:few, :few] += variance * inverse @ inverse.T
    return values, covariance, variance

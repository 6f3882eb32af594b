"""Transfer function from slanted edges whose blur is of no known kind: the line spread is a
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
BRIGHT = 3  # of an edge's light, the even one of its bright side
LINE = 0.02  # px, standard deviation of one line
SMOOTHNESS = 0.5  # px, length over which a deviation varies
REACH = 1.5  # of the fitted blur, how far it reaches
SKIRTS = (8.0, 24.0)  # px, standard deviations of what a skirt of flare is made of
LARGEST_SKIRT = 0.07  # of the light, standard deviation of each part
CLEAR_SKIRT = 20.0  # by which chi squared must fall
OF_SKIRT = 0.15  # of its light: its form is not known better
STRENGTHS = 10.0 ** np.arange(-6.0, 8.0, 0.5)  # of its variance over the noise's


@dataclass(frozen=True)
class LineSpread:
    """What edges of one blur say of it together.

    Attributes:
        angles: of the edges' normals, rad, shape (E,).
        blur_px: standard deviation of the Gaussian, px.
        skirts_px: of the parts of a skirt, px, shape (S,), S = 0 where there is none.
        places_px: of the comb's lines across the edge, shape (K,).
        parts: what the Gaussian's variance grows by (px^2), and the light that skirts and lines
            take from it, as shares of the whole, shape (1 + S + K,).
        covariance: theirs, shape (1 + S + K, 1 + S + K).
    """

    angles: Array
    blur_px: float
    skirts_px: Array
    places_px: Array
    parts: Array
    covariance: Array

    @property
    def skirt(self) -> float:
        """Share of the light in the skirt."""
        return float(self.parts[1 : 1 + len(self.skirts_px)].sum())

    def form(self, cycles_per_px: Array) -> Array:
        """Standard uncertainty of the transfer because a skirt's form is not known (type B)."""
        return np.where(cycles_per_px > 0, OF_SKIRT * abs(self.skirt), 0.0)

    def mtf(self, cycles_per_px: Array) -> tuple[Array, Array]:
        """Transfer function of blur and pixel along the edges' normal, and its standard uncertainty
        but for ``form``; shapes of the frequencies, (F,).
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
        slopes = np.real(phase[:, None] * waves)
        pixel = np.mean([np.abs(pixel_transfer(cycles_per_px, at)) for at in self.angles], axis=0)
        variance = np.einsum("fi,ij,fj->f", slopes, self.covariance, slopes)
        return np.abs(spread) * pixel, np.sqrt(np.maximum(variance, 0.0)) * pixel

    def with_form(self, cycles_per_px: Array) -> tuple[Array, Array]:
        """The same with the whole uncertainty."""
        mtf, own = self.mtf(cycles_per_px)
        return mtf, np.hypot(own, self.form(cycles_per_px))


def line_spread(edges: list[Edge]) -> LineSpread:
    """The line spread that edges share.

    Many edges tell it better than one: what the prior leaves of a deviation is the same in each,
    and no mean makes it smaller.
    """
    blur = math.sqrt(float(np.mean([edge.blur_px**2 for edge in edges])))
    half = math.ceil((4 * max(edge.blur_px for edge in edges) + 2) / SPACING)
    places = np.arange(-half, half + 1, dtype=np.float64) * SPACING
    sums = _sums(edges, blur, places)
    prior = _prior(places, REACH * math.hypot(blur, 0.3))
    parts, covariance, noise = _solved(sums, prior, ())
    *flared, less = _solved(sums, prior, SKIRTS)
    skirts: tuple[float, ...] = ()
    if (noise / less - 1) * sums.freedom > CLEAR_SKIRT:
        (parts, covariance), skirts = flared, SKIRTS
    angles = np.array([edge.angle for edge in edges])
    return LineSpread(angles, blur, np.array(skirts), places, parts, covariance)


@dataclass(frozen=True)
class Sums:
    """What all pixels say of the P parts, each edge's own light and place taken out.

    Attributes:
        normal: matrix of the normal equations, in units of the edges' heights, shape (P, P).
        moment: their right side, shape (P,).
        power: sum of squares of what is left of the weighted pixels.
        freedom: number of pixels less that of the parameters taken out.
        height: mean of the edges' heights where all parts are 0.
        height_by: what each part takes from it, shape (P,).
    """

    normal: Array
    moment: Array
    power: float
    freedom: int
    height: float
    height_by: Array


def _sums(edges: list[Edge], blur: float, places: Array) -> Sums:
    count = 1 + len(SKIRTS) + len(places)
    normal, moment, power, freedom = np.zeros((count, count)), np.zeros(count), 0.0, 0
    height, height_by = 0.0, np.zeros(count)
    for edge in edges:
        value, slope, bend = edge_profile(edge.distance, blur, edge.angle)
        scale = (edge.height * edge.pixels.weights)[:, None]
        light = np.concatenate([edge.pixels.light(value), -slope[:, None]], axis=1) * scale
        parts = np.concatenate([0.5 * bend[:, None], _steps(edge, value, places)], axis=1) * scale
        data = edge.pixels.values * edge.pixels.weights
        base, upper = np.linalg.qr(light)
        bright = np.linalg.pinv(upper)[BRIGHT] @ base.T
        height += float(bright @ data) / len(edges)
        height_by += bright @ parts / len(edges)
        left, parts = data - base @ (base.T @ data), parts - base @ (base.T @ parts)
        normal += parts.T @ parts
        moment += parts.T @ left
        power += float(left @ left)
        freedom += len(data) - light.shape[1]
    # a skirt is no more than a part of the light
    skirts = range(1, 1 + len(SKIRTS))
    normal[skirts, skirts] += np.mean([edge.residual**2 for edge in edges]) / LARGEST_SKIRT**2
    return Sums(normal, moment, power, freedom, height, height_by)


def _steps(edge: Edge, value: Array, places: Array) -> Array:
    """What skirts and lines change of an edge of this profile, shape (n, S + K)."""
    t = edge.distance
    skirts = [edge_profile(t, wide, edge.angle)[0] for wide in SKIRTS]
    lines = np.where(t[:, None] > 0, 1.0, 0.0) * np.ones_like(places)
    near = np.abs(t) < places[-1] + 1
    lines[near] = edge_profile(t[near, None] - places, LINE, edge.angle)[0]
    return np.concatenate([np.stack(skirts, axis=1), lines], axis=1) - value[:, None]


def _prior(places: Array, width: float) -> Array:
    """Covariance of the lines' heights for a strength of 1, shape (K, K)."""
    apart, squares = places[:, None] - places, places**2
    return np.exp(-0.5 * (apart / SMOOTHNESS) ** 2 - 0.25 * (squares[:, None] + squares) / width**2)


def _solved(sums: Sums, prior: Array, skirts: tuple[float, ...]) -> tuple[Array, Array, float]:
    """The parts over all strengths of the deviation by their marginal likelihood, as shares of the
    light, shape (P,), their covariance, (P, P), and the variance of a pixel of weight 1; with these
    skirts or none.

    With the prior covariance A^2 K = A^2 B B^T the normal equations B^T N B = V diag(l) V^T part:
    each mode is shrunk by A^2 l / (1 + A^2 l), A^2 in units of the noise's variance, which the
    likelihood leaves free. The likeliest strength alone would be far too sure where the pixels
    hardly tell whether there is a deviation.
    """
    few = 1 + len(skirts)
    kept = np.r_[:few, 1 + len(SKIRTS) : len(sums.moment)]
    whole, moment, taken = sums.normal[np.ix_(kept, kept)], sums.moment[kept], sums.height_by[kept]
    inverse = np.linalg.pinv(whole[:few, :few], hermitian=True)
    by_lines = -inverse @ whole[:few, few:]
    follow = np.concatenate([by_lines, np.eye(len(prior))])
    power = sums.power - float(moment[:few] @ inverse @ moment[:few])
    freedom = sums.freedom - few
    values, vectors = np.linalg.eigh(prior)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    normal = whole[few:, few:] + whole[few:, :few] @ by_lines
    strength, modes = np.linalg.eigh(root.T @ normal @ root)
    strength, basis = np.maximum(strength, 0.0), follow @ root @ modes
    along = basis.T @ moment
    shrunk = STRENGTHS[:, None] / (1 + STRENGTHS[:, None] * strength)
    rest = np.maximum(power - (along**2 * shrunk).sum(axis=1), 1e-14 * power + 1e-300)
    scores = -0.5 * freedom * np.log(rest)
    scores -= 0.5 * np.log1p(STRENGTHS[:, None] * strength).sum(axis=1)
    chance = np.exp(scores - scores.max())
    chance /= chance.sum()
    noise, found = rest / freedom, along * shrunk
    mean = chance @ found
    spread = (found.T * chance) @ found + np.diag((chance * noise) @ shrunk)
    parts, covariance = basis @ mean, basis @ (spread - np.outer(mean, mean)) @ basis.T
    parts[:few] += inverse @ moment[:few]
    covariance[:few, :few] += float(chance @ noise) * inverse
    height = sums.height - float(taken @ parts)
    return parts / height, covariance / height**2, float(chance @ noise)

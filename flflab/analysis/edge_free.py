"""Transfer function from a slanted edge whose blur is of no known kind: the fitted Gaussian plus a smooth deviation.

The line spread is the fitted Gaussian plus a comb of lines every quarter of a pixel, each seen through the square pixel. The comb's
heights are held by a prior that says only how smooth and how wide a deviation is; how strong it is the pixels decide (the greatest
marginal likelihood). Where the blur is a Gaussian nothing is added and the result is as quiet as the fit of the Gaussian alone.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.analysis.edge import EdgeFit, edge_pixels, fit_edge
from flflab.analysis.edge_profile import edge_profile, pixel_transfer, sharp_profile

Array = npt.NDArray[np.float64]

SPACING = 0.25  # px between the comb's lines: what they repeat at 4 cycles/px the pixel does not pass
SMOOTHNESS = (0.35, 0.7, 1.4)  # px, lengths over which a deviation varies
WIDTHS = (1.0, 2.0, 4.0)  # of the fitted blur, how far it reaches
STRENGTHS = 10.0 ** np.arange(-6.0, 8.0, 0.5)  # of its variance over the noise's


@dataclass(frozen=True)
class FreeEdge:
    """An edge and its line spread of free form.

    Attributes:
        fit: the edge with the Gaussian blur.
        places_px: of the comb's lines across the edge, shape (K,).
        heights: of the lines, in units of the edge's height; the Gaussian has the area 1, shape (K,).
        wider: what is added to the Gaussian's variance, px^2.
        covariance: of ``wider`` and ``heights``, shape (1 + K, 1 + K).
    """

    fit: EdgeFit
    places_px: Array
    heights: Array
    wider: float
    covariance: Array

    def mtf(self, cycles_per_px: npt.ArrayLike) -> Array:
        """Transfer function of blur and pixel along the edge's normal; shape of the frequencies."""
        return np.abs(self._spectrum(cycles_per_px)[0])

    def mtf_uncertainty(self, cycles_per_px: npt.ArrayLike) -> Array:
        """Its standard uncertainty."""
        spectrum, rows = self._spectrum(cycles_per_px)
        phase = np.conj(spectrum) / np.maximum(np.abs(spectrum), 1e-12)
        seen = np.real(phase[..., None] * rows)
        return np.sqrt(np.maximum(np.einsum("...i,ij,...j->...", seen, self.covariance, seen), 0.0))

    def _spectrum(self, cycles_per_px: npt.ArrayLike) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]:
        """The complex transfer function and its derivatives by ``wider`` and ``heights``."""
        f = np.asarray(cycles_per_px, dtype=np.float64)
        bell = np.exp(-2 * math.pi**2 * self.fit.blur_px**2 * f * f)
        waves = np.exp(-2j * math.pi * f[..., None] * self.places_px)
        area = 1 + float(self.heights.sum())
        pixel = pixel_transfer(f, self.fit.angle) / area
        spread = bell * (1 - 2 * math.pi**2 * f * f * self.wider) + waves @ self.heights
        by_heights = (waves - spread[..., None] / area) * pixel[..., None]
        by_wider = (-2 * math.pi**2 * f * f * bell * pixel)[..., None]
        rows = np.concatenate([by_wider, by_heights], axis=-1)
        return np.asarray(spread * pixel, dtype=np.complex128), np.asarray(rows, dtype=np.complex128)


def fit_free_edge(picture: npt.NDArray[np.generic], mask: npt.NDArray[np.bool_] | None = None, deviation: npt.ArrayLike = 1.0) -> FreeEdge:
    """Fit one straight edge of unknown blur; arguments and errors as ``flflab.analysis.edge.fit_edge``."""
    return with_free_form(fit_edge(picture, mask, deviation), picture, mask, deviation)


def with_free_form(
    fit: EdgeFit, picture: npt.NDArray[np.generic], mask: npt.NDArray[np.bool_] | None = None, deviation: npt.ArrayLike = 1.0
) -> FreeEdge:
    """The line spread of free form of an edge that has been fitted to these pixels; it costs more, the wider the blur."""
    pixels, _ = edge_pixels(picture, mask, deviation)
    t = pixels.distance(fit.angle, fit.offset_px)
    half = math.ceil((4 * fit.blur_px + 2) / SPACING) * SPACING
    places: Array = np.arange(-round(half / SPACING), round(half / SPACING) + 1, dtype=np.float64) * SPACING
    value, slope, bend = edge_profile(t, fit.blur_px, fit.angle)
    free = np.stack([np.ones_like(t), value, slope, 0.5 * bend], axis=1) * pixels.weights[:, None]
    lines = np.where(t[:, None] > 0, 1.0, 0.0) * np.ones_like(places)
    near = np.abs(t) < half + 1
    lines[near] = sharp_profile(t[near, None] - places, fit.angle)
    lines *= pixels.weights[:, None]
    data = pixels.values * pixels.weights
    # the free parameters are taken out of data and lines once; what is left decides on the deviation
    base, _ = np.linalg.qr(free)
    left, lines_left = data - base @ (base.T @ data), lines - base @ (base.T @ lines)
    normal, moment, power = lines_left.T @ lines_left, lines_left.T @ left, float(left @ left)
    freedom = len(t) - free.shape[1]
    best, mean, spread = -math.inf, np.zeros(len(places)), np.zeros((len(places), len(places)))
    for smooth in SMOOTHNESS:
        for width in WIDTHS:
            score, heights, covariance = _deviation(places, smooth, width * math.hypot(fit.blur_px, 0.3), normal, moment, power, freedom)
            if score > best:
                best, mean, spread = score, heights, covariance
    inverse = np.linalg.pinv(free)
    solved = inverse @ (data - lines @ mean)
    noise = max(power - float(moment @ mean), 0.0) / freedom
    by_lines = (inverse @ lines)[3]
    covariance = np.zeros((1 + len(places), 1 + len(places)))
    covariance[1:, 1:] = noise * spread
    covariance[0, 1:] = covariance[1:, 0] = -by_lines @ covariance[1:, 1:]
    covariance[0, 0] = noise * float(inverse[3] @ inverse[3]) + float(by_lines @ covariance[1:, 1:] @ by_lines)
    return FreeEdge(fit, places, mean / solved[1], float(solved[3] / solved[1]), covariance / solved[1] ** 2)


def _deviation(
    places: Array, smooth: float, width: float, normal: Array, moment: Array, power: float, freedom: int
) -> tuple[float, Array, Array]:
    """The most likely strength of a deviation of given smoothness and width.

    With the prior covariance A^2 K = A^2 B B^T the normal equations B^T N B = V diag(l) V^T part: each mode is shrunk by
    A^2 l / (1 + A^2 l), A^2 in units of the noise's variance, which the likelihood leaves free.

    Returns:
        Logarithm of the marginal likelihood up to a constant, the lines' heights, and their covariance over the noise's variance.
    """
    prior = np.exp(-0.5 * ((places[:, None] - places) / smooth) ** 2 - 0.25 * (places[:, None] ** 2 + places**2) / width**2)
    values, vectors = np.linalg.eigh(prior)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    strength, modes = np.linalg.eigh(root.T @ normal @ root)
    strength = np.maximum(strength, 0.0)
    along = modes.T @ (root.T @ moment)
    shrunk = STRENGTHS[:, None] / (1 + STRENGTHS[:, None] * strength)
    rest = np.maximum(power - (along**2 * shrunk).sum(axis=1), 1e-14 * power + 1e-300)
    scores = -0.5 * freedom * np.log(rest) - 0.5 * np.log1p(STRENGTHS[:, None] * strength).sum(axis=1)
    at = int(np.argmax(scores))
    basis = root @ modes
    return float(scores[at]), basis @ (along * shrunk[at]), (basis * shrunk[at]) @ basis.T

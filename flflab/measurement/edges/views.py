"""Transfer function from the edges in all bright fields of one frame: each view on its own, then
pooled.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.edges.esfr import esfr
from flflab.measurement.edges.fit import EdgeFit, EdgePixels, edge_pixels, fit_edge
from flflab.measurement.edges.free import OF_SKIRT, FreeEdge, free_forms, variance_along
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    bright_pixels,
    microlens_type_of,
    require_picture,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms

Array = npt.NDArray[np.float64]

MARGIN_PX = 2.0
FREQUENCIES = np.linspace(0.0, 0.5, 26)  # cycles/px
LEAST_SIDE = 0.1  # of a bright field's pixels on each side of the edge
LEAST_HEIGHT = 0.1  # of the bright side's light
# of a bright field's radius, standard deviation: beside a wider one neither black nor white is seen
WIDEST_BLUR = 0.5
WORST_RESIDUAL = 4.0  # of a pixel from its edge, in units of its noise
WORST_SHARE = 0.05  # of its height, where that is more
# standard deviations of chi squared by which views must differ to be less sure than they state
CLEARLY = 2.0
HIGHEST = 1.3  # contrast above it no edge has, whatever lights it
WITHIN = 0.4  # cycles/px up to which e-SFR is compared
APART = 0.02  # by which it may differ besides


@dataclass(frozen=True)
class EdgeCurve:
    """Transfer function along the edges' normal, blur and pixel together.

    Attributes:
        cycles_per_px: frequencies on the sensor, shape (K,).
        mtf: pooled over the views, shape (K,).
        uncertainty: standard uncertainty, what the fits state or, where they clearly scatter more,
            what their scatter shows, shape (K,).
        views: the single edges.
        lenses: which micro-image of the lattice each lies in.
        starved: how many of them sample their profile at too few phases.
        focal_length: of their microlenses, mm.
        skirt_uncertainty: what of ``uncertainty`` the unknown form of a skirt of flare makes, shape
            (K,).
        esfr: mean of the views' e-SFR (ISO 12233), nan where none has one, shape (K,).
        misfit: rms of what is left of the edges beyond noise, as a share of their height.
        saturated: how many pixels of bright fields were left out for it.
    """

    cycles_per_px: Array
    mtf: Array
    uncertainty: Array
    views: tuple[FreeEdge, ...]
    lenses: tuple[int, ...]
    starved: int
    focal_length: float
    skirt_uncertainty: Array
    esfr: Array
    misfit: float
    saturated: int

    @property
    def apart(self) -> float:
        """How far fit and e-SFR differ at most up to 0.4 cycles/px, beyond two uncertainties."""
        near = self.cycles_per_px <= WITHIN
        return float(np.nanmax(np.abs(self.mtf - self.esfr)[near] - 2 * self.uncertainty[near]))


def measure_edges_of_kinds(
    picture: npt.NDArray[np.generic], lattice: Lattice, camera: Camera, noise: SensorNoise
) -> tuple[tuple[EdgeCurve, ...], tuple[str, ...]]:
    """A curve for each kind of microlens, and why a kind gave none; arguments and errors as
    ``measure_edges``.
    """
    curves, reasons = list[EdgeCurve](), list[MeasurementError]()
    for focal in sorted(set(camera.array.focal_lengths)):
        try:
            curves.append(measure_edges(picture, lattice, camera, noise, focal))
        except MeasurementError as error:
            reasons.append(error)
    if not curves:
        raise reasons[0]
    return tuple(curves), tuple(str(reason) for reason in reasons)


def measure_edges(
    picture: npt.NDArray[np.generic],
    lattice: Lattice,
    camera: Camera,
    noise: SensorNoise,
    focal_length: float | None = None,
) -> EdgeCurve:
    """Measure the transfer function from every bright field that an edge crosses.

    Args:
        picture: DN, [row, col], in the camera's resolution.
        lattice: of the micro-images.
        camera: nominal.
        noise: of the sensor.
        focal_length: of the kind of microlens that is measured, mm; None: the central one's.

    Raises:
        MeasurementError: wrong shape, or no bright field with an edge in it.
    """
    values = require_picture(picture, camera, "edge")
    focal = float(central_smms(camera).focal) if focal_length is None else focal_length
    kind = np.ones(len(lattice.centres_px), dtype=np.bool_)
    if len(camera.array.focal_lengths) > 1:
        kind = microlens_type_of(lattice, camera) == focal
    pixels = bright_pixels(lattice, values.shape, MARGIN_PX, kind)
    if len(pixels.rows) == 0:
        raise MeasurementError(
            "edge: the micro-images have no bright field; a larger f-number or a sensor nearer the"
            " exit pupil gives one"
        )
    full = noise.saturated(values[pixels.rows, pixels.columns])
    pixels, saturated = pixels.kept(~full), int(np.count_nonzero(full))
    light = values[pixels.rows, pixels.columns] - noise.offset_dn
    fits: list[EdgeFit] = []
    seen: list[EdgePixels] = []
    lenses: list[int] = []
    shares: list[float] = []
    strange, blurred, faint = math.inf, math.inf, 0
    for lens in np.unique(pixels.lens):
        here = pixels.lens == lens
        low, high = np.quantile(light[here], [LEAST_SIDE / 2, 1 - LEAST_SIDE / 2])
        bright = float(np.mean(light[here] > (low + high) / 2))
        if not LEAST_SIDE < bright < 1 - LEAST_SIDE:
            continue
        noisy = math.sqrt(float(noise.variance(np.array([(low + high) / 2 + noise.offset_dn]))[0]))
        if high - low < LEAST_HEIGHT * high + 4 * noisy:
            faint += 1
            continue
        rows, columns = pixels.rows[here], pixels.columns[here]
        first, left = int(rows.min()), int(columns.min())
        mask = np.zeros(
            (int(rows.max()) - first + 1, int(columns.max()) - left + 1), dtype=np.bool_
        )
        mask[rows - first, columns - left] = True
        patch = values[first : first + mask.shape[0], left : left + mask.shape[1]]
        spread = np.sqrt(noise.variance(patch))
        try:
            found = fit_edge(patch, mask, spread)
        except MeasurementError:
            continue  # a field that an edge only brushes
        share = found.residual * float(np.median(spread)) / found.height
        if found.residual > WORST_RESIDUAL and share > WORST_SHARE:
            strange = min(strange, found.residual)
            continue
        if found.blur_px > WIDEST_BLUR * lattice.inside_radius_px:
            blurred = min(blurred, found.blur_px)
            continue
        fits.append(found)
        shares.append(share)
        seen.append(edge_pixels(patch, mask, spread)[0])
        lenses.append(int(lens))
    if not fits and blurred < math.inf:
        raise MeasurementError(
            f"edge: what crosses the bright fields is blurred by {blurred:.3g} px,"
            f" {WIDEST_BLUR * lattice.inside_radius_px:.3g} px are allowed in fields of their size,"
            " beside more neither black nor white is seen; check target and focus"
        )
    if not fits and strange < math.inf:
        raise MeasurementError(
            "edge: what crosses the bright fields is no straight edge between black and white, the"
            f" pixels depart from one by {strange:.1f} times their noise or more; check target and"
            " focus"
        )
    if not fits and faint:
        raise MeasurementError(
            f"edge: no bright field shows a contrast of {100 * LEAST_HEIGHT:g} % of the bright side"
            " and more than the noise between dark and bright; check target, light and exposure"
        )
    if not fits:
        raise MeasurementError(
            "edge: no bright field is crossed by an edge; move the target so that its edge lies"
            " before the camera"
        )
    views = free_forms(fits, seen)
    checks = [esfr(*one, FREQUENCIES) for one in zip(fits, seen, strict=True)]
    checks = [one for one in checks if np.isfinite(one).all()]
    left = [
        max(1 - fit.residual**-2, 0.0) * share**2 for fit, share in zip(fits, shares, strict=True)
    ]
    mtf, uncertainty = pooled(views, FREQUENCIES)
    if float(mtf.max()) > HIGHEST:
        raise MeasurementError(
            f"edge: what crosses the bright fields would have a contrast of {mtf.max():.2g}, no"
            f" edge between black and white has more than {HIGHEST:g}; check target and focus"
        )
    return EdgeCurve(
        FREQUENCIES,
        mtf,
        uncertainty,
        tuple(views),
        tuple(lenses),
        sum(fit.starved for fit in fits),
        focal,
        np.where(FREQUENCIES > 0, OF_SKIRT * abs(np.mean([view.skirt for view in views])), 0.0),
        np.mean(checks, axis=0) if checks else np.full(len(FREQUENCIES), np.nan),
        math.sqrt(float(np.mean(left))),
        saturated,
    )


def pooled(views: list[FreeEdge], cycles_per_px: Array) -> tuple[Array, Array]:
    """Transfer function of edges fitted together and its standard uncertainty, each of shape
    (K,).
    """
    curves, doubts, slopes = (
        np.array(part)
        for part in zip(*(view.mtf_and_slopes(cycles_per_px) for view in views), strict=True)
    )
    weights = 1 / np.maximum(doubts, 1e-9) ** 2
    weights /= weights.sum(axis=0)
    mean, freedom = (weights * curves).sum(axis=0), max(len(views) - 1, 1)
    own = 1 / (1 / np.maximum(doubts, 1e-9) ** 2).sum(axis=0)
    chi2 = (weights * (curves - mean) ** 2).sum(axis=0) / own / freedom
    growth = np.where(chi2 > 1 + CLEARLY * math.sqrt(2 / freedom), chi2, 1.0)
    shared = variance_along((weights[..., None] * slopes).sum(axis=0), views[0].lines_covariance)
    skirt = float(np.mean([view.skirt for view in views]))
    form = np.where(cycles_per_px > 0, OF_SKIRT * skirt, 0.0)
    return mean, np.sqrt(own * growth + shared + form**2)

"""Transfer function from the edges in all bright fields of one frame: each view on its own, then
pooled.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.edges.fit import EdgeFit, EdgePixels, edge_pixels, fit_edge
from flflab.measurement.edges.free import FreeEdge, free_forms, variance_along
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    bright_pixels,
    require_picture,
    same_type_as_central,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]

MARGIN_PX = 2.0
FREQUENCIES = np.linspace(0.0, 0.5, 26)  # cycles/px
LEAST_SIDE = 0.1  # of a bright field's pixels on each side of the edge
LEAST_STEP = 0.3  # of the brightest field's light
LEAST_HEIGHT = 0.5  # of the bright side's light: the target is black and white
# of a bright field's radius, standard deviation: beside a wider one neither black nor white is seen
WIDEST_BLUR = 0.5
WORST_RESIDUAL = 4.0  # of a pixel from its edge, in units of its noise
# standard deviations of chi squared by which views must differ to be less sure than they state
CLEARLY = 2.0


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
    """

    cycles_per_px: Array
    mtf: Array
    uncertainty: Array
    views: tuple[FreeEdge, ...]
    lenses: tuple[int, ...]
    starved: int


def measure_edges(
    picture: npt.NDArray[np.generic], lattice: Lattice, camera: Camera, noise: SensorNoise
) -> EdgeCurve:
    """Measure the transfer function from every bright field that an edge crosses.

    Args:
        picture: DN, [row, col], in the camera's resolution.
        lattice: of the micro-images.
        camera: nominal; of several kinds of microlenses only those like the central one are used.
        noise: of the sensor.

    Raises:
        MeasurementError: wrong shape, or no bright field with an edge in it.
    """
    values = require_picture(picture, camera, "edge")
    pixels = bright_pixels(lattice, values.shape, MARGIN_PX, same_type_as_central(lattice, camera))
    if len(pixels.rows) == 0:
        raise MeasurementError(
            "edge: the micro-images have no bright field; a larger f-number or a sensor nearer the"
            " exit pupil gives one"
        )
    pixels = pixels.kept(~noise.saturated(values[pixels.rows, pixels.columns]))
    light = values[pixels.rows, pixels.columns] - noise.offset_dn
    top = float(np.quantile(light, 0.99))
    fits: list[EdgeFit] = []
    seen: list[EdgePixels] = []
    lenses: list[int] = []
    strange = blurred = math.inf
    for lens in np.unique(pixels.lens):
        here = pixels.lens == lens
        bright = float(np.mean(light[here] > top / 2))
        if not (LEAST_SIDE < bright < 1 - LEAST_SIDE and np.ptp(light[here]) > LEAST_STEP * top):
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
        if found.residual > WORST_RESIDUAL or found.height < LEAST_HEIGHT * (
            found.dark + found.height - noise.offset_dn
        ):
            strange = min(strange, found.residual)
            continue
        if found.blur_px > WIDEST_BLUR * lattice.inside_radius_px:
            blurred = min(blurred, found.blur_px)
            continue
        fits.append(found)
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
    if not fits:
        raise MeasurementError(
            "edge: no bright field is crossed by an edge; move the target so that its edge lies"
            " before the camera"
        )
    views = free_forms(fits, seen)
    return EdgeCurve(
        FREQUENCIES,
        *pooled(views, FREQUENCIES),
        tuple(views),
        tuple(lenses),
        sum(fit.starved for fit in fits),
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
    return mean, np.sqrt(own * growth + shared)

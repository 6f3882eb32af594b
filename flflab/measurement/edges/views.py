"""Transfer function from the edges in all bright fields of one frame: each view on its own, then
pooled.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.edges.edge import Edge, fit_edge
from flflab.measurement.edges.esfr import esfr
from flflab.measurement.edges.spread import LineSpread, line_spread
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
FAINT = (
    f"no bright field shows a contrast of {100 * LEAST_HEIGHT:g} % of the bright side and more than"
    " the noise between dark and bright; check target, light and exposure"
)
STRANGE = (
    "what crosses the bright fields is no straight edge between black and white, the pixels depart"
    f" from one by more than {WORST_RESIDUAL:g} times their noise; check target and focus"
)
BLURRED = (
    f"what crosses the bright fields is blurred by more than {WIDEST_BLUR:g} of their radius,"
    " beside which neither black nor white is seen; check target and focus"
)
NO_EDGE = (
    "no bright field is crossed by an edge; move the target so that its edge lies before the camera"
)
HIGHEST = 1.3  # contrast above it no edge has, whatever lights it
WITHIN = 0.4  # cycles/px up to which e-SFR is compared
APART = 0.02  # by which it may differ besides


@dataclass(frozen=True)
class EdgeCurve:
    """Transfer function along the edges' normal, blur and pixel together.

    Attributes:
        cycles_per_px: frequencies on the sensor, shape (K,).
        mtf: of all views together, shape (K,).
        own: standard uncertainty, what the fit states or, where the views clearly scatter more,
            what their scatter shows, shape (K,).
        form: standard uncertainty for the unknown form of a skirt of flare, shape (K,).
        esfr: mean of the views' e-SFR (ISO 12233), nan where none has one, shape (K,).
        edges: the single edges.
        views: the line spread that each shows.
        lenses: which micro-image of the lattice each lies in.
        focal_length: of their microlenses, mm.
        misfit: rms of what is left of the edges beyond noise, as a share of their height.
        saturated: how many pixels of bright fields were left out for it.
    """

    cycles_per_px: Array
    mtf: Array
    own: Array
    form: Array
    esfr: Array
    edges: tuple[Edge, ...]
    views: tuple[LineSpread, ...]
    lenses: tuple[int, ...]
    focal_length: float
    misfit: float
    saturated: int

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty, shape (K,)."""
        return np.hypot(self.own, self.form)

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
    edges, lenses, unfit = list[Edge](), list[int](), list[str]()
    for lens in np.unique(pixels.lens):
        here = pixels.lens == lens
        found = _field_edge(
            values, pixels.rows[here], pixels.columns[here], noise, lattice.inside_radius_px
        )
        if isinstance(found, Edge):
            edges.append(found)
            lenses.append(int(lens))
        elif found:
            unfit.append(found)
    if not edges:
        why = max(set(unfit), key=unfit.count) if unfit else NO_EDGE
        raise MeasurementError(f"edge: {why}")
    views = [line_spread([edge]) for edge in edges]
    mtf, own, form = pooled(edges, views, FREQUENCIES)
    if float(mtf.max()) > HIGHEST:
        raise MeasurementError(
            f"edge: what crosses the bright fields would have a contrast of {mtf.max():.2g}, no"
            f" edge between black and white has more than {HIGHEST:g}; check target and focus"
        )
    checks = [one for edge in edges if np.isfinite(one := esfr(edge, FREQUENCIES)).all()]
    return EdgeCurve(
        FREQUENCIES,
        mtf,
        own,
        form,
        np.mean(checks, axis=0) if checks else np.full(len(FREQUENCIES), np.nan),
        tuple(edges),
        tuple(views),
        tuple(lenses),
        focal,
        math.sqrt(float(np.mean([edge.misfit**2 for edge in edges]))),
        saturated,
    )


def _field_edge(
    values: Array,
    rows: npt.NDArray[np.int64],
    columns: npt.NDArray[np.int64],
    noise: SensorNoise,
    radius_px: float,
) -> Edge | str:
    """The edge that crosses a bright field, or why it is of no use; nothing to say of a field that
    no edge crosses.
    """
    light = values[rows, columns] - noise.offset_dn
    low, high = np.quantile(light, [LEAST_SIDE / 2, 1 - LEAST_SIDE / 2])
    if not LEAST_SIDE < float(np.mean(light > (low + high) / 2)) < 1 - LEAST_SIDE:
        return ""
    noisy = math.sqrt(float(noise.variance(np.array([(low + high) / 2 + noise.offset_dn]))[0]))
    if high - low < LEAST_HEIGHT * high + 4 * noisy:
        return FAINT
    first, left = int(rows.min()), int(columns.min())
    mask = np.zeros((int(rows.max()) - first + 1, int(columns.max()) - left + 1), dtype=np.bool_)
    mask[rows - first, columns - left] = True
    patch = values[first : first + mask.shape[0], left : left + mask.shape[1]]
    try:
        found = fit_edge(patch, mask, np.sqrt(noise.variance(patch)))
    except MeasurementError:
        return ""  # a field that an edge only brushes
    if found.residual > WORST_RESIDUAL and found.misfit > WORST_SHARE:
        return STRANGE
    return BLURRED if found.blur_px > WIDEST_BLUR * radius_px else found


def pooled(
    edges: list[Edge], views: list[LineSpread], cycles_per_px: Array
) -> tuple[Array, Array, Array]:
    """Transfer function of all edges together; its standard uncertainty, what the fit states or,
    where the edges alone clearly scatter more, what their scatter shows; and what the unknown form
    of a skirt adds to it; shape (K,) each.
    """
    together = line_spread(edges)
    mtf, own = together.mtf(cycles_per_px)
    alone, doubts = np.array([view.mtf(cycles_per_px) for view in views]).swapaxes(0, 1)
    weights = 1 / np.maximum(doubts, 1e-9) ** 2
    freedom = max(len(views) - 1, 1)
    mean = (weights * alone).sum(axis=0) / weights.sum(axis=0)
    chi2 = (weights * (alone - mean) ** 2).sum(axis=0) / freedom
    growth = np.where(chi2 > 1 + CLEARLY * math.sqrt(2 / freedom), chi2, 1.0)
    return mtf, own * np.sqrt(growth), together.form(cycles_per_px)

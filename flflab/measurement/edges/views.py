"""The edges in all bright fields of one frame, of each kind of microlens by itself."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.edges.curve import EdgeCurve, curve_of
from flflab.measurement.edges.edge import Edge, fit_edge
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.registration import (
    bright_pixels,
    microlens_type_of,
    require_picture,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera

Array = npt.NDArray[np.float64]

MARGIN_PX = 2.0
LEAST_SIDE = 0.1  # of a bright field's pixels on each side of the edge
LEAST_HEIGHT = 0.1  # of the bright side's light
# of a bright field's radius, standard deviation: beside a wider one neither black nor white is seen
WIDEST_BLUR = 0.5
WORST_MISFIT = 0.2  # of the edge's height, by which pixels depart from it beyond noise
FAINT = (
    f"no bright field shows a contrast of {100 * LEAST_HEIGHT:g} % of the bright side and more than"
    " the noise between dark and bright; check target, light and exposure"
)
STRANGE = (
    "what crosses the bright fields is no straight edge between black and white, the pixels depart"
    f" from one by more than {100 * WORST_MISFIT:g} % of its height; check target and focus"
)
BLURRED = (
    f"what crosses the bright fields is blurred by more than {WIDEST_BLUR:g} of their radius,"
    " beside which neither black nor white is seen; check target and focus"
)
NO_EDGE = (
    "no bright field is crossed by an edge; move the target so that its edge lies before the camera"
)
HIGHEST = 1.3  # contrast above it no edge has, whatever lights it


@dataclass(frozen=True)
class EdgeViews:
    """What the views through one kind of microlens show of an edge.

    Attributes:
        curve: the transfer function.
        lenses: which micro-image of the lattice each of its edges lies in.
        focal_length: of the microlenses, mm.
    """

    curve: EdgeCurve
    lenses: tuple[int, ...]
    focal_length: float


def measure_edges(
    picture: npt.NDArray[np.generic], lattice: Lattice, camera: Camera, noise: SensorNoise
) -> tuple[tuple[EdgeViews, ...], tuple[str, ...]]:
    """Measure the transfer function from every bright field that an edge crosses.

    Args:
        picture: DN, [row, col], in the camera's resolution.
        lattice: of the micro-images.
        camera: nominal.
        noise: of the sensor.

    Returns:
        A curve for each kind of microlens, and why a kind gave none.

    Raises:
        MeasurementError: wrong shape, or no bright field with an edge in it.
    """
    values, kinds = require_picture(picture, camera, "edge"), set(camera.array.focal_lengths)
    focal = microlens_type_of(lattice, camera)
    found, reasons = list[EdgeViews](), list[MeasurementError]()
    for one in sorted(kinds):
        try:
            found.append(_of_kind(values, lattice, focal == one, noise, one))
        except MeasurementError as error:
            reasons.append(error)
    if not found:
        raise reasons[0]
    return tuple(found), tuple(str(reason) for reason in reasons)


def _of_kind(
    values: Array,
    lattice: Lattice,
    kind: npt.NDArray[np.bool_],
    noise: SensorNoise,
    focal_length: float,
) -> EdgeViews:
    pixels = bright_pixels(lattice, values.shape, MARGIN_PX, kind)
    if len(pixels.rows) == 0:
        raise MeasurementError(
            "edge: the micro-images have no bright field; a larger f-number or a sensor nearer the"
            " exit pupil gives one"
        )
    pixels = pixels.kept(~noise.saturated(values[pixels.rows, pixels.columns]))
    edges, unfit = dict[int, Edge](), list[str]()
    for lens in np.unique(pixels.lens):
        here = pixels.lens == lens
        found = _field_edge(
            values, pixels.rows[here], pixels.columns[here], noise, lattice.inside_radius_px
        )
        if isinstance(found, Edge):
            edges[int(lens)] = found
        elif found:
            unfit.append(found)
    if not edges:
        raise MeasurementError(f"edge: {max(unfit, key=unfit.count, default=NO_EDGE)}")
    curve = curve_of(list(edges.values()))
    if float(curve.mtf.max()) > HIGHEST:
        raise MeasurementError(
            "edge: what crosses the bright fields would have a contrast of"
            f" {curve.mtf.max():.2g}, no edge between black and white has more than {HIGHEST:g};"
            " check target and focus"
        )
    return EdgeViews(curve, tuple(edges), focal_length)


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
    if found.misfit > WORST_MISFIT:
        return STRANGE
    return BLURRED if found.blur_px > WIDEST_BLUR * radius_px else found

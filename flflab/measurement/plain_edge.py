"""An ordinary picture of a slanted edge, no microlenses: the transfer function along its normal."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.files.raw import RawPicture
from flflab.files.sensor_picture import SensorPicture
from flflab.measurement.as_read import as_read
from flflab.measurement.edges.curve import curve_of
from flflab.measurement.edges.edge import fit_edge
from flflab.measurement.in_json import points_json, result_json

HALF_PX = 150  # of the square round the edge's middle that is measured
COARSE = 200  # pixels a side in which the edge is looked for


def measure_plain_edge(picture: npt.NDArray[Any] | RawPicture | SensorPicture) -> dict[str, Any]:
    """Measure the transfer function from a picture of one straight edge.

    A square of 300 pixels round the point of the edge nearest the picture's middle is measured.

    Args:
        picture: [row, col], linear in light.

    Returns:
        ``mtf`` (each point with its e-SFR as a check), ``edge``, ``picture``, ``remarks`` and
        ``remark_codes``; JSON's own types.

    Raises:
        MeasurementError: there is no straight edge in the picture.
    """
    mosaic, remarks = as_read(picture, None, "edge", None)
    values, noise = mosaic.even()
    corner, patch = _around_the_edge(np.asarray(values, dtype=np.float64))
    full = np.asarray(noise.saturated(patch), dtype=np.bool_)
    edge = fit_edge(patch, ~full, np.sqrt(noise.variance(patch)))
    curve = curve_of([edge])
    remarks += curve.remarks
    seen = {
        "mtf": points_json(
            cycles_per_px=curve.cycles_per_px,
            contrast=curve.mtf,
            uncertainty=curve.uncertainty,
            esfr=curve.esfr,
        ),
        "edge": {
            "angle_deg": math.degrees(edge.angle),
            "place_px": edge.place_px + corner,
            "skirt_share": curve.skirt,
            "pixels": len(edge.pixels.values),
        },
    }
    return result_json(seen, remarks, np.mean(full), curve.misfit, noise.offset_dn)


def _around_the_edge(
    values: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Top-left corner (x, y) of a square round the edge, and its pixels: looked for in means."""
    step = max(1, min(values.shape) // COARSE)
    rows, columns = (size // step for size in values.shape)
    coarse = values[: rows * step, : columns * step].reshape(rows, step, columns, step)
    middle = (fit_edge(coarse.mean(axis=(1, 3))).place_px + 0.5) * step
    size = np.array([values.shape[1], values.shape[0]])
    corner = np.clip(middle.astype(np.int64) - HALF_PX, 0, np.maximum(size - 2 * HALF_PX, 0))
    end = corner + 2 * HALF_PX
    return corner, values[corner[1] : end[1], corner[0] : end[0]]

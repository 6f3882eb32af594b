"""An ordinary picture of a slanted edge, no microlenses: the transfer function along its normal."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.files.raw import RawPicture
from flflab.files.sensor_picture import SensorPicture
from flflab.measurement.as_read import as_read
from flflab.measurement.edges.edge import fit_edge
from flflab.measurement.edges.esfr import esfr
from flflab.measurement.edges.spread import line_spread
from flflab.measurement.edges.views import APART, FREQUENCIES, WITHIN
from flflab.remark import Remark

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
    view = line_spread([edge])
    mean, doubt = view.with_form(FREQUENCIES)
    check = esfr(edge, FREQUENCIES)
    apart = (np.abs(mean - check) - 2 * doubt)[FREQUENCIES <= WITHIN]
    if np.isfinite(check).all() and float(apart.max()) > APART:
        remarks.append(
            Remark(
                "edges-unlike-esfr",
                f"fit and e-SFR (ISO 12233) part by {float(apart.max()):.2g} more than stated",
            )
        )
    if edge.starved:
        remarks.append(
            Remark(
                "edges-starved",
                f"the edge, at {math.degrees(edge.angle):.2f} deg, samples its profile at too few"
                " places in a pixel; turn the target by a degree",
            )
        )
    return {
        "mtf": [
            {
                "cycles_per_px": float(u),
                "contrast": float(one),
                "uncertainty": float(unsure),
                "esfr": float(beside) if math.isfinite(beside) else None,
            }
            for u, one, unsure, beside in zip(FREQUENCIES, mean, doubt, check, strict=True)
        ],
        "edge": {
            "angle_deg": math.degrees(edge.angle),
            "place_px": (edge.place_px + corner).tolist(),
            "skirt_share": view.skirt,
            "pixels": len(edge.pixels.values),
        },
        "picture": {
            "saturated_share": float(np.mean(full)),
            "misfit": edge.misfit,
            "offset_dn": noise.offset_dn,
        },
        "remarks": [remark.sentence for remark in remarks],
        "remark_codes": [remark.code for remark in remarks],
    }


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

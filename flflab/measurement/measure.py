"""One frame measured: what ``flflab measure --json`` says, from a picture, the camera and what the
target was.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, MeasurementError
from flflab.files.raw import RawPicture
from flflab.files.sensor_picture import SensorPicture
from flflab.measurement.as_read import as_read
from flflab.measurement.contrast.curve import fit_contrasts
from flflab.measurement.dots.scale import unlike_the_description
from flflab.measurement.dots.views import count_views
from flflab.measurement.edges.views import measure_edges
from flflab.measurement.in_json import result_json
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.measure_json import (
    contrast_json,
    dot_json,
    edge_json,
    lattice_json,
    views_contrast_json,
    views_edge_json,
)
from flflab.measurement.presence import require_blur_within, require_light
from flflab.measurement.sensor.mosaic import Mosaic
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.white import measure_blind, measure_described
from flflab.optics.camera import Camera
from flflab.optics.focus import sharp_vergence
from flflab.optics.resolution import central_smms
from flflab.remark import Remark
from flflab.targets import Bars, BarsAlongY, Chirp, Edge, FourDot, Target, White

WORTH_SAYING = 0.01  # of the light, misfit
# standard uncertainties of a lattice that only the camera's description says: of its origin, and of
# its pitch and turn, relative
NOMINAL_PX, NOMINAL = 3.0, 1e-3


def measure(
    picture: npt.NDArray[np.generic] | RawPicture | SensorPicture,
    camera: Camera | None = None,
    target: Target | None = None,
    distance: float | None = None,
    noise: SensorNoise | None = None,
    white: npt.NDArray[np.generic] | RawPicture | SensorPicture | None = None,
) -> dict[str, Any]:
    """Measure one frame.

    A white frame gives the lattice, of which only layout and rough pitch are taken from the camera.
    Another frame is measured on the lattice of the white one beside it, without one on the camera's
    nominal one, whose doubts it then has; a remark says so.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None. A raw one is measured
            above its black level, the filters of its mosaic as four sub-lattices.
        camera: nominal; None: a white picture of which no camera file is known.
        target: what stood there; None means white.
        distance: main lens to target, mm; None means where the camera is sharp.
        noise: of the sensor; None estimates it from the picture.
        white: a picture of a white target, taken as this one was; None: there is none.

    Returns:
        ``lattice``, ``dots``, ``mtf`` as in the contract of ``measure --json`` (pixels, (x, y); mm;
        None where there is no value), with the lattice's standard uncertainties, and ``remarks``,
        sentences, with their ``remark_codes``.

    Raises:
        InputError: a target this cannot measure, at all or without a camera, or no distance where
            one is needed.
        MeasurementError: the picture does not hold what was to be measured.
    """
    target = _measurable(White() if target is None else target, camera, white)
    if camera is None:
        return measure_blind(picture, noise).json()
    if isinstance(target, White):
        return measure_described(picture, camera, noise).json()
    mosaic, remarks = as_read(picture, camera, target.kind, noise)
    values, evened = mosaic.even()
    require_light(values, evened, target)
    away = _sharp_distance(camera) if distance is None else distance
    if white is None:
        lattice, remark = _nominal(camera)
        if isinstance(target, FourDot):
            require_blur_within(lattice, camera, away)
        shown = lattice_json(lattice)
        remarks.append(remark)
    else:
        beside = measure_described(white, camera, noise)
        lattice, shown = beside.lattice, beside.lattice_json()
        remarks += [Remark(one.code, f"white picture: {one.sentence}") for one in beside.remarks]
    try:
        result, more, misfit = _seen(mosaic, lattice, camera, target, away)
    except MeasurementError as error:
        if white is not None:
            raise
        raise MeasurementError(
            f"{error}; or the lattice is not where the camera file has it: name a white picture"
            " (--white)"
        ) from error
    remarks += more
    saturated = float(np.mean(evened.saturated(values)))
    if saturated > 0:
        remarks.append(
            Remark("saturated", f"{100 * saturated:.2g} % of the pixels are saturated and left out")
        )
    if misfit > WORTH_SAYING:
        remarks.append(
            Remark(
                "misfit",
                f"the picture departs from its model by {100 * misfit:.2g} % of the light beyond"
                " noise; stated uncertainties count it as it scatters from view to view",
            )
        )
    nothing = {"dots": list[Any](), "mtf": list[Any](), "mtf_by_view": list[Any]()}
    seen = {"lattice": shown} | nothing | result
    return result_json(seen, remarks, saturated, misfit, evened.offset_dn)


def _measurable(
    target: Target, camera: Camera | None, white: object
) -> White | FourDot | Bars | Edge:
    """The target, if it can be measured so."""
    if not isinstance(target, White | FourDot | Bars | Edge):
        kinds = ", ".join(kind.kind for kind in (White, FourDot, Bars, BarsAlongY, Chirp, Edge))
        raise InputError(f"measure: a {target.kind} target cannot be measured; allowed are {kinds}")
    if white is not None and isinstance(target, White):
        raise InputError(
            "measure: a white picture beside a white one; it belongs beside a picture of another"
            " target"
        )
    if camera is None and not isinstance(target, White):
        raise InputError(
            f"measure: a {target.kind} target without a camera; give the camera whose picture it"
            " is: only a white picture is measured without"
        )
    return target


def _seen(
    mosaic: Mosaic, lattice: Lattice, camera: Camera, target: FourDot | Bars | Edge, away: float
) -> tuple[dict[str, Any], list[Remark], float]:
    """What a lattice's micro-images show of a target: in JSON, remarks on it, and the misfit."""
    values, noise = mosaic.even()
    if isinstance(target, FourDot):
        dots = count_views(values, lattice, camera, target, away, noise)
        unlike = unlike_the_description(dots[0].scale, camera, away) if dots[0].scale else []
        remarks = [Remark("dots-unlike-camera", one) for one in unlike]
        return {"dots": [dot_json(one) for one in dots]}, remarks, max(one.misfit for one in dots)
    mtf, by_view = list[dict[str, Any]](), list[dict[str, Any]]()
    if isinstance(target, Edge):
        edges, reasons = measure_edges(values, lattice, camera, noise)
        remarks = list[Remark]()
        for edge in edges:
            mtf += edge_json(edge, camera, away)
            by_view += views_edge_json(edge, lattice, camera, away)
            views = f"the transfer function is that of {len(edge.lenses)} edges, along their normal"
            remarks += [Remark("edges", views), *edge.curve.remarks]
        remarks += [Remark("edges", reason) for reason in reasons]
        return {"mtf": mtf, "mtf_by_view": by_view}, remarks, max(e.curve.misfit for e in edges)
    curves, reasons = fit_contrasts(
        mosaic.values, lattice, camera, target, away, mosaic.noise, mosaic.gains
    )
    for curve in curves:
        mtf += contrast_json(curve, "y" if isinstance(target, BarsAlongY) else "x")
        by_view += views_contrast_json(curve, lattice)
    remarks = [Remark("contrast", reason) for reason in reasons]
    return {"mtf": mtf, "mtf_by_view": by_view}, remarks, max(curve.misfit for curve in curves)


def _nominal(camera: Camera) -> tuple[Lattice, Remark]:
    """The camera's nominal lattice, as sure as a description is of its bench, and a remark."""
    lattice = nominal_lattice(camera, 1.0)
    wider, turned = lattice.vectors_px.T.ravel(), (lattice.vectors_px.T @ [[0, 1], [-1, 0]]).ravel()
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = NOMINAL_PX**2 * np.eye(2)
    covariance[2:, 2:] = NOMINAL**2 * (np.outer(wider, wider) + np.outer(turned, turned))
    lattice = replace(
        lattice,
        covariance_px=covariance,
        origin_uncertainty_px=np.full(2, NOMINAL_PX),
        pitch_uncertainty_px=NOMINAL * lattice.pitch_px,
        angle_uncertainty=NOMINAL,
    )
    said = (
        "no white picture: the lattice is the camera's nominal one, not measured, and taken to be"
        f" known to {NOMINAL_PX:g} px and {100 * NOMINAL:g} % of its pitch; name a white picture"
        " (--white)"
    )
    return lattice, Remark("no-white", said)


def _sharp_distance(camera: Camera) -> float:
    vergence = float(sharp_vergence(central_smms(camera)))
    if not (math.isfinite(vergence) and vergence > 0):
        raise InputError(
            "measure: this camera is sharp at no real distance; give the target's distance"
        )
    return 1 / vergence

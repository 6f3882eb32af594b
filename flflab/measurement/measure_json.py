"""What ``flflab measure --json`` says, in JSON's own types: pixels (x, y), mm, None where there is
no value.
"""

import math
from typing import Any

import numpy as np

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.dots.views import DotViews
from flflab.measurement.edges.views import EdgeViews
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.focus import magnification
from flflab.optics.per_type import type_smms


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def lattice_json(lattice: Lattice) -> dict[str, Any]:
    """A lattice that no white picture shows, with its standard uncertainties."""
    return {
        "layout": lattice.layout,
        "pitch_px": lattice.pitch_px,
        "angle_deg": math.degrees(lattice.angle),
        "origin_px": lattice.origin_px.tolist(),
        "centres_px": lattice.centres_px.tolist(),
        "inside_radius_px": lattice.inside_radius_px,
        "outside_radius_px": lattice.outside_radius_px,
        "uncertainty": {
            "pitch_px": _number(lattice.pitch_uncertainty_px),
            "angle_deg": _number(math.degrees(lattice.angle_uncertainty)),
            "origin_px": [_number(value) for value in lattice.origin_uncertainty_px],
            "inside_radius_px": _number(lattice.inside_uncertainty_px),
            "outside_radius_px": _number(lattice.outside_uncertainty_px),
        },
    }


def dot_json(dot: DotViews) -> dict[str, Any]:
    """The views of a dot and its place."""
    return {
        "dot": dot.dot,
        "views": dot.views,
        "views_uncertain": dot.views_uncertain,
        "centres_px": dot.centres_px.tolist(),
        "position_mm": [_number(value) for value in dot.position_mm],
        "uncertainty_mm": [_number(value) for value in dot.uncertainty_mm],
        "u_own_mm": [_number(value) for value in dot.own_mm],
        "u_common_mm": {
            name: [_number(value) for value in part] for name, part in dot.by_cause_mm.items()
        },
        "dof": max(2 * dot.views - 3, 0),
        "at_limit_px": dot.at_limit_px.tolist(),
    }


def contrast_json(curve: ContrastCurve, along: str) -> list[dict[str, Any]]:
    """A point for each frequency, with the classic reading and its bias; ``along`` x or y."""
    return [
        {
            "along": along,
            "cycles_per_px": float(curve.cycles_per_px[k]),
            "cycles_per_mm": float(curve.cycles_per_mm[k]),
            "contrast": float(curve.contrast[k]),
            "uncertainty": float(curve.uncertainty[k]),
            "dof": _number(curve.freedom[k]),
            "microlens_focal_length_mm": curve.focal_length,
            "views": int(np.count_nonzero(np.isfinite(curve.views_contrast[:, k]))),
            "extremes": float(curve.extremes[k]),
            "classic": _number(curve.classic[k]),
            "classic_bias": _number(curve.classic_bias[k]),
        }
        for k in range(len(curve.cycles_per_mm))
    ]


def views_contrast_json(curve: ContrastCurve, lattice: Lattice) -> list[dict[str, Any]]:
    """Every view's own contrast, a point for each frequency that it sees."""
    return [
        {
            "centre_px": lattice.centres_px[lens].tolist(),
            "cycles_per_px": float(curve.cycles_per_px[k]),
            "cycles_per_mm": float(curve.cycles_per_mm[k]),
            "contrast": float(curve.views_contrast[v, k]),
            "uncertainty": float(curve.views_uncertainty[v, k]),
            "microlens_focal_length_mm": curve.focal_length,
        }
        for v, lens in enumerate(curve.views)
        for k in range(len(curve.cycles_per_mm))
        if math.isfinite(curve.views_contrast[v, k])
    ]


def edge_json(found: EdgeViews, camera: Camera, distance: float) -> list[dict[str, Any]]:
    """A point for each frequency along the edges' normal."""
    curve, scale = found.curve, _edge_scale(found, camera, distance)
    return [
        {
            "cycles_per_px": float(u),
            "cycles_per_mm": float(u) * scale,
            "contrast": float(mtf),
            "uncertainty": float(doubt),
            "u_own": float(alone),
            "u_common": {"form of the skirt": float(skirt)},
            "dof": max(len(curve.views) - 1, 1),
            "microlens_focal_length_mm": found.focal_length,
            "esfr": _number(check),
        }
        for u, mtf, doubt, alone, skirt, check in zip(
            curve.cycles_per_px, curve.mtf, curve.uncertainty, curve.own, curve.form,
            curve.esfr, strict=True,
        )
    ]  # fmt: skip


def views_edge_json(
    found: EdgeViews, lattice: Lattice, camera: Camera, distance: float
) -> list[dict[str, Any]]:
    """Every edge's own transfer, a point for each frequency."""
    curve, scale = found.curve, _edge_scale(found, camera, distance)
    return [
        {
            "centre_px": lattice.centres_px[lens].tolist(),
            "cycles_per_px": float(u),
            "cycles_per_mm": float(u) * scale,
            "contrast": float(mtf),
            "uncertainty": float(doubt),
            "microlens_focal_length_mm": found.focal_length,
        }
        for lens, view in zip(found.lenses, curve.views, strict=True)
        for u, mtf, doubt in zip(
            curve.cycles_per_px, *view.with_form(curve.cycles_per_px), strict=True
        )
    ]


def _edge_scale(found: EdgeViews, camera: Camera, distance: float) -> float:
    one = next(one for one in type_smms(camera) if float(one.focal) == found.focal_length)
    return abs(float(magnification(one, 1 / distance))) / camera.sensor.pixel

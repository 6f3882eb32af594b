"""What ``flflab measure --json`` says, in JSON's own types: pixels (x, y), mm, None where there is
no value.
"""

import math
from typing import Any

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.dots.views import DotViews
from flflab.measurement.edges.views import EdgeCurve
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.focus import magnification
from flflab.optics.resolution import central_smms


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
    }


def contrast_json(curve: ContrastCurve, lattice: Lattice) -> list[dict[str, Any]]:
    """A point for each frequency, with the classic reading, its bias, and every view's own
    contrast.
    """
    return [
        {
            "cycles_per_px": float(curve.cycles_per_px[k]),
            "cycles_per_mm": float(curve.cycles_per_mm[k]),
            "contrast": float(curve.contrast[k]),
            "uncertainty": float(curve.uncertainty[k]),
            "microlens_focal_length_mm": curve.focal_length,
            "extremes": float(curve.extremes[k]),
            "classic": _number(curve.classic[k]),
            "classic_bias": _number(curve.classic_bias[k]),
            "views": [
                {
                    "centre_px": lattice.centres_px[lens].tolist(),
                    "contrast": float(contrast),
                    "uncertainty": float(doubt),
                }
                for lens, contrast, doubt in zip(
                    curve.views,
                    curve.views_contrast[:, k],
                    curve.views_uncertainty[:, k],
                    strict=True,
                )
                if math.isfinite(contrast)
            ],
        }
        for k in range(len(curve.cycles_per_mm))
    ]


def edge_json(curve: EdgeCurve, camera: Camera, distance: float) -> list[dict[str, float]]:
    """A point for each frequency along the edges' normal."""
    scale = float(magnification(central_smms(camera), 1 / distance)) / camera.sensor.pixel
    return [
        {
            "cycles_per_px": float(u),
            "cycles_per_mm": float(u) * scale,
            "contrast": float(mtf),
            "uncertainty": float(doubt),
        }
        for u, mtf, doubt in zip(curve.cycles_per_px, curve.mtf, curve.uncertainty, strict=True)
    ]

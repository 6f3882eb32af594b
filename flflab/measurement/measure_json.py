"""What ``flflab measure --json`` says of a lattice, dots and curves: pixels (x, y), mm."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.measurement.contrast.curve import ContrastCurve
from flflab.measurement.dots.views import DotViews
from flflab.measurement.edges.views import EdgeViews
from flflab.measurement.in_json import points_json
from flflab.measurement.lattice.lattice import Lattice
from flflab.optics.camera import Camera
from flflab.optics.focus import magnification
from flflab.optics.per_type import type_smms

Array = npt.NDArray[np.float64]


def lattice_json(lattice: Lattice) -> dict[str, Any]:
    """A lattice that no white picture shows, with its standard uncertainties."""
    return {
        "layout": lattice.layout,
        "pitch_px": lattice.pitch_px,
        "angle_deg": math.degrees(lattice.angle),
        "origin_px": lattice.origin_px,
        "centres_px": lattice.centres_px,
        "inside_radius_px": lattice.inside_radius_px,
        "outside_radius_px": lattice.outside_radius_px,
        "uncertainty": {
            "pitch_px": lattice.pitch_uncertainty_px,
            "angle_deg": math.degrees(lattice.angle_uncertainty),
            "origin_px": lattice.origin_uncertainty_px,
            "inside_radius_px": lattice.inside_uncertainty_px,
            "outside_radius_px": lattice.outside_uncertainty_px,
        },
    }


def dot_json(dot: DotViews) -> dict[str, Any]:
    """The views of a dot and its place."""
    return {
        "dot": dot.dot,
        "views": dot.views,
        "views_uncertain": dot.views_uncertain,
        "centres_px": dot.centres_px,
        "position_mm": dot.position_mm,
        "uncertainty_mm": dot.uncertainty_mm,
        "u_own_mm": dot.own_mm,
        "u_common_mm": dot.by_cause_mm,
        "dof": max(2 * dot.views - 3, 0),
        "at_limit_px": dot.at_limit_px,
    }


def contrast_json(curve: ContrastCurve, along: str) -> list[dict[str, Any]]:
    """A point for each frequency, with the classic reading and its bias; ``along`` x or y."""
    return points_json(
        along=along,
        cycles_per_px=curve.cycles_per_px,
        cycles_per_mm=curve.cycles_per_mm,
        contrast=curve.contrast,
        uncertainty=curve.uncertainty,
        dof=curve.freedom,
        microlens_focal_length_mm=curve.focal_length,
        views=np.isfinite(curve.views_contrast).sum(axis=0),
        extremes=curve.extremes,
        classic=curve.classic,
        classic_bias=curve.classic_bias,
    )


def edge_json(found: EdgeViews, camera: Camera, distance: float) -> list[dict[str, Any]]:
    """A point for each frequency along the edges' normal."""
    curve = found.curve
    return points_json(
        cycles_per_px=curve.cycles_per_px,
        cycles_per_mm=_cycles_per_mm(found, camera, distance),
        contrast=curve.mtf,
        uncertainty=curve.uncertainty,
        u_own=curve.own,
        u_common=[{"form of the skirt": one} for one in curve.form],
        dof=max(len(found.lenses) - 1, 1),
        microlens_focal_length_mm=found.focal_length,
        esfr=curve.esfr,
    )


def views_contrast_json(curve: ContrastCurve, lattice: Lattice) -> list[dict[str, Any]]:
    """Every view's own contrast, a point for each frequency that it sees."""
    centres, contrasts = lattice.centres_px[curve.views], curve.views_contrast
    per_px, per_mm, doubts = curve.cycles_per_px, curve.cycles_per_mm, curve.views_uncertainty
    return _by_view(centres, (per_px, per_mm), contrasts, doubts, curve.focal_length)


def views_edge_json(
    found: EdgeViews, lattice: Lattice, camera: Camera, distance: float
) -> list[dict[str, Any]]:
    """Every edge's own transfer, a point for each frequency."""
    centres, curve = lattice.centres_px[list(found.lenses)], found.curve
    frequencies = curve.cycles_per_px, _cycles_per_mm(found, camera, distance)
    contrasts, doubts = curve.views_mtf, curve.views_uncertainty
    return _by_view(centres, frequencies, contrasts, doubts, found.focal_length)


def _by_view(
    centres_px: Array,
    frequencies: tuple[Array, Array],
    contrasts: Array,
    uncertainties: Array,
    focal_length: float,
) -> list[dict[str, Any]]:
    points = list[dict[str, Any]]()
    for centre, contrast, uncertainty in zip(centres_px, contrasts, uncertainties, strict=True):
        seen = np.isfinite(contrast)
        points += points_json(
            centre_px=[centre] * np.count_nonzero(seen),
            cycles_per_px=frequencies[0][seen],
            cycles_per_mm=frequencies[1][seen],
            contrast=contrast[seen],
            uncertainty=uncertainty[seen],
            microlens_focal_length_mm=focal_length,
        )
    return points


def _cycles_per_mm(found: EdgeViews, camera: Camera, distance: float) -> Array:
    """Frequencies on the target by the camera's magnification."""
    one = next(one for one in type_smms(camera) if float(one.focal) == found.focal_length)
    scale = abs(float(magnification(one, 1 / distance))) / camera.sensor.pixel
    return found.curve.cycles_per_px * scale

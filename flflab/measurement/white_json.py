"""What ``flflab measure --json`` says of a white picture: pixels, (x, y)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.measurement.in_json import points_json
from flflab.measurement.lattice.find import pitch_and_angle
from flflab.measurement.lattice.grid import by_vectors
from flflab.measurement.lattice.kernel import LIGHT, SOFTER, WIDER, X, Y
from flflab.measurement.lattice.types import Types
from flflab.measurement.lattice.white_picture import WhitePicture
from flflab.measurement.lattice.with_camera import CameraWhite
from flflab.optics.camera import Camera
from flflab.optics.per_type import type_smms

Array = npt.NDArray[np.float64]

KNOWN = 0.05  # of the outside radius: a radius less sure than this was not seen


@dataclass(frozen=True)
class LatticeFigures:
    """Pitch, angle and origin with standard uncertainties; px, rad.

    Attributes:
        middle: index of the micro-image nearest the picture's middle, shape (2,).
        values: pitch, angle, origin x, y; shape (4,).
        own: uncertainties by how micro-images scatter, shape (4,).
        common: by what counts as their centre and as the straight lattice, shape (4,).
    """

    middle: npt.NDArray[np.int64]
    values: Array
    own: Array
    common: Array


def figures_of(white: WhitePicture, shape: tuple[int, ...]) -> LatticeFigures:
    """Pitch, angle and the origin nearest the middle of a picture of this shape."""
    grid = white.grid
    centre = (np.array([shape[1], shape[0]]) - 1) / 2
    seen = np.flatnonzero(white.found)
    near = seen[int(np.argmin(np.hypot(*(white.values[seen, :2] - centre).T)))]
    middle = white.indices[near]
    pitch, angle = pitch_and_angle(grid.layout, grid.vectors_px)
    i, j = (float(one) for one in middle)
    to_origin = np.array([[1, 0, i, 0, j, 0], [0, 1, 0, i, 0, j]], dtype=np.float64)
    moved = np.concatenate([by_vectors(grid.layout, grid.vectors_px), to_origin])
    own, common = (
        np.sqrt(np.diag(moved @ one @ moved.T)) for one in (grid.covariance_px, grid.common_px)
    )
    origin = grid.straight(middle[None])[0]
    return LatticeFigures(middle, np.array([pitch, angle, *origin]), own, common)


def white_lattice_json(
    white: WhitePicture, types: Types, shape: tuple[int, ...], behind: CameraWhite | None
) -> dict[str, Any]:
    """The lattice, the origin being the micro-image nearest the middle of a picture of this shape,
    and what a camera's shape tells besides: pitch and radii of chief rays.
    """
    grid, figures = white.grid, figures_of(white, shape)
    radius, softness = sizes_of(white)
    columns = np.stack([radius, softness, white.values[:, LIGHT]], axis=1)[white.whole]
    of_type = types.of_each[white.whole]
    medians = np.array([np.median(columns[of_type == k], axis=0) for k in range(types.count)])
    radii = {"inside_radius_px": None, "outside_radius_px": None}
    sure = _by_name(np.hypot(figures.own, figures.common)) | {
        "u_own": _by_name(figures.own),
        "u_common": {"definition": _by_name(figures.common)},
        "dof": grid.freedom,
    }
    if behind is not None:
        one = behind.lattice
        radii = {
            "chief_pitch_px": one.pitch_px,
            "inside_radius_px": one.inside_radius_px,
            "outside_radius_px": one.outside_radius_px,
        }
        sure |= {
            "chief_pitch_px": one.pitch_uncertainty_px,
            "inside_radius_px": one.inside_uncertainty_px,
            "outside_radius_px": one.outside_uncertainty_px,
        }
    return radii | {
        "layout": grid.layout,
        "pitch_px": figures.values[0],
        "angle_deg": math.degrees(figures.values[1]),
        "origin_px": figures.values[2:],
        "vectors_px": grid.vectors_px.T,
        "residual_px": grid.residual_px,
        "scatter_px": grid.scatter_px,
        "centres_px": white.values[:, :2],
        "radius_px": white.profile.radius,
        "softness_px": white.profile.softness,
        "types": points_json(
            type=np.arange(types.count),
            count=np.bincount(of_type, minlength=types.count),
            radius_px=medians[:, 0],
            softness_px=medians[:, 1],
            light=medians[:, 2],
        ),
        "distortion": {"degree": grid.degree, "bend_px": grid.bend_px},
        "uncertainty": sure,
    }


def micro_images_json(
    white: WhitePicture,
    types: Types,
    shape: tuple[int, ...],
    camera: Camera | None,
    behind: CameraWhite | None,
) -> list[dict[str, Any]]:
    """Every micro-image; with a camera also its bright and total radius, as measured and by the
    camera's description.
    """
    own = np.sqrt(np.einsum("nkk->nk", white.spread.covariance))
    common, (radius, softness) = white.definition_px, sizes_of(white)
    uncertainty: dict[str, Any] = {
        "centre_px": np.hypot(own[:, [X, Y]], common),
        "radius_px": own[:, WIDER],
        "u_own": points_json(centre_px=own[:, [X, Y]]),
        "u_common": {"definition": {"centre_px": common}},
    }
    more: dict[str, Any] = {"inside_radius_px": None, "outside_radius_px": None}
    if camera is not None and behind is not None:
        radii, doubts = measured_radii(behind)
        more = _both(radii) | {"model": points_json(**_both(nominal_radii(camera, behind.kind)))}
        uncertainty |= _both(doubts)
    return points_json(
        index=white.indices - figures_of(white, shape).middle,
        seen=white.found,
        whole=white.whole,
        centre_px=white.values[:, :2],
        light=white.values[:, LIGHT],
        light_uncertainty=own[:, LIGHT],
        radius_px=radius,
        softness_px=softness,
        type=types.of_each,
        uncertainty=points_json(**uncertainty),
        **more,
    )


def sizes_of(white: WhitePicture) -> tuple[Array, Array]:
    """Radius at half light and softness of each micro-image, px, shape (n,)."""
    profile = white.profile
    return (
        profile.radius + white.values[:, WIDER],
        profile.softness * np.exp(white.values[:, SOFTER]),
    )


def measured_radii(behind: CameraWhite) -> tuple[Array, Array]:
    """Radii of bright and total field of each micro-image and their standard uncertainties, px,
    shape (n, 2); nan where a micro-image does not show them.
    """
    large, small = behind.radii_px.T
    radii = np.stack([np.abs(large - small), large + small], axis=1)
    by = np.array([[1.0, -1.0], [1.0, 1.0]])
    spreads = by @ behind.radii_covariance_px @ by.T
    doubts = np.sqrt(np.maximum(np.einsum("nkk->nk", spreads), 0.0))
    known = behind.white.found & (doubts.max(axis=1) < KNOWN * behind.lattice.outside_radius_px)
    radii[~known] = doubts[~known] = math.nan
    return radii, doubts


def nominal_radii(camera: Camera, kind: npt.NDArray[np.int64]) -> Array:
    """Radii of bright and total field of microlenses of these kinds by a camera's description, px,
    shape (n, 2).
    """
    focal = np.asarray(camera.array.focal_lengths)[kind]
    radii = np.full((len(focal), 2), math.nan)
    for smms in type_smms(camera):
        radii[focal == float(smms.focal)] = float(smms.inside_radius), float(smms.outside_radius)
    return radii / camera.sensor.pixel


def _both(radii: Array) -> dict[str, Array]:
    return {"inside_radius_px": radii[:, 0], "outside_radius_px": radii[:, 1]}


def _by_name(values: Array) -> dict[str, Any]:
    """Pitch, angle and origin as ``LatticeFigures`` has them."""
    return {
        "pitch_px": values[0],
        "angle_deg": math.degrees(values[1]),
        "origin_px": values[2:],
    }

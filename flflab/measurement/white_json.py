"""What ``flflab measure --json`` says of a white picture: pixels, (x, y)."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

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


def white_lattice_json(white: WhitePicture, types: Types, shape: tuple[int, ...]) -> dict[str, Any]:
    """The lattice and every micro-image, the origin being the one nearest the picture's middle."""
    grid, figures = white.grid, figures_of(white, shape)
    of_type = types.of_each[white.whole]
    wider, softer = white.values[:, WIDER], white.values[:, SOFTER]
    radius, softness = white.profile.radius + wider, white.profile.softness * np.exp(softer)
    light = white.values[white.whole, LIGHT]
    kinds = [
        {
            "type": k,
            "count": int(np.count_nonzero(of_type == k)),
            "radius_px": float(np.median(radius[white.whole][of_type == k])),
            "softness_px": float(np.median(softness[white.whole][of_type == k])),
            "light": float(np.median(light[of_type == k])),
        }
        for k in range(types.count)
    ]
    return {
        "layout": grid.layout,
        "pitch_px": float(figures.values[0]),
        "angle_deg": math.degrees(float(figures.values[1])),
        "origin_px": figures.values[2:].tolist(),
        "vectors_px": grid.vectors_px.T.tolist(),
        "residual_px": grid.residual_px,
        "scatter_px": grid.scatter_px,
        "centres_px": white.values[:, :2].tolist(),
        "inside_radius_px": None,
        "outside_radius_px": None,
        "radius_px": white.profile.radius,
        "softness_px": white.profile.softness,
        "types": kinds,
        "distortion": {"degree": grid.degree, "bend_px": grid.bend_px},
        "uncertainty": _by_name(np.hypot(figures.own, figures.common))
        | {
            "u_own": _by_name(figures.own),
            "u_common": {"definition": _by_name(figures.common)},
            "dof": grid.freedom,
        },
        "micro_images": _micro_images(white, types, figures.middle, radius, softness),
    }


def _by_name(values: Array) -> dict[str, Any]:
    pitch, angle, *origin = (float(one) for one in values)
    return {"pitch_px": pitch, "angle_deg": math.degrees(angle), "origin_px": origin}


def _micro_images(
    white: WhitePicture,
    types: Types,
    middle: npt.NDArray[np.int64],
    radius: Array,
    softness: Array,
) -> list[dict[str, Any]]:
    own = np.sqrt(np.einsum("nkk->nk", white.spread.covariance))
    centre = np.hypot(own[:, [X, Y]], white.definition_px)
    return [
        {
            "index": (white.indices[n] - middle).tolist(),
            "seen": bool(white.found[n]),
            "whole": bool(white.whole[n]),
            "centre_px": white.values[n, :2].tolist(),
            "light": float(white.values[n, LIGHT]),
            "light_uncertainty": float(own[n, LIGHT]),
            "radius_px": float(radius[n]),
            "softness_px": float(softness[n]),
            "type": int(types.of_each[n]),
            "inside_radius_px": None,
            "outside_radius_px": None,
            "uncertainty": {
                "centre_px": centre[n].tolist(),
                "radius_px": float(own[n, WIDER]),
                "u_own": {"centre_px": own[n, [X, Y]].tolist()},
                "u_common": {"definition": {"centre_px": white.definition_px}},
            },
        }
        for n in range(len(white.indices))
    ]


def described_lattice_json(
    lattice: dict[str, Any], found: CameraWhite, camera: Camera
) -> dict[str, Any]:
    """The same with what a camera's shape tells besides: pitch of chief rays, bright and total
    radii, measured and by the camera's description.

    Args:
        lattice: see ``white_lattice_json``.
        found: measured with the camera's file.
        camera: as described.
    """
    one = found.lattice
    sure = {
        "chief_pitch_px": one.pitch_uncertainty_px,
        "inside_radius_px": one.inside_uncertainty_px,
        "outside_radius_px": one.outside_uncertainty_px,
    }
    large, small = found.radii_px.T
    by = np.array([[1.0, -1.0], [1.0, 1.0]])
    spreads = by @ found.radii_covariance_px @ by.T
    doubts = np.sqrt(np.maximum(np.einsum("nkk->nk", spreads), 0.0))
    radii = np.stack([np.abs(large - small), large + small], axis=1)
    known = found.white.found & (doubts.max(axis=1) < KNOWN * one.outside_radius_px)
    model = nominal_radii(camera, found.kind)
    each = [
        before
        | _both(radii[n], bool(known[n]))
        | {"uncertainty": before["uncertainty"] | _both(doubts[n], bool(known[n]))}
        | {"model": _both(model[n], True)}
        for n, before in enumerate(lattice["micro_images"])
    ]
    return lattice | {
        "chief_pitch_px": one.pitch_px,
        "inside_radius_px": one.inside_radius_px,
        "outside_radius_px": one.outside_radius_px,
        "uncertainty": lattice["uncertainty"] | sure,
        "micro_images": each,
    }


def _both(radii: Array, known: bool) -> dict[str, float | None]:
    names = "inside_radius_px", "outside_radius_px"
    return {name: float(one) if known else None for name, one in zip(names, radii, strict=True)}


def nominal_radii(camera: Camera, kind: npt.NDArray[np.int64]) -> Array:
    """Radii of bright and total field of microlenses of these kinds by a camera's description, px,
    shape (n, 2).
    """
    focal = np.asarray(camera.array.focal_lengths)[kind]
    radii = np.full((len(focal), 2), math.nan)
    for smms in type_smms(camera):
        radii[focal == float(smms.focal)] = float(smms.inside_radius), float(smms.outside_radius)
    return radii / camera.sensor.pixel

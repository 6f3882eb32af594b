"""What ``flflab measure --json`` says of a white picture measured blind: pixels, (x, y)."""

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

Array = npt.NDArray[np.float64]


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
    centre = np.hypot(own[:, [X, Y]], white.definition_px[:, None])
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
                "u_common": {"definition": {"centre_px": float(white.definition_px[n])}},
            },
        }
        for n in range(len(white.indices))
    ]

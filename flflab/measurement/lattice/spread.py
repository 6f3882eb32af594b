"""How sure the values of single micro-images are."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kernel import LIGHT, SLOPE_X, SLOPE_Y, VALUES, X, Y
from flflab.measurement.lattice.micro_images import (
    Model,
    covariances,
    sums,
)
from flflab.measurement.lattice.pixels import Pixels

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SECTORS = 16  # round a micro-image, in which what is left of the light is summed apart


@dataclass(frozen=True)
class Spread:
    """How sure fitted values are.

    Attributes:
        covariance: of the values, shape (n, VALUES, VALUES); 0 of those that were not free.
        misfit: rms of what neighbouring pixels leave alike, as a share of the light, shape (n,).
        pixels: how many were looked at.
        left_out: how many stood off.
        by_slope: how far a centre moves with the slope of its light along x and along y, px,
            shape (n, 2).
    """

    covariance: Array
    misfit: Array
    pixels: Array
    left_out: Array
    by_slope: Array


def spread(
    pixels: Pixels,
    values: Array,
    members: Whole,
    model: Model,
) -> Spread:
    """Covariances by what is left of the light in sectors round the centre, which follows noise and
    misfit alike; no smaller than the noise alone makes them. Arguments as of ``fit``.

    Opposite sectors count as one: what a symmetric misfit does to a place cancels between them.
    """
    size = model.size
    found = sums(pixels, values, members, model, SECTORS)
    inverse = covariances(found, members, model.neighbours)
    count = np.maximum(found.fit[:, 0], 1.0)
    noise = np.clip(found.fit[:, 3] / count, 1e-9, 1.0)
    pairs = found.right[:, : SECTORS // 2] + found.right[:, SECTORS // 2 :]
    moved = np.einsum("nab,nsb->nsa", inverse, pairs)
    moved -= moved.mean(axis=1, keepdims=True)
    sandwich = np.sum(moved**2, axis=1) * SECTORS / (SECTORS - 2)
    white = inverse * noise[:, None, None]
    ratio = sandwich / np.maximum(np.einsum("naa->na", white), 1e-300)
    # one micro-image's own ratio is known to a half: its fellows' count too
    pooled = (ratio + 3 * np.median(ratio, axis=0)) / 4
    grown = np.sqrt(np.maximum(pooled, 1.0))
    covariance = np.zeros((len(members), VALUES, VALUES))
    covariance[:, :size, :size] = white * grown[:, :, None] * grown[:, None, :]
    alike = np.maximum(found.fit[:, 2] / count, 0.0)
    light = np.maximum(np.abs(values[members, LIGHT]), 1e-9)
    return Spread(
        covariance,
        np.sqrt(alike) / light,
        found.fit[:, 0],
        found.fit[:, 1],
        _by_slope(inverse),
    )


def _by_slope(inverse: Array) -> Array:
    if inverse.shape[1] <= SLOPE_Y:
        return np.zeros((len(inverse), 2))
    pairs = ((X, SLOPE_X), (Y, SLOPE_Y))
    return np.stack([inverse[:, a, b] / inverse[:, b, b] for a, b in pairs], axis=1)

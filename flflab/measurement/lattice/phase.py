"""Where a lattice of micro-images bends away from two exact vectors, by the phase of its light.

The picture times a wave of the lattice's own period, averaged over about one micro-image, turns by
2 pi where the lattice has moved by a period. It asks for no edge between micro-images, so that it
holds where they overlap.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from scipy.ndimage import map_coordinates
from skimage.restoration import unwrap_phase

from flflab.measurement.lattice.find import averaged

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

WAVES = np.array([(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0)])  # by the vectors of the waves
COARSE = 12  # px of the pitch that are enough for a wave
WIDTH = 0.7  # of the pitch: standard deviation of the average
STEP = 0.5  # of the pitch: how far apart averages are taken
REACH = 3.5  # standard deviations
LEAST = 0.12  # of the stronger waves: weaker ones show no phase
NEAR = 3  # lattice steps round the origin, which stays where it is on their average


def displaced(
    picture: npt.NDArray[np.floating], vectors: Array, origin: Array, indices: Whole
) -> tuple[Array, Flags]:
    """How far each lattice point stands from ``origin + vectors @ (i, j)``.

    Args:
        picture: DN, [row, col].
        vectors: of the lattice as columns, px.
        origin: of the micro-image (0, 0); those round it do not move on average; px.
        indices: (i, j), shape (n, 2).

    Returns:
        (x, y) px, shape (n, 2), and where light shows it.
    """
    step = max(1, int(math.sqrt(abs(float(np.linalg.det(vectors)))) / COARSE))
    picture, vectors = averaged(picture, step), vectors / step
    base = 2 * math.pi * np.linalg.inv(vectors)
    pitch = math.sqrt(abs(float(np.linalg.det(vectors))))
    places = (origin - (step - 1) / 2) / step + indices @ vectors.T
    found = [(wave, _wave_at(picture, wave @ base, pitch, places)) for wave in WAVES]
    # light may be even along one of the directions
    found = sorted(found, key=lambda one: -float(np.median(np.abs(one[1]))))
    waves = np.stack([found[0][0], found[1][0]]) @ base
    corner = indices.min(axis=0)
    shape = tuple(indices.max(axis=0) - corner + 1)
    cell = tuple((indices - corner).T)
    near = np.abs(indices).max(axis=1) <= NEAR
    sizes = [np.abs(one) for _, one in found[:2]]
    strong = np.all([size > LEAST * np.quantile(size, 0.9) for size in sizes], axis=0)
    hidden = np.ones(shape, dtype=np.bool_)
    hidden[cell] = ~strong
    phases = np.zeros((len(indices), 2))
    for n, (_, one) in enumerate(found[:2]):
        table = np.zeros(shape)
        table[cell] = np.angle(one)
        turned = np.ma.filled(unwrap_phase(np.ma.masked_array(table, hidden), rng=0), 0.0)[cell]
        phases[:, n] = turned - np.mean(turned[near & strong] if (near & strong).any() else 0.0)
    return -step * phases @ np.linalg.inv(waves).T, strong


def _wave_at(
    picture: npt.NDArray[np.floating], wave: Array, pitch: float, places: Array
) -> npt.NDArray[np.complex128]:
    """Size and phase of one wave, rad/px, round each place; what is even there is left out."""
    down, across = (
        _windows(length, k, pitch) for length, k in zip(picture.shape, wave[::-1], strict=True)
    )
    still = [_windows(length, 0.0, pitch) for length in picture.shape]
    ones = [np.ones(length) for length in picture.shape]
    level = still[0] @ (still[1] @ picture.T).T
    level /= np.outer(still[0] @ ones[0], still[1] @ ones[1])
    values = down @ (across @ picture.T).T
    values -= level * np.outer(down @ ones[0], across @ ones[1])
    at = (places[:, ::-1] / (STEP * pitch)).T
    found = map_coordinates(values, at, order=1, mode="nearest")
    return np.asarray(found, dtype=np.complex128)


def _windows(length: int, k: float, pitch: float) -> Any:
    """Bell-shaped windows times a wave, one a row, STEP pitches apart; a sparse matrix."""
    count = math.ceil(length / (STEP * pitch)) + 1
    reach = math.ceil(REACH * WIDTH * pitch)
    middles = np.arange(count) * STEP * pitch
    pixels = np.rint(middles)[:, None].astype(np.int64) + np.arange(-reach, reach + 1)
    rows = np.repeat(np.arange(count), pixels.shape[1]).reshape(pixels.shape)
    inside = (pixels >= 0) & (pixels < length)
    away = (pixels - middles[:, None]) / (WIDTH * pitch)
    values = np.exp(-0.5 * away**2) * np.exp(-1j * k * pixels)
    return scipy.sparse.csr_array(
        (values[inside], (rows[inside], pixels[inside])), shape=(count, length)
    )

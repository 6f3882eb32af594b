"""One micro-image of a lattice whose vectors are known: all cells folded into their mean, in which
soft discs are fitted at each symmetric point.
"""

import itertools
import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.special import expit

from flflab.errors import MeasurementError
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]

CELL = 24  # points of the mean cell along either vector
FOLDED = 3.5  # pitches either side of the middle that are folded
HARDLY = 0.3  # of what varies most, the rim of unlit surrounds perhaps


def mean_cell(
    picture: npt.NDArray[np.float32], layout: Layout, vectors: Array, pitch: float
) -> tuple[Array, float, float, float, float]:
    """The soft discs that explain the mean cell of a lattice best.

    Args:
        picture: DN, [row, col].
        layout: of the lattice.
        vectors: a, b as columns, px, shape (2, 2).
        pitch: px.

    Returns:
        Centre (x, y) of one of them, px; radius at half light; length over which a rim falls, of a
        logistic edge; light above the background, and this, DN.

    Raises:
        MeasurementError: what repeats like that are no bright spots.
    """
    anchor = _anchor(picture, vectors)
    cell, count = _folded(picture, vectors, anchor)
    grid = np.stack(np.meshgrid(np.arange(CELL), np.arange(CELL), indexing="ij"), axis=-1) / CELL
    grid = grid.reshape(-1, 2)
    values, weights = cell.ravel(), np.sqrt(count.ravel())
    smooth = gaussian_filter(cell, 0.06 * CELL, mode="wrap")
    bright = np.array(np.unravel_index(int(np.argmax(smooth)), cell.shape)) / CELL
    dark = np.array(np.unravel_index(int(np.argmin(smooth)), cell.shape)) / CELL
    halves = [np.array(one) / 2 for one in ((1, 0), (0, 1), (1, 1))]
    thirds = [np.array(one) / 3 for one in ((1, 1), (2, 2))] if layout == "hexagonal" else []
    sites = [bright, dark, *(bright + one for one in (*halves, *thirds))]
    begun = []
    for site in sites:
        of_site = []
        for radius, soft in itertools.product((0.2, 0.32, 0.45, 0.52, 0.6, 0.75), (0.03, 0.08)):
            shape = _discs(grid - site, vectors, radius * pitch, soft * pitch)
            of_site.append((*_scaled(shape, values, weights), site, radius, soft))
        of_site = [one for one in of_site if one[1] > 0]
        begun += [min(of_site, key=lambda one: one[0])] if of_site else []

    def drawn(free: Array) -> tuple[Array, float, float]:
        shape = _discs(grid - free[:2], vectors, free[2] * pitch, free[3] * pitch)
        return shape, *_scaled(shape, values, weights)[1:]

    def left(free: Array) -> Array:
        shape, light, ground = drawn(free)
        return weights * (ground + light * shape - values)

    fits = [
        least_squares(
            left,
            [*site, radius, soft],
            bounds=([-2, -2, 0.08, 0.01], [3, 3, 1.1, 0.3]),
            x_scale=[0.1, 0.1, 0.1, 0.03],
            max_nfev=25,
        )
        for _, _, _, site, radius, soft in begun
    ]
    # where micro-images touch, dark spots between them can be the closer ones
    lit = [one for one in fits if drawn(one.x)[1] > 0]
    if not lit:
        raise MeasurementError(
            "white picture: what repeats in it are no bright spots; a picture of an evenly lit"
            " target is due"
        )
    best = min(lit, key=lambda one: float(one.cost)).x
    _, light, ground = drawn(best)
    return anchor + vectors @ best[:2], best[2] * pitch, best[3] * pitch, light, ground


def _anchor(picture: npt.NDArray[np.float32], vectors: Array) -> Array:
    """Where the folding starts: the middle, or where what repeats varies most."""
    reach = FOLDED * float(np.max(np.hypot(*vectors)))
    height, width = picture.shape
    shares = [0.5, 0.25, 0.75, 0.1, 0.9]
    spots = [
        np.array(
            [
                np.clip(width * u, min(reach, width / 2), max(width - reach, width / 2)),
                np.clip(height * v, min(reach, height / 2), max(height - reach, height / 2)),
            ]
        )
        for v, u in itertools.product(shares, repeat=2)
    ]
    spreads = []
    for x, y in spots:
        part = picture[
            max(0, int(y - reach)) : int(y + reach) + 1, max(0, int(x - reach)) : int(x + reach) + 1
        ]
        spreads.append(float(np.subtract(*np.quantile(part, [0.9, 0.1]))))
    if spreads[0] > HARDLY * max(spreads):
        return spots[0]
    # the rim of unlit surrounds varies most, and repeats least
    return max(spots, key=lambda spot: float(_folded(picture, vectors, spot)[0].std()))


def _folded(picture: npt.NDArray[np.float32], vectors: Array, anchor: Array) -> tuple[Array, Array]:
    """Mean over the cells round the anchor, and how many pixels stand in each point, shape (CELL,
    CELL) by (i, j).
    """
    reach = math.ceil(FOLDED * float(np.max(np.hypot(*vectors))))
    top, left = (max(0, int(anchor[1]) - reach), max(0, int(anchor[0]) - reach))
    part = picture[top : int(anchor[1]) + reach + 1, left : int(anchor[0]) + reach + 1]
    rows, columns = np.indices(part.shape)
    away = np.stack([columns + left - anchor[0], rows + top - anchor[1]], axis=-1)
    place = (away @ np.linalg.inv(vectors).T) % 1.0 * CELL
    low = np.floor(place).astype(np.int64)
    rest = place - low
    total, count = np.zeros((CELL, CELL)), np.zeros((CELL, CELL))
    for i, j in itertools.product((0, 1), repeat=2):
        weight = np.abs(1 - i - rest[..., 0]) * np.abs(1 - j - rest[..., 1])
        at = (low[..., 0] + i) % CELL, (low[..., 1] + j) % CELL
        np.add.at(total, at, weight * part)
        np.add.at(count, at, weight)
    return total / np.maximum(count, 1e-9), count


def _discs(place: Array, vectors: Array, radius: float, softness: float) -> Array:
    """Light at places given in lattice steps from a micro-image: soft discs at every lattice point
    near, shape (n,).
    """
    place = place - np.rint(place)
    total = np.zeros(len(place))
    for i, j in itertools.product((-2, -1, 0, 1, 2), repeat=2):
        away = np.hypot(*((place - [i, j]) @ vectors.T).T)
        if away.min() < radius + 8 * softness:
            total += expit((radius - away) / softness)
    return total


def _scaled(shape: Array, values: Array, weights: Array) -> tuple[float, float, float]:
    """What light times a shape plus a background leaves (sum of squares), the light and the
    background.
    """
    mean, level = np.average(shape, weights=weights**2), np.average(values, weights=weights**2)
    spread = float(np.sum((weights * (shape - mean)) ** 2))
    light = float(np.sum(weights**2 * (shape - mean) * (values - level))) / max(spread, 1e-12)
    ground, least = float(level - light * mean), min(0.0, float(values.min()))
    if ground < least:  # no sensor reads less, whatever lies beneath light that never ends
        ground = least
        light = float(np.sum(weights**2 * shape * (values - ground)))
        light /= max(float(np.sum((weights * shape) ** 2)), 1e-12)
    return float(np.sum((weights * (ground + light * shape - values)) ** 2)), light, ground

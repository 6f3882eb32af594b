"""Where the micro-images of a white picture roughly lie, found blind: two lattice vectors, the
layout, and one micro-image with its radius.

The autocorrelation of a window gives the vectors; the mean cell, folded by them, shows at which of
its symmetric points the microlens stands. With overlap the brightest point is where discs meet.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.special import expit

from flflab.errors import MeasurementError
from flflab.measurement.lattice.repeats import LEAST_PITCH, PERIODS, vectors_in
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]

WINDOW = 512  # pixels of a side in which the autocorrelation is looked at
SURE = 0.6  # height of a peak that needs no look at a coarser picture
CELL = 24  # points of the mean cell along either vector
FOLDED = 3.5  # pitches either side of the middle that are folded


@dataclass(frozen=True)
class RoughLattice:
    """A lattice as good as its mean cell shows it; pixels, (x, y).

    Attributes:
        layout: square or hexagonal.
        vectors: a, b as columns, shape (2, 2).
        origin: a micro-image's centre, shape (2,).
        radius: at half light.
        softness: length over which a rim falls, of a logistic edge.
        light: DN of a micro-image above the background.
        background: DN.
    """

    layout: Layout
    vectors: Array
    origin: Array
    radius: float
    softness: float
    light: float
    background: float

    @property
    def pitch(self) -> float:
        """Distance between neighbours."""
        return pitch_and_angle(self.layout, self.vectors)[0]

    def seen_in_means(self, factor: int) -> "RoughLattice":
        """The same where squares of so many pixels a side are averaged."""
        return replace(
            self,
            vectors=self.vectors / factor,
            origin=(self.origin - (factor - 1) / 2) / factor,
            radius=self.radius / factor,
            softness=self.softness / factor,
        )


def pitch_and_angle(layout: Layout, vectors: Array) -> tuple[float, float]:
    """Pitch (from the area of a cell) and angle (rotation of the polar decomposition) of lattice
    vectors given as columns; rad, modulo 90 degrees (hexagonal 60), nearest zero.
    """
    square = vectors @ _unslanted(layout)
    turn = math.pi / 2 if layout == "square" else math.pi / 3
    angle = math.atan2(square[1, 0] - square[0, 1], square[0, 0] + square[1, 1])
    return math.sqrt(abs(float(np.linalg.det(square)))), (angle + turn / 2) % turn - turn / 2


def _unslanted(layout: Layout) -> Array:
    """The matrix that makes hexagonal vectors square."""
    if layout == "square":
        return np.eye(2)
    return np.array([[1.0, -1 / math.sqrt(3)], [0.0, 2 / math.sqrt(3)]])


def stretch(layout: Layout, vectors: Array) -> float:
    """Ratio of the largest to the smallest stretch that makes these vectors of an exact lattice."""
    sizes = np.linalg.svd(vectors @ _unslanted(layout), compute_uv=False)
    return float(sizes[0] / sizes[1])


def find_lattice(picture: npt.NDArray[np.floating]) -> RoughLattice:
    """Find the lattice of micro-images in a white picture.

    Args:
        picture: DN, [row, col], finite.

    Raises:
        MeasurementError: nothing repeats along two directions, or fewer than five periods are
            seen.
    """
    best: tuple[float, int, Array, npt.NDArray[np.floating]] | None = None
    for factor in _factors(picture.shape):
        coarse = averaged(picture, factor)
        for window in _windows(coarse):
            found = vectors_in(window)
            if found is not None and (best is None or found[0] > 1.1 * best[0]):
                best = found[0], factor, found[1], window
        if best is not None and best[0] > SURE:
            break
    if best is None:
        raise MeasurementError(
            "white picture: nothing in it repeats along two directions, as micro-images do; a"
            " picture of an evenly lit target behind the microlens array is due, with at least"
            f" {PERIODS} x {PERIODS} micro-images of {LEAST_PITCH:g} px pitch or more"
        )
    _, factor, vectors, _ = best
    vectors = vectors * factor
    return lattice_near(picture, *layout_of(vectors))


def lattice_near(picture: npt.NDArray[np.floating], layout: Layout, vectors: Array) -> RoughLattice:
    """The lattice of a picture of which layout and vectors are known, to a fiftieth of a pitch.

    Args:
        picture: DN, [row, col], finite.
        layout: of the array.
        vectors: a, b as columns, px, shape (2, 2).

    Raises:
        MeasurementError: what repeats like that are no bright spots.
    """
    step = max(1, int(np.abs(np.linalg.det(vectors)) ** 0.5 / (2 * CELL)))
    return _mean_cell(averaged(picture, step), layout, vectors / step, step)


def _factors(shape: tuple[int, ...]) -> list[int]:
    """By how much the picture is averaged down, until a window holds all of it."""
    factors = [1]
    while min(shape) / factors[-1] > WINDOW / 2 and max(shape) / factors[-1] > WINDOW:
        factors.append(2 * factors[-1])
    return factors


def averaged(picture: npt.NDArray[np.floating], factor: int) -> npt.NDArray[np.float32]:
    """Means over squares of pixels."""
    if factor == 1:
        return np.asarray(picture, dtype=np.float32)
    rows, columns = picture.shape[0] // factor, picture.shape[1] // factor
    cut = picture[: rows * factor, : columns * factor]
    return cut.reshape(rows, factor, columns, factor).mean(axis=(1, 3), dtype=np.float32)


def _windows(picture: npt.NDArray[np.float32]) -> list[npt.NDArray[np.float32]]:
    """The middle of a picture, and beside it the part that varies most where that is elsewhere."""
    rows, columns = (min(WINDOW, size) for size in picture.shape)
    tops = [(picture.shape[0] - rows) // 2, 0, picture.shape[0] - rows]
    lefts = [(picture.shape[1] - columns) // 2, 0, picture.shape[1] - columns]
    parts = [
        picture[top : top + rows, left : left + columns]
        for top, left in dict.fromkeys(itertools.product(tops, lefts))
    ]
    spreads = [float(np.subtract(*np.quantile(part[::4, ::4], [0.9, 0.1]))) for part in parts]
    most = int(np.argmax(spreads))
    return parts[:1] if spreads[most] < 3 * spreads[0] or most == 0 else [parts[0], parts[most]]


def layout_of(vectors: Array) -> tuple[Layout, Array]:
    """The layout that needs the smaller stretch, and its vectors: a nearest the columns' axis, b a
    quarter (hexagonal a sixth) turn on.
    """
    a, b = vectors.T
    every = [i * a + j * b for i, j in itertools.product((-1, 0, 1), repeat=2) if (i, j) != (0, 0)]
    pairs: list[tuple[float, float, Layout, Array]] = []
    for p, q in itertools.permutations(every, 2):
        pair = np.stack([p, q], axis=1)
        if not 0.5 < np.linalg.det(pair) / abs(np.linalg.det(vectors)) < 1.5:
            continue
        for layout in ("square", "hexagonal"):
            size = stretch(layout, pair)
            square = pair @ _unslanted(layout)
            turn = math.atan2(square[1, 0] - square[0, 1], square[0, 0] + square[1, 1])
            pairs.append((size, abs(turn), layout, pair))
    least = min(size for size, *_ in pairs)
    _, _, layout, pair = min(
        (one for one in pairs if one[0] < least * 1.001), key=lambda one: one[1]
    )
    return layout, pair


def _mean_cell(
    picture: npt.NDArray[np.float32], layout: Layout, vectors: Array, scale: int
) -> RoughLattice:
    """The lattice with the site, radius and softness that explain its mean cell best.

    Args:
        picture: averaged down by ``scale``.
        layout: as found.
        vectors: px of that picture.
        scale: pixels of the picture itself in one of it.
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
    pitch = pitch_and_angle(layout, vectors)[0]
    begun = []
    for site in sites:
        of_site = []
        for radius, soft in itertools.product((0.2, 0.32, 0.45, 0.52, 0.6, 0.75), (0.03, 0.08)):
            shape = _discs(grid - site, vectors, radius * pitch, soft * pitch)
            of_site.append((*_scaled(shape, values, weights), site, radius, soft))
        of_site = [one for one in of_site if one[1] > 0]
        begun += [min(of_site, key=lambda one: one[0])] if of_site else []
    if not begun:
        raise MeasurementError(
            "white picture: what repeats in it are no bright spots; a picture of an evenly lit"
            " target is due"
        )

    def left(free: Array) -> Array:
        shape = _discs(grid - free[:2], vectors, free[2] * pitch, free[3] * pitch)
        _, light, ground = _scaled(shape, values, weights)
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
    best = min(fits, key=lambda one: float(one.cost)).x
    shape = _discs(grid - best[:2], vectors, best[2] * pitch, best[3] * pitch)
    _, light, ground = _scaled(shape, values, weights)
    return RoughLattice(
        layout,
        vectors * scale,
        (anchor + vectors @ best[:2]) * scale + (scale - 1) / 2,
        best[2] * pitch * scale,
        best[3] * pitch * scale,
        light,
        ground,
    )


def _anchor(picture: npt.NDArray[np.float32], vectors: Array) -> Array:
    """Where the folding starts: the middle, or the place that varies most where the middle hardly
    does.
    """
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
    most = int(np.argmax(spreads))
    return spots[0] if spreads[0] > 0.6 * spreads[most] else spots[most]


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

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
import scipy.fft
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage.feature import peak_local_max

from flflab.errors import MeasurementError
from flflab.measurement.lattice.mean_cell import CELL, mean_cell
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]

WINDOW = 512  # pixels of a side in which the autocorrelation is looked at
LEAST_PITCH = 4.5  # px
PERIODS = 5  # of the lattice that a window must hold
ALIKE = 0.75  # of the best peak: the lattice's own vectors are among those as high
RISE = 0.12  # of the variance: how far a peak must rise above the valley before it
SURE = 0.6  # height of a peak that needs no look at a coarser picture
LEAST_HEIGHT = 0.06  # of the variance without noise


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
    best: tuple[float, int, Array] | None = None
    for factor in _factors(picture.shape):
        coarse = averaged(picture, factor)
        for window in _windows(coarse):
            if (found := _vectors_in(window)) is None:
                continue
            # a dark frame does not reach the middle of the window
            inner = _vectors_in(_middle(window))
            for height, vectors in (found, *([inner] if inner else [])):
                if best is None or height > 1.1 * best[0]:
                    best = height, factor, vectors
        if best is not None and best[0] > SURE:
            break
    if best is None:
        raise MeasurementError(
            "white picture: nothing in it repeats along two directions, as micro-images do; a"
            " picture of an evenly lit target behind the microlens array is due, with at least"
            f" {PERIODS} x {PERIODS} micro-images of {LEAST_PITCH:g} px pitch or more"
        )
    _, factor, vectors = best
    return lattice_near(picture, *layout_of(vectors * factor))


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
    pitch = pitch_and_angle(layout, vectors)[0]
    centre, radius, softness, light, ground = mean_cell(
        averaged(picture, step), layout, vectors / step, pitch / step
    )
    centre = centre * step + (step - 1) / 2
    return RoughLattice(layout, vectors, centre, radius * step, softness * step, light, ground)


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


def _middle(window: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Half as wide and high."""
    rows, columns = window.shape
    return window[rows // 4 : rows - rows // 4, columns // 4 : columns - columns // 4]


def _vectors_in(window: npt.NDArray[np.float32]) -> tuple[float, Array] | None:
    """Height of the best peak of the autocorrelation and two reduced vectors, px of the window."""
    correlation = _autocorrelation(window)
    if correlation is None:
        return None
    middle = np.array(correlation.shape) // 2
    reach = min(window.shape) // (PERIODS - 1)
    around = correlation[
        middle[0] - reach : middle[0] + reach + 1, middle[1] - reach : middle[1] + reach + 1
    ]
    peaks = _peaks(around)
    if len(peaks) < 2:
        return None
    heights = map_coordinates(around, (peaks[:, ::-1] + reach).T, order=1)
    best = float(heights.max())
    if best < LEAST_HEIGHT:
        return None
    chosen = peaks[heights >= ALIKE * best]
    chosen = chosen[np.argsort(np.hypot(*chosen.T))]
    first = chosen[0]
    across = np.abs(first[0] * chosen[:, 1] - first[1] * chosen[:, 0])
    second = chosen[across > 0.4 * np.hypot(*first) * np.hypot(*chosen.T)]
    if len(second) == 0:
        return None
    vectors = _refined(correlation, reduced(np.stack([first, second[0]], axis=1)))
    return best, vectors


def _autocorrelation(window: npt.NDArray[np.float32]) -> Array | None:
    """That of a window less its slow variation, over the variance without noise; lag 0 in the
    middle.
    """
    values = window.astype(np.float64)
    low, high = np.quantile(values[::3, ::3], [0.001, 0.999])
    values = np.clip(values, low, high)
    y, x = (np.linspace(-1, 1, size) for size in values.shape)
    rows, columns = np.vander(y, 4), np.vander(x, 4)
    inner = np.linalg.pinv(rows) @ values @ np.linalg.pinv(columns).T
    values = values - rows @ inner @ columns.T
    taper = np.outer(np.hanning(values.shape[0] + 2)[1:-1], np.hanning(values.shape[1] + 2)[1:-1])
    padded = [scipy.fft.next_fast_len(2 * size, real=True) for size in values.shape]

    def correlated(some: Array) -> Array:
        spectrum = np.asarray(scipy.fft.rfft2(some, padded))
        return np.asarray(scipy.fft.irfft2(np.abs(spectrum) ** 2, padded))

    own = correlated(taper)
    found = correlated(values * taper) / np.maximum(own, 1e-3 * own[0, 0])
    # white noise adds to lag 0 alone
    variance = max(float(found[0, 1]), float(found[1, 0]), float(found[1, 1]))
    if not variance > 1e-12 * max(float(high - low) ** 2, 1e-300):
        return None
    return np.fft.fftshift(found / variance)


def _peaks(around: Array) -> Array:
    """Lags (x, y) of the local maxima of half of the plane that rise above the valley before
    them, shape (n, 2).
    """
    reach = around.shape[0] // 2
    smooth = gaussian_filter(around, 0.7)
    tops = peak_local_max(smooth, min_distance=2, threshold_abs=0.0, exclude_border=False)
    lags = tops[:, ::-1] - reach
    far = np.hypot(*lags.T)
    half = (lags[:, 1] > 0) | ((lags[:, 1] == 0) & (lags[:, 0] > 0))
    inside = (np.abs(lags) < reach - 1).all(axis=1)
    lags = lags[half & inside & (far >= LEAST_PITCH)]
    kept = []
    for lag in lags:
        way = np.linspace(0.05, 0.95, 40)[:, None] * lag + reach
        valley = float(map_coordinates(around, way[:, ::-1].T, order=1).min())
        height = float(around[lag[1] + reach, lag[0] + reach])
        if height - min(valley, height) > RISE * min(1.0, max(height, RISE)):
            kept.append(_vertex(around, lag + reach) - reach)
    return np.array(kept, dtype=np.float64).reshape(-1, 2)


def _vertex(values: Array, at: npt.NDArray[np.int64]) -> Array:
    """Top (x, y) of the parabolas through a local maximum and its neighbours."""
    x, y = int(at[0]), int(at[1])
    if not (0 < x < values.shape[1] - 1 and 0 < y < values.shape[0] - 1):
        return np.array([x, y], dtype=np.float64)
    found = []
    for three in (values[y, x - 1 : x + 2], values[y - 1 : y + 2, x]):
        bend = three[0] - 2 * three[1] + three[2]
        found.append(0.5 * (three[0] - three[2]) / bend if bend < 0 else 0.0)
    return np.array([x, y]) + np.clip(found, -0.6, 0.6)


def reduced(vectors: Array) -> Array:
    """Gauss reduction: the two shortest vectors of the lattice, the shorter first."""
    a, b = vectors[:, 0], vectors[:, 1]
    for _ in range(20):
        if a @ a > b @ b:
            a, b = b, a
        times = round(float(a @ b) / float(a @ a))
        if times == 0:
            break
        b = b - times * a
    return np.stack([a, b], axis=1)


def _refined(correlation: Array, vectors: Array) -> Array:
    """The vectors by peaks at twice, four times ... their lags, as far as these rise."""
    middle = np.array(correlation.shape[::-1]) // 2
    pitch = float(np.hypot(*vectors[:, 0]))
    columns = []
    for vector in vectors.T:
        best, times = vector, 1
        while True:
            times *= 2
            lag = times * best
            near = max(2, int(0.2 * pitch))
            x, y = np.rint(lag).astype(int) + middle
            if (np.abs(lag) > np.array(correlation.shape[::-1]) / 4.5).any():
                break
            part = correlation[y - near : y + near + 1, x - near : x + near + 1]
            top = np.array(np.unravel_index(int(np.argmax(part)), part.shape))[::-1]
            edge = (top == 0).any() or (top == 2 * near).any()
            if edge or float(part.max()) < 0.15:
                break
            best = (_vertex(correlation, top + np.array([x - near, y - near])) - middle) / times
        columns.append(best)
    return np.stack(columns, axis=1)


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

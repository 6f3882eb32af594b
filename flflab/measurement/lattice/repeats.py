"""Along which two vectors a picture repeats, by its autocorrelation."""

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

Array = npt.NDArray[np.float64]

LEAST_PITCH = 4.5  # px
PERIODS = 5  # of the lattice that a window must hold
ALIKE = 0.75  # of the best peak: the lattice's own vectors are among those as high
RISE = 0.12  # of the variance: how far a peak must rise above the valley before it
LEAST_HEIGHT = 0.06  # of the variance without noise


def vectors_in(window: npt.NDArray[np.float32]) -> tuple[float, Array] | None:
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
    vectors = _refined(correlation, _reduced(np.stack([first, second[0]], axis=1)))
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
    y, x = np.nonzero((smooth == maximum_filter(smooth, 5)) & (around > 0))
    lags = np.stack([x, y], axis=1) - reach
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


def _reduced(vectors: Array) -> Array:
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

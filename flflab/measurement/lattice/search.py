"""A first lattice from a white picture: pitch and angle from the spectrum's peaks, origin and disc
radii from their phases.

The spectrum of equal micro-images on a lattice has peaks at the reciprocal lattice only, with
amplitudes J(G) = jinc(r_a |G|) jinc(r_b |G|) and phases -2 pi G . origin. No single peak can be
relied on: jinc has zeros (the first ring vanishes near F/1.93 in the worked example), so rings are
scored together.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.special import j1

from flflab.errors import MeasurementError
from flflab.optics.camera import Layout

Array = npt.NDArray[np.float64]

PITCH_RANGE = 0.12  # how far the pitch may lie from the rough one, relative
_TWIST = {"square": math.pi / 2, "hexagonal": math.pi / 3}


@dataclass(frozen=True)
class RoughLattice:
    """Lattice vectors (columns, px), origin (x, y) px near the picture's centre, the two disc radii
    px, light above the background DN.
    """

    vectors: Array
    origin: Array
    radii: tuple[float, float]
    light: float


def lattice_vectors(layout: Layout, pitch: npt.ArrayLike, angle: npt.ArrayLike) -> Array:
    """Vectors a and b of regular lattices as columns, px, shape (..., 2, 2); a lies at ``angle``
    from the columns' axis.
    """
    turn = np.asarray(angle) + _TWIST[layout]
    columns = np.stack([np.cos(angle), np.cos(turn), np.sin(angle), np.sin(turn)], axis=-1)
    return np.asarray(pitch)[..., None, None] * columns.reshape(*columns.shape[:-1], 2, 2)


def _reciprocal_indices(layout: Layout, rings: int) -> npt.NDArray[np.int64]:
    """Indices of half the reciprocal lattice's points, nearest first, the zeroth left out."""
    n = np.arange(-4, 5)
    h, k = np.meshgrid(n, n, indexing="ij")
    cross = 0 if layout == "square" else -1
    size = h * h + k * k + cross * h * k
    half = (h > 0) | ((h == 0) & (k > 0))
    order = np.unique(size[half])[:rings]
    keep = half & (size <= order[-1])
    return np.stack([h[keep], k[keep]], axis=1).astype(np.int64)


def _binned(picture: npt.NDArray[np.float32], factor: int) -> npt.NDArray[np.float32]:
    height, width = (size // factor for size in picture.shape)
    whole = picture[: height * factor, : width * factor]
    return np.asarray(
        cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32
    )


def search_lattice(
    picture: npt.NDArray[np.float32], layout: Layout, rough_pitch: float, offset_dn: float
) -> RoughLattice:
    """Find the lattice to about a hundredth of a pitch near the picture's centre.

    Args:
        picture: white picture, DN.
        layout: square or hexagonal.
        rough_pitch: expected distance between nearest micro-images, px, right within 12 %.
        offset_dn: what a pixel without light reads, DN.

    Raises:
        MeasurementError: the picture is smaller than two pitches, or shows no lattice of this
            pitch.
    """
    if min(picture.shape) < 2 * rough_pitch:
        raise MeasurementError(
            f"white picture: {picture.shape[1]} x {picture.shape[0]} px hold fewer than 2 x 2"
            f" micro-images of {rough_pitch:g} px; use a larger picture"
        )
    factor = max(1, int(rough_pitch / 12))
    small = _binned(picture, factor) - np.float32(offset_dn)
    window = np.outer(
        np.hanning(small.shape[0] + 2)[1:-1], np.hanning(small.shape[1] + 2)[1:-1]
    ).astype(np.float32)
    mean = float((small * window).sum() / window.sum())
    pitch, angle = _score_peaks((small - np.float32(mean)) * window, layout, rough_pitch / factor)
    vectors = lattice_vectors(layout, pitch * factor, angle)
    return _origin_and_radii(small, window, layout, vectors, factor, picture.shape)


def _score_peaks(
    windowed: npt.NDArray[np.float32], layout: Layout, pitch: float
) -> tuple[float, float]:
    """Pitch (binned px) and angle whose reciprocal lattice collects the most power, coarse then
    fine.
    """
    shape = [int(fft.next_fast_len(2 * size, real=False) or 2 * size) for size in windowed.shape]
    power = np.abs(fft.fftshift(fft.fft2(windowed, shape, workers=2))).astype(np.float32) ** 2
    middle = [size // 2 for size in shape]
    span = max(windowed.shape) / pitch

    def score(pitches: Array, angles: Array, rings: int) -> Array:
        indices = _reciprocal_indices(layout, rings)
        reciprocal = np.linalg.inv(
            lattice_vectors(layout, pitches[:, None], angles)
        )  # rows are the reciprocal vectors
        points = np.einsum("gk,ptkx->ptgx", indices.astype(np.float64), reciprocal)
        at = [points[..., 1] * shape[0] + middle[0], points[..., 0] * shape[1] + middle[1]]
        return map_coordinates(power, at, order=1).sum(axis=-1)

    lengths = np.arange(-PITCH_RANGE, PITCH_RANGE + 1e-9, min(0.02, 0.25 / span)) * pitch + pitch
    turn = math.pi / 2 if layout == "square" else math.pi / 3
    turns = np.arange(0, turn, min(0.02, 0.25 / span))
    table = score(lengths, turns, 2)
    if (
        not np.isfinite(table).all()
        or table.max() <= 0
        or table.max() < (4 if span > 8 else 1) * np.median(table)
    ):
        raise MeasurementError(
            f"white picture: no {layout} lattice within {PITCH_RANGE:.0%} of the rough pitch; "
            "check layout, pitch and that the target was white"
        )
    best = np.unravel_index(int(np.argmax(table)), table.shape)
    length, angle = float(lengths[best[0]]), float(turns[best[1]])
    width = min(0.02, 0.25 / span)
    for _ in range(5):
        fine = np.linspace(-width, width, 9)
        table = score(length * (1 + fine), angle + fine, 2)
        best = np.unravel_index(int(np.argmax(table)), table.shape)
        length, angle = length * (1 + float(fine[best[0]])), angle + float(fine[best[1]])
        width /= 2.5
    return length, (angle + turn / 2) % turn - turn / 2


def _jinc(x: Array) -> Array:
    t = 2 * np.pi * x
    return np.where(t < 1e-9, 1.0, 2 * j1(np.maximum(t, 1e-9)) / np.maximum(t, 1e-9))


def _origin_and_radii(
    small: npt.NDArray[np.float32],
    window: npt.NDArray[np.float32],
    layout: Layout,
    vectors: Array,
    factor: int,
    shape: tuple[int, ...],
) -> RoughLattice:
    """Match the complex amplitudes at the reciprocal lattice to every origin in a cell and every
    pair of radii.
    """
    indices = np.concatenate([[[0, 0]], _reciprocal_indices(layout, 6)])
    reciprocal = np.asarray(indices @ np.linalg.inv(vectors), dtype=np.float64)
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    x = np.arange(small.shape[1]) * factor + (factor - 1) / 2 - middle[0]
    y = np.arange(small.shape[0]) * factor + (factor - 1) / 2 - middle[1]
    row_waves = np.exp(-2j * np.pi * np.outer(y, reciprocal[:, 1]))
    column_waves = np.exp(-2j * np.pi * np.outer(x, reciprocal[:, 0]))
    amplitude = (
        np.einsum("yg,yg->g", row_waves, (small * window) @ column_waves.astype(np.complex64))
        / window.sum()
    )
    amplitude /= np.sinc(factor * reciprocal[:, 0]) * np.sinc(factor * reciprocal[:, 1])
    size: Array = np.hypot(reciprocal[:, 0], reciprocal[:, 1])
    pitch = float(np.linalg.norm(vectors[:, 0]))
    cell = abs(float(np.linalg.det(vectors)))
    large = np.geomspace(0.03, 1.3, 90)
    ratio = np.linspace(0.02, 0.9, 23)
    a, share = (grid.ravel() for grid in np.meshgrid(large * pitch, ratio, indexing="ij"))
    b = np.maximum(a * share, 0.3)
    shapes = (
        (np.pi * a**2 / cell)[:, None]
        * np.repeat(_jinc(np.outer(large * pitch, size)), len(ratio), axis=0)
        * _jinc(np.outer(b, size))
    )
    n = 24
    steps = np.arange(n) / n - 0.5
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    turned = amplitude[:, None] * np.exp(2j * np.pi * (indices @ np.stack([u, v])))
    weight = np.where(
        size > 0, 2.0, 1.0
    )  # each point but the zeroth stands for itself and its opposite
    power = (shapes**2) @ weight
    match = (shapes * (weight / np.sqrt(power)[:, None])) @ turned.real
    best = np.unravel_index(int(np.argmax(match)), match.shape)
    light = float(match[best] / math.sqrt(power[best[0]]))
    origin = middle + vectors @ np.array([u[best[1]], v[best[1]]])
    return RoughLattice(vectors, origin, (float(a[best[0]]), float(b[best[0]])), light)

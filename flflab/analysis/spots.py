"""Images of one round dot in many micro-images: least squares fit of centre and brightness, all at once.

A spot is a disc blurred by a disc, averaged over the pixel, times the light that the micro-image has there:
expected = background + brightness * light * illumination(|p - micro-image|) * profile(|p - centre|).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.noise import SensorNoise
from flflab.analysis.profile import ProfileTable, profile_table

Array = npt.NDArray[np.float64]

WEAKEST_ILLUMINATION = 0.05  # pixels with less light say nothing of a spot


@dataclass(frozen=True)
class Spots:
    """Fitted spots, one entry each.

    Attributes:
        centres: (x, y), px, shape (n, 2).
        brightness: plateau over the light of a white target there, shape (n,).
        covariance: of (x, y, brightness), shape (n, 3, 3); infinite where the pixels say nothing.
        chi2_per_pixel: of each, shape (n,).
    """

    centres: Array
    brightness: Array
    covariance: Array
    chi2_per_pixel: Array


@dataclass(frozen=True)
class Windows:
    """Square windows cut out of a picture round each spot, shape (n, w, w) each.

    Attributes:
        columns: x of the pixels.
        rows: y of the pixels.
        read: DN above the offset.
        light: DN above the offset that a white target would give there through this spot's own micro-image.
        valid: on the picture, unsaturated and lit enough.
    """

    columns: Array
    rows: Array
    read: Array
    light: Array
    valid: npt.NDArray[np.bool_]


def illumination(lattice: Lattice, distance: Array) -> Array:
    """Relative illumination at distances in px from the centre of a micro-image, 1 inside."""
    table = illumination_table(lattice)
    return np.interp(distance / table.step, np.arange(len(table.values)), table.values[:, 0])


def illumination_table(lattice: Lattice) -> ProfileTable:
    """The lattice's measured profile."""
    return profile_table((lattice.outside_radius_px + lattice.inside_radius_px) / 2, max(0.05, _smaller(lattice)))


def _smaller(lattice: Lattice) -> float:
    return (lattice.outside_radius_px - lattice.inside_radius_px) / 2


def light_level(lattice: Lattice, x: Array, y: Array, shape: tuple[int, int]) -> Array:
    """Light of a white target in the bright field at pixels (x, y), DN above the background."""
    scale = 2 / max(shape)
    u, v = (x - (shape[1] - 1) / 2) * scale, (y - (shape[0] - 1) / 2) * scale
    k = lattice.light
    return k[0] + k[1] * u + k[2] * v + k[3] * u * u + k[4] * u * v + k[5] * v * v


def cut_windows(picture: Array, lattice: Lattice, lens: npt.NDArray[np.int64], places: Array, half: int, noise: SensorNoise) -> Windows:
    """Windows of (2 half + 1)^2 px round ``places`` (px), each seen through the micro-image at ``lens`` of the lattice."""
    window = np.arange(-half, half + 1)
    whole = np.rint(places).astype(np.int64)
    columns = np.broadcast_to(whole[:, 0, None, None] + window[None, None, :], (len(places), len(window), len(window)))
    rows = np.broadcast_to(whole[:, 1, None, None] + window[None, :, None], columns.shape)
    on_picture = (columns >= 0) & (columns < picture.shape[1]) & (rows >= 0) & (rows < picture.shape[0])
    read = picture[np.clip(rows, 0, picture.shape[0] - 1), np.clip(columns, 0, picture.shape[1] - 1)]
    x, y = columns.astype(np.float64), rows.astype(np.float64)
    centre = lattice.centres_px[lens]
    share = illumination(lattice, np.hypot(x - centre[:, 0, None, None], y - centre[:, 1, None, None]))
    light = share * light_level(lattice, x, y, (picture.shape[0], picture.shape[1]))
    valid = on_picture & (read < noise.full_scale_dn) & (share > WEAKEST_ILLUMINATION)
    return Windows(x, y, read - noise.offset_dn, light, valid)


def flat_centroids(windows: Windows, places: Array, radius: float) -> tuple[Array, Array]:
    """Centroid of the flat-fielded light within ``radius`` px of each place, and the light's sum over that of a full disc of 1 px^2."""
    near = windows.valid & (np.hypot(windows.columns - places[:, 0, None, None], windows.rows - places[:, 1, None, None]) <= radius)
    flat = np.where(near, windows.read / np.maximum(windows.light, 1e-9), 0.0)
    # half of the brightest: what is darker is mostly noise and light of elsewhere
    flat = np.where(flat > 0.25 * np.quantile(flat, 0.98, axis=(1, 2), keepdims=True), np.maximum(flat, 0.0), 0.0)
    total = flat.sum(axis=(1, 2))
    safe = np.maximum(total, 1e-12)
    x = (flat * windows.columns).sum(axis=(1, 2)) / safe
    y = (flat * windows.rows).sum(axis=(1, 2)) / safe
    return np.stack([x, y], axis=1), total


def fit_spots(windows: Windows, centres: Array, brightness: Array, table: ProfileTable, noise: SensorNoise, iterations: int = 6) -> Spots:
    """Gauss-Newton for (x, y, brightness) of every spot with one profile for all.

    Args:
        windows: the pixels.
        centres: where to start, px, shape (n, 2).
        brightness: where to start, shape (n,).
        table: profile of a spot.
        noise: of the sensor.
        iterations: number of steps.
    """
    start, place = centres, np.arange(len(table.values), dtype=np.float64)
    centres, brightness = centres.copy(), brightness.copy()
    inverse, chi2 = np.full((len(centres), 3, 3), np.inf), np.zeros(len(centres))
    for _ in range(iterations):
        dx, dy = windows.columns - centres[:, 0, None, None], windows.rows - centres[:, 1, None, None]
        r = np.hypot(dx, dy)
        fourfold = 1 - 8 * (dx * dy / np.maximum(r * r, 1e-12)) ** 2
        value = np.interp(r / table.step, place, table.values[:, 0]) + fourfold * np.interp(r / table.step, place, table.values[:, 4])
        slope = np.interp(r / table.step, place, table.values[:, 1]) / np.maximum(r, 1e-9)
        level = windows.light * brightness[:, None, None]
        weight = np.where(windows.valid, 1 / noise.variance(noise.offset_dn + np.maximum(level * value, 0.0)), 0.0)
        rest = windows.read - level * value
        columns = np.stack([-level * slope * dx, -level * slope * dy, windows.light * value], axis=-1)
        normal = np.einsum("nij,nijk,nijm->nkm", weight, columns, columns)
        right = np.einsum("nij,nijk->nk", weight * rest, columns)
        chi2 = (weight * rest**2).sum(axis=(1, 2)) / np.maximum(windows.valid.sum(axis=(1, 2)) - 3, 1)
        scale = np.sqrt(np.maximum(np.einsum("nkk->nk", normal), 1e-300))
        scaled = normal / (scale[:, :, None] * scale[:, None, :])
        good = (np.linalg.det(scaled) > 1e-9) & (brightness > 1e-3)
        inverse = np.full((len(centres), 3, 3), np.inf)
        inverse[good] = np.linalg.inv(scaled[good]) / (scale[good][:, :, None] * scale[good][:, None, :])
        step = np.zeros((len(centres), 3))
        step[good] = np.einsum("nkm,nm->nk", inverse[good], right[good])
        step[:, :2] = np.clip(step[:, :2], -2.0, 2.0)
        centres += step[:, :2]
        brightness = np.clip(brightness + step[:, 2], 1e-3, 10.0)
    lost = np.hypot(*(centres - start).T) > windows.columns.shape[1] / 3
    inverse[lost] = np.inf
    return Spots(np.where(lost[:, None], start, centres), np.where(lost, 0.0, brightness), inverse, chi2)

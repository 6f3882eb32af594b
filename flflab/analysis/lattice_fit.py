"""Fit of one profile on an affine lattice to every pixel of a white picture: normal equations, band by band.

Model of a pixel at p: background + light(p) * sum over micro-images of profile(|p - origin - i a - j b|), where light is a
polynomial of second degree over the picture. Gauss-Newton with the weights of the sensor's noise.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt

from flflab.analysis.noise import SensorNoise
from flflab.analysis.profile import ProfileTable, profile_table

Array = npt.NDArray[np.float64]

COUNT = 15  # origin 2, lattice vectors 4, radii 2, background 1, polynomial 6
GEOMETRY = slice(0, 8)


@dataclass(frozen=True)
class LatticeModel:
    """What is fitted: ``values`` in the order origin x y, a x y, b x y, larger and smaller disc radius, background, light."""

    values: Array
    covariance: Array
    chi2_per_pixel: float

    @property
    def vectors(self) -> Array:
        """Lattice vectors a and b as the columns of a 2 x 2 matrix, px."""
        return np.array([[self.values[2], self.values[4]], [self.values[3], self.values[5]]])

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of the two discs, px, as fitted."""
        return float(self.values[6]), float(self.values[7])


@numba.njit(nogil=True, cache=True)
def _accumulate(
    picture: npt.NDArray[np.float32],
    rows: npt.NDArray[np.int64],
    columns: tuple[int, int],
    values: Array,
    inverse: Array,
    table: Array,
    step: float,
    neighbours: int,
    present: npt.NDArray[np.bool_],
    dark: float,
    gain: float,
    ceiling: float,
    offset_dn: float,
) -> tuple[Array, Array, float, int]:  # pragma: no cover - compiled
    normal = np.zeros((COUNT, COUNT))
    right = np.zeros(COUNT)
    g = np.zeros(COUNT)
    chi2 = 0.0
    count = 0
    height, width = picture.shape
    scale = 2.0 / max(height, width)
    half_i = present.shape[0] // 2
    half_j = present.shape[1] // 2
    reach = step * (table.shape[0] - 2)
    for row in rows:
        for column in range(columns[0], columns[1]):
            read = picture[row, column]
            if read >= ceiling:
                continue
            px = column - values[0]
            py = row - values[1]
            i0 = int(np.rint(inverse[0, 0] * px + inverse[0, 1] * py))
            j0 = int(np.rint(inverse[1, 0] * px + inverse[1, 1] * py))
            total = 0.0
            g[:8] = 0.0
            for i in range(i0 - neighbours, i0 + neighbours + 1):
                for j in range(j0 - neighbours, j0 + neighbours + 1):
                    dx = px - i * values[2] - j * values[4]
                    dy = py - i * values[3] - j * values[5]
                    square = dx * dx + dy * dy
                    if square >= reach * reach:
                        continue
                    if abs(i) > half_i or abs(j) > half_j or not present[i + half_i, j + half_j]:
                        continue
                    r = np.sqrt(square)
                    place = r / step
                    k = int(place)
                    t = place - k
                    fourfold = 1.0 - 8.0 * (dx * dy / max(square, 1e-12)) ** 2
                    total += (1.0 - t) * (table[k, 0] + fourfold * table[k, 4]) + t * (table[k + 1, 0] + fourfold * table[k + 1, 4])
                    slope = table[k, 1] + t * (table[k + 1, 1] - table[k, 1])
                    if slope != 0.0 and r > 0.0:
                        ex = -slope * dx / r
                        ey = -slope * dy / r
                        g[0] += ex
                        g[1] += ey
                        g[2] += i * ex
                        g[3] += i * ey
                        g[4] += j * ex
                        g[5] += j * ey
                    g[6] += table[k, 2] + t * (table[k + 1, 2] - table[k, 2])
                    g[7] += table[k, 3] + t * (table[k + 1, 3] - table[k, 3])
            x = (column - 0.5 * (width - 1)) * scale
            y = (row - 0.5 * (height - 1)) * scale
            light = values[9] + values[10] * x + values[11] * y + values[12] * x * x + values[13] * x * y + values[14] * y * y
            expected = values[8] + light * total
            weight = 1.0 / (dark + gain * max(expected - offset_dn, 0.0))
            rest = read - expected
            chi2 += weight * rest * rest
            count += 1
            if total == 0.0:
                normal[8, 8] += weight
                right[8] += weight * rest
                continue
            for n in range(8):
                g[n] *= light
            g[8] = 1.0
            g[9] = total
            g[10] = total * x
            g[11] = total * y
            g[12] = total * x * x
            g[13] = total * x * y
            g[14] = total * y * y
            for n in range(COUNT):
                weighted = weight * g[n]
                right[n] += weighted * rest
                for m in range(n, COUNT):
                    normal[n, m] += weighted * g[m]
    return normal, right, chi2, count


@numba.njit(nogil=True, cache=True)
def _brightness(
    picture: npt.NDArray[np.float32],
    values: Array,
    present: npt.NDArray[np.bool_],
    table: Array,
    step: float,
    ceiling: float,
) -> Array:  # pragma: no cover - compiled
    """Sums (read - background) profile and profile^2 about every lattice point, shape (i, j, 2)."""
    height, width = picture.shape
    half_i = present.shape[0] // 2
    half_j = present.shape[1] // 2
    reach = step * (table.shape[0] - 2)
    sums = np.zeros((present.shape[0], present.shape[1], 2))
    for i in range(-half_i, half_i + 1):
        for j in range(-half_j, half_j + 1):
            cx = values[0] + i * values[2] + j * values[4]
            cy = values[1] + i * values[3] + j * values[5]
            stride = max(1, int(reach / 12.0))
            for row in range(max(0, int(np.ceil(cy - reach))), min(height - 1, int(cy + reach)) + 1, stride):
                for column in range(max(0, int(np.ceil(cx - reach))), min(width - 1, int(cx + reach)) + 1, stride):
                    r = np.hypot(column - cx, row - cy)
                    if r < reach and picture[row, column] < ceiling:
                        share = table[int(r / step), 0]
                        sums[i + half_i, j + half_j, 0] += share * (picture[row, column] - values[8])
                        sums[i + half_i, j + half_j, 1] += share * share
    return sums


@dataclass(frozen=True)
class Region:
    """Pixels a fit looks at: half width in px about the picture's centre, and every how many rows."""

    half_size: float
    row_step: int


def _normal_equations(
    picture: npt.NDArray[np.float32],
    values: Array,
    table: ProfileTable,
    present: npt.NDArray[np.bool_],
    noise: SensorNoise,
    region: Region,
) -> tuple[Array, Array, float, int]:
    height, width = picture.shape
    vectors = np.array([[values[2], values[4]], [values[3], values[5]]])
    spacing = float(np.abs(np.linalg.det(vectors)) / np.linalg.norm(vectors, axis=0).max())
    neighbours = max(1, int(np.ceil(table.reach / spacing - 0.5)))
    top, bottom = max(0, int(height / 2 - region.half_size)), min(height, int(height / 2 + region.half_size) + 1)
    left, right_end = max(0, int(width / 2 - region.half_size)), min(width, int(width / 2 + region.half_size) + 1)
    rows = np.arange(top, bottom, region.row_step, dtype=np.int64)
    inverse = np.ascontiguousarray(np.linalg.inv(vectors))

    def band(rows: npt.NDArray[np.int64]) -> tuple[Array, Array, float, int]:
        return _accumulate(
            picture,
            rows,
            (left, right_end),
            values,
            inverse,
            table.values,
            table.step,
            neighbours,
            present,
            noise.dark_variance,
            noise.dn_per_electron,
            noise.full_scale_dn,
            noise.offset_dn,
        )

    workers = numba.get_num_threads()
    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(band, np.array_split(rows, 2 * workers)))
    normal = np.sum([part[0] for part in parts], axis=0)
    normal = np.triu(normal) + np.triu(normal, 1).T
    return normal, np.sum([part[1] for part in parts], axis=0), sum(part[2] for part in parts), sum(part[3] for part in parts)


def _solve(normal: Array, right: Array, free: npt.NDArray[np.int64]) -> tuple[Array, Array]:
    """The step and the covariance of the free parameters; directions the pixels do not see are left alone."""
    scale = np.sqrt(np.maximum(np.diag(normal)[free], 1e-300))
    scaled = normal[np.ix_(free, free)] / np.outer(scale, scale)
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    step, covariance = np.zeros(COUNT), np.zeros((COUNT, COUNT))
    step[free] = inverse @ (right[free] / scale) / scale
    covariance[np.ix_(free, free)] = inverse / np.outer(scale, scale)
    return step, covariance


def micro_images_present(
    picture: npt.NDArray[np.float32],
    model: LatticeModel,
    half_counts: tuple[int, int],
    noise: SensorNoise,
) -> npt.NDArray[np.bool_]:
    """Which lattice points have light where a micro-image would be; those off the picture count as present.

    Returns:
        Shape (2 half_i + 1, 2 half_j + 1), the lattice's origin in the middle.
    """
    everywhere = np.ones((2 * half_counts[0] + 1, 2 * half_counts[1] + 1), dtype=np.bool_)
    table = profile_table(*model.radii)
    sums = _brightness(picture, model.values, everywhere, table.values, table.step, noise.full_scale_dn)
    seen = sums[..., 1] > 0
    share = np.where(seen, sums[..., 0], 0.0) / np.where(seen, sums[..., 1], 1.0) / model.values[9]
    doubt = np.sqrt((noise.dark_variance + noise.dn_per_electron * model.values[9]) / np.where(seen, sums[..., 1], 1.0)) / model.values[9]
    return ~seen | (share > 0.5 - 5 * doubt)


def refine(
    picture: npt.NDArray[np.float32],
    model: LatticeModel,
    present: npt.NDArray[np.bool_],
    noise: SensorNoise,
    region: Region,
    free: npt.NDArray[np.int64],
    iterations: int,
    tolerance_px: float,
) -> LatticeModel:
    """Gauss-Newton on one region until no micro-image centre in it moves by more than ``tolerance_px``."""
    for _ in range(iterations):
        table = profile_table(*model.radii)
        normal, right, chi2, count = _normal_equations(picture, model.values, table, present, noise, region)
        step, covariance = _solve(normal, right, free)
        shrink = min(1.0, *(0.5 * model.values[k] / abs(step[k]) for k in (6, 7) if step[k] < 0), 1.0)
        values = model.values + shrink * step
        values[6:8] = np.maximum(values[6:8], 0.05)
        model = replace(model, values=values, covariance=covariance, chi2_per_pixel=chi2 / max(count, 1))
        if not np.isfinite(values).all():
            break
        periods = region.half_size / np.hypot(*model.values[2:4])
        if np.abs(step[:2]).max() + periods * np.abs(step[2:6]).max() < tolerance_px and np.abs(step[6:8]).max() < 20 * tolerance_px:
            break
    return model

"""Fit of a lattice's model to the pixels of a white picture: Gauss-Newton with the weights of the
sensor's noise, band by band.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.kernels import (
    COUNT,
    DERIVATIVES,
    Y,
    accumulate,
    brightness,
    gradient,
    own_profiles,
)
from flflab.measurement.lattice.model import (
    RATE,
    SHARE,
    SMALLEST_PX,
    TILT,
    WIDER,
    LatticeModel,
    laid,
)
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Band = TypeVar("Band")
Part = TypeVar("Part")

FEW_PIXELS = 20_000  # for which starting a thread takes longer than it saves
# times as far apart are the entries of profiles while the lattice is not yet known to the last
COARSER = 4.0
# prior standard deviations of share, slant (2), its rate over the cone's ``by_place``, tilt (2) and
# widths of kinds over those described
LOOSE = np.array([0.5, *[0.05] * 5, 0.1])


@dataclass(frozen=True)
class Region:
    """Pixels a fit looks at: half width in px about the picture's centre, and every how many rows
    and columns.
    """

    half_size: float
    row_step: int
    column_step: int = 1


def _neighbours(vectors: Array, reach: float) -> Whole:
    """Offsets (i, j) of the micro-images that can reach a point of the cell round a lattice
    point.
    """
    n = np.arange(-4, 5)
    offsets = np.stack([grid.ravel() for grid in np.meshgrid(n, n, indexing="ij")], axis=1)
    edge = np.linspace(-0.5, 0.5, 11)
    cell = (
        np.stack([grid.ravel() for grid in np.meshgrid(edge, edge, indexing="ij")], axis=1)
        @ vectors.T
    )
    apart = np.hypot(*(cell[None] - (offsets @ vectors.T)[:, None]).transpose(2, 0, 1)).min(axis=1)
    return offsets[apart < reach + 0.1 * np.linalg.norm(vectors[:, 0])]


def _each(call: Callable[[Band], Part], bands: Sequence[Band]) -> list[Part]:
    """What a call says of every band, several at a time."""
    if len(bands) == 1:
        return [call(bands[0])]
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(call, bands))


def _normal_equations(
    picture: npt.NDArray[np.float32],
    model: LatticeModel,
    present: npt.NDArray[np.bool_],
    noise: SensorNoise,
    region: Region,
    free: Whole,
    coarser: float = 1.0,
) -> tuple[Array, Array, float, int]:
    height, width = picture.shape
    points = laid(model, present, (height, width), coarser)
    top, bottom = (
        max(0, int(height / 2 - region.half_size)),
        min(height, int(height / 2 + region.half_size) + 1),
    )
    left, right_end = (
        max(0, int(width / 2 - region.half_size)),
        min(width, int(width / 2 + region.half_size) + 1),
    )
    rows = np.arange(top, bottom, region.row_step, dtype=np.int64)
    inverse = np.ascontiguousarray(np.linalg.inv(model.vectors), dtype=np.float64)
    arguments = (
        (left, right_end, region.column_step),
        model.values,
        inverse,
        points.tables,
        points.step,
        _neighbours(model.vectors, points.reach + points.shifted),
        points.lights,
        points.places,
        noise.dark_variance,
        noise.dn_per_electron,
        noise.full_scale_dn,
        noise.offset_dn,
        int(free.max()) + 1,
    )
    pixels = len(rows) * (right_end - left) // region.column_step
    bands = np.array_split(rows, 4 * numba.get_num_threads() if pixels > FEW_PIXELS else 1)
    parts = _each(lambda band: accumulate(picture, band, *arguments), bands)
    normal = np.sum([part[0] for part in parts], axis=0)
    return (
        normal,
        np.sum([part[1] for part in parts], axis=0),
        sum(part[2] for part in parts),
        sum(part[3] for part in parts),
    )


def _whole_gradient(
    picture: npt.NDArray[np.float32],
    model: LatticeModel,
    present: npt.NDArray[np.bool_],
    noise: SensorNoise,
) -> tuple[Array, float, int]:
    """Right side, chi^2 and number of pixels of the whole picture."""
    points = laid(model, present, (picture.shape[0], picture.shape[1]))
    i, j = np.nonzero(points.lights[..., 0])
    order = np.argsort(points.places[i, j, Y])
    i, j = i[order], j[order]
    derivatives = points.tables[..., DERIVATIVES]
    arguments = (
        model.values,
        own_profiles(points.tables, model.values, points.places[i, j]),
        ((derivatives[:, :-1] + derivatives[:, 1:]) / 2).astype(np.float32),
        points.step,
        np.stack([i - present.shape[0] // 2, j - present.shape[1] // 2], axis=1).astype(np.float64),
        points.lights[i, j],
        points.places[i, j],
        noise.dark_variance,
        noise.dn_per_electron,
        noise.full_scale_dn,
        noise.offset_dn,
    )
    edges = np.linspace(
        0, len(picture), (4 * numba.get_num_threads() if picture.size > FEW_PIXELS else 1) + 1
    ).astype(np.int64)
    parts = _each(
        lambda band: gradient(picture, band[0], band[1], *arguments), list(pairwise(edges.tolist()))
    )
    return (
        np.sum([part[0] for part in parts], axis=0),
        float(sum(part[1] for part in parts)),
        sum(part[2] for part in parts),
    )


def _prior(model: LatticeModel) -> tuple[Array, Array]:
    """Precision of what slants and kinds are expected to be where the pixels do not say, and how it
    pulls.
    """
    precision, middle = np.zeros(COUNT), np.zeros(COUNT)
    precision[SHARE:], middle[SHARE], middle[WIDER] = 1 / LOOSE**2, 0.5, 1.0
    if model.cone is not None:
        precision[RATE] /= model.cone.by_place**2
    if model.expected is not None:
        middle, precision = model.expected[0], 1 / model.expected[1] ** 2
    return precision, precision * (middle - model.values)


def _solve(normal: Array, right: Array, free: Whole) -> tuple[Array, Array]:
    """The step and the covariance of the free parameters; directions the pixels do not see are left
    alone.
    """
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
    """Which lattice points have light where a micro-image would be; those off the picture count as
    present.

    Returns:
        Shape (2 half_i + 1, 2 half_j + 1), the lattice's origin in the middle.
    """
    everywhere = np.ones((2 * half_counts[0] + 1, 2 * half_counts[1] + 1), dtype=np.bool_)
    points = laid(model, everywhere, (picture.shape[0], picture.shape[1]), COARSER)
    sums = brightness(
        picture,
        points.places,
        float(model.values[8]),
        points.tables,
        points.step,
        noise.full_scale_dn,
    )
    seen = sums[..., 1] > 0
    share = np.where(seen, sums[..., 0], 0.0) / np.where(seen, sums[..., 1], 1.0) / model.values[9]
    doubt = (
        np.sqrt(
            (noise.dark_variance + noise.dn_per_electron * model.values[9])
            / np.where(seen, sums[..., 1], 1.0)
        )
        / model.values[9]
    )
    return ~seen | (share > 0.5 - 5 * doubt)


def _stepped(
    model: LatticeModel, normal: Array, right: Array, free: Whole, chi2_per_pixel: float
) -> tuple[LatticeModel, Array]:
    """The model after one step of Gauss-Newton, and the step."""
    precision, pull = _prior(model)
    step, covariance = _solve(normal + np.diag(precision), right + pull, free)
    # far from the best the profile is not linear: no radius changes by more than half, no centre by
    # more than a seventh of the pitch
    longest = np.concatenate(
        [np.full(6, 0.15 * np.linalg.norm(model.vectors[:, 0])), 0.5 * model.values[6:8]]
    )
    shrink = float(np.min(longest / np.maximum(np.abs(step[:8]), 1e-300), initial=1.0))
    values = model.values + shrink * step
    values[6:8] = np.maximum(values[6:8], SMALLEST_PX)
    return replace(model, values=values, covariance=covariance, chi2_per_pixel=chi2_per_pixel), step


def refine(
    picture: npt.NDArray[np.float32],
    model: LatticeModel,
    present: npt.NDArray[np.bool_],
    noise: SensorNoise,
    region: Region,
    free: Whole,
    iterations: int,
    tolerance_px: float,
) -> LatticeModel:
    """Gauss-Newton on one region until no micro-image centre in it moves by more than
    ``tolerance_px``.
    """
    for _ in range(iterations):
        normal, right, chi2, count = _normal_equations(
            picture, model, present, noise, region, free, COARSER
        )
        model, step = _stepped(model, normal, right, free, chi2 / max(count, 1))
        if not np.isfinite(model.values).all():
            break
        periods = region.half_size / np.hypot(*model.values[2:4])
        moved = np.abs(step[:2]).max() + periods * np.abs(step[2:6]).max()
        if model.cone is not None:
            moved += model.cone.tilting.per_px * region.half_size**2 * np.abs(step[TILT]).max()
        if moved < tolerance_px and np.abs(step[6:8]).max() < 20 * tolerance_px:
            break
    return model


def finish(
    picture: npt.NDArray[np.float32],
    model: LatticeModel,
    present: npt.NDArray[np.bool_],
    noise: SensorNoise,
    region: Region,
    free: Whole,
) -> LatticeModel:
    """A step by a region's pixels, then one with the gradient of every pixel and that curvature: as
    good as the whole fit.
    """
    normal, right, chi2, sampled = _normal_equations(picture, model, present, noise, region, free)
    model = _stepped(model, normal, right, free, chi2 / max(sampled, 1))[0]
    right, chi2, count = _whole_gradient(picture, model, present, noise)
    return _stepped(model, normal * (count / max(sampled, 1)), right, free, chi2 / max(count, 1))[0]

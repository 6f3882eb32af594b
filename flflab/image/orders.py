"""How finely a picture is formed: where light can fall, how a pixel is divided, how many strips a blur needs."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from flflab.image.rim import STEEP, rim_tables
from flflab.image.setup import Setup
from flflab.optics.camera import pixel_positions

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

BAND_ROWS = 48
MOST_PARTS = 8
MOST_STRIPS = 128


def lit_windows(setup: Setup, half_x: float, half_y: float) -> Whole:
    """Where a microlens's light from a box on the target can fall.

    Args:
        setup: what is formed.
        half_x: half the box's width, target mm; infinity for no bounds.
        half_y: half its height.

    Returns:
        First column, column after the last, first row, row after the last; shape (N, 4).
    """
    pupils, pixel = setup.pupils, setup.sensor.pixel
    xs, ys = pixel_positions(setup.sensor)
    outside = pupils.outside + pixel
    limits: list[Array] = []
    for axis, centre, half, positions in ((0, pupils.centre_x, half_x, xs), (1, pupils.centre_y, half_y, ys)):
        spread, scale = setup.by_pupil[:, axis, axis], setup.by_sensor[:, axis, axis]
        reach = half + np.abs(spread) + np.abs(scale) * pixel
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = -setup.origin[:, axis] / scale
            lowest = np.fmax(-outside, middle - reach / np.abs(scale))
            highest = np.fmin(outside, middle + reach / np.abs(scale))
        low, high = positions[0] - pixel, positions[-1] + pixel
        start = np.ceil((np.clip(centre + lowest, low, high) - positions[0]) / pixel)
        end = np.floor((np.clip(centre + highest, low, high) - positions[0]) / pixel) + 1
        limits += [start, np.where(lowest < highest, end, 0)]
    sizes = np.array([len(xs), len(xs), len(ys), len(ys)])
    return np.clip(np.stack(limits, axis=1), 0, sizes).astype(np.int64)


def pixel_parts(setup: Setup) -> tuple[Whole, npt.NDArray[np.bool_]]:
    """Into how many parts a side a pixel is divided for each kind of rim, and which kinds are steep.

    Inside a pixel light and rim vary together: a step of the target in a rim w pixels wide leaves an error of up to
    0.17 / (w n^2) of white, less where the step is blurred (found as the root of the blur in pixels).
    """
    width = np.maximum(setup.rims.width, 1e-9)
    blur = np.maximum(setup.kind_blur(largest=False), 1.0)
    parts = np.clip(np.ceil(np.sqrt(0.34 / (width * setup.tolerance * np.sqrt(blur)))), 1, MOST_PARTS)
    parts = np.where(width * parts < STEEP, MOST_PARTS, parts)
    return parts.astype(np.int64), width * parts < STEEP


def rim_rows(setup: Setup, parts: Whole, steep: npt.NDArray[np.bool_]) -> Array:
    """The tables of the rims' light; those of steep kinds start with a negative distance."""
    tables = rim_tables(setup.rims, setup.sensor.pixel / float(parts.max()), steep)
    tables[steep, 0] = -1.0
    return tables


def strip_counts(blur: Array, tolerance: float) -> Whole:
    """How many strips across the pupil a blur in pixels needs; 0 where the blur itself is below the tolerance.

    Measured on square bars: n strips leave 0.08 blur / n^2 of white for small blurs; for large ones 9 + 0.6 blur leave 0.0012.
    """
    allowed = 0.5 * tolerance
    small = np.sqrt(0.08 * blur / allowed)
    large = (9 + 0.6 * np.minimum(blur, 1e4)) * np.sqrt(0.0012 / allowed)
    counts = np.ceil(np.minimum(small, large))
    counts = np.where(0.42 * blur < allowed, 0, np.maximum(counts, 2))
    return np.clip(counts, 0, MOST_STRIPS).astype(np.int64)


def grid_counts(blur: Array, tolerance: float) -> Whole:
    """How many points a side across the pupil a blur in pixels needs; measured on dots: n of them leave 0.1 blur / n^2 of white."""
    return np.clip(np.ceil(np.sqrt(0.1 * blur / (0.6 * tolerance))), 1, MOST_STRIPS).astype(np.int64)


def spot_parts(blur: Array, tolerance: float) -> Whole:
    """Into how many parts a side a pixel is divided for the three-disc formula; n of them leave 0.07 / (n^2 sqrt(blur)) of white."""
    parts = np.ceil(np.sqrt(0.07 / (np.sqrt(np.maximum(blur, 0.1)) * 0.6 * tolerance)))
    return np.clip(parts, 2, 4 * MOST_PARTS).astype(np.int64)


def in_bands(add: Callable[[tuple[int, int]], None], windows: Whole) -> None:
    """Call ``add`` for bands of rows that hold light, on all cores; bands share no row, so overlapping light adds up safely."""
    lit = windows[(windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3])]
    if not len(lit):
        return
    first, last = int(lit[:, 2].min()), int(lit[:, 3].max())
    bands = [(start, min(start + BAND_ROWS, last)) for start in range(first, last, BAND_ROWS)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(add, bands))

"""The edge-based spatial frequency response of ISO 12233, beside the fits as a check: pixels binned
by their distance from the edge, four bins a pixel, differenced, windowed, transformed.

It assumes nothing of the blur, but takes the light of both sides for even and windows a skirt away;
finite differences and bins are corrected for.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.measurement.edges.edge import Edge

Array = npt.NDArray[np.float64]

BINS = 4  # a pixel
HALF_PX = 16.0  # of the line spread, at most
LEAST_HALF_PX = 4.0


def esfr(edge: Edge, cycles_per_px: Array) -> Array:
    """Response along the edge's normal, shape of the frequencies; nan where bins are empty or the
    edge lies too near the pixels' border.
    """
    t = edge.distance
    half = min(HALF_PX, float(t.max()), float(-t.min()))
    nothing = np.full(len(cycles_per_px), np.nan)
    if half < max(LEAST_HALF_PX, 4 * edge.blur_px):
        return nothing
    count = 2 * int(half * BINS)
    cell = np.floor(t * BINS).astype(np.int64) + count // 2
    inside = (cell >= 0) & (cell < count)
    number = np.bincount(cell[inside], minlength=count)
    if not number.all():
        return nothing
    profile = np.bincount(cell[inside], edge.pixels.values[inside], minlength=count) / number
    line = (profile[2:] - profile[:-2]) * np.hamming(count)[1:-1]
    at = (np.arange(1, count - 1) + 0.5 - count / 2) / BINS
    waves = np.exp(-2j * math.pi * cycles_per_px[:, None] * at)
    found = np.abs(waves @ line) / abs(line.sum())
    # a difference over two bins, and the mean over each of them
    return found / np.sinc(2 * cycles_per_px / BINS) / np.sinc(cycles_per_px / BINS)

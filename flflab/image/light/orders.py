"""How finely a picture is formed: where light can fall, how a pixel is divided, how many strips a
blur needs.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.geometry.rim import TABLE_STEPS, rim_tables
from flflab.image.geometry.setup import Setup
from flflab.optics.camera import pixel_positions

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

BAND_ROWS = 232
MOST_PARTS, MOST_RIM_PARTS, MOST_SPOT_PARTS = (
    32,
    128,
    128,
)  # of a pixel a side, of one on a rim, of one that sees a blurred dot's rim
STEEP_PARTS = 8
# of white, times the square of the number of parts and the rim's width in pixels: what an edge
# leaves in a pixel on a rim
SHARP = 0.17
# the same, at most, where it is blurred; rims 0.03 to 8 pixels wide, bars and texels of all widths,
# blurs of 1 to 60 pixels
BLURRED = 0.12
NEAR = 6.0  # pixels from the centre: a rim that begins nearer gives the light a tip
MOST_STEPS = 16384
LEAST_STRIPS = 3
MOST_STRIPS = 512
MOST_POINTS = 128


def lit_windows(setup: Setup, half_x: float, half_y: float) -> Whole:
    """Where an entry's light from a box on the target can fall.

    Args:
        setup: what is formed.
        half_x: half the box's width, target mm; infinity for no bounds.
        half_y: half its height.

    Returns:
        First column, column after the last, first row, row after the last; shape (N, 4).
    """
    pupils, pixel = setup.pupils, setup.sensor.pixel
    outside = pupils.outside + pixel
    lowest, highest = np.stack([-outside, -outside], axis=1), np.stack([outside, outside], axis=1)
    determinant = np.linalg.det(setup.by_sensor)
    bounded = (determinant != 0) & math.isfinite(half_x + half_y)
    if np.any(bounded):
        inverse = np.linalg.inv(setup.by_sensor[bounded])
        reach = np.array([half_x, half_y]) + np.linalg.norm(setup.by_pupil[bounded], axis=2)
        middle = -np.einsum("nij,nj->ni", inverse, setup.origin[bounded])
        half = np.einsum("nij,nj->ni", np.abs(inverse), reach) + pixel
        lowest[bounded] = np.maximum(lowest[bounded], middle - half)
        highest[bounded] = np.minimum(highest[bounded], middle + half)
    farthest = (
        np.linalg.norm(setup.by_pupil, axis=2)
        + np.abs(setup.by_sensor).sum(axis=2) * outside[:, None]
    )
    highest[
        (np.abs(setup.origin) > np.array([half_x, half_y]) + farthest).any(axis=1)
    ] = -np.inf  # none of its rays meets the box
    limits: list[Array] = []
    for axis, (centre, positions) in enumerate(
        zip((pupils.centre_x, pupils.centre_y), pixel_positions(setup.sensor), strict=True)
    ):
        low, high = positions[0] - pixel, positions[-1] + pixel
        start = np.ceil((np.clip(centre + lowest[:, axis], low, high) - positions[0]) / pixel)
        end = np.floor((np.clip(centre + highest[:, axis], low, high) - positions[0]) / pixel) + 1
        end = np.where(lowest[:, axis] < highest[:, axis], end, 0)
        limits += [
            np.maximum(start, setup.window[:, 2 * axis]),
            np.minimum(end, setup.window[:, 2 * axis + 1]),
        ]
    columns, rows = setup.sensor.resolution
    return np.clip(np.stack(limits, axis=1), 0, [columns, columns, rows, rows]).astype(np.int64)


def is_sharp(setup: Setup) -> Flags:
    """In which entries the blur of a point is below what the tolerance can tell, shape (N,)."""
    return 0.42 * setup.blur < 0.5 * setup.tolerance / setup.overlap


@dataclass(frozen=True)
class OnRims:
    """What a target leaves of white where light and rim vary together inside a pixel, in a rim w
    pixels wide, n parts a side.

    Measured on square bars and on black and white texels, in rims 6 to 48 pixels wide.

    Attributes:
        edge: edge / (w b^power n^2) in blurs of b pixels, from 1 up.
        power: see ``edge``.
        ends: ends / (w n)^2 where strips end at the rim, and no more than BLURRED / (w n^2).
        tip: tip / (w n^2) where a rim begins near the centre: the light of a square is no function
            of its distance alone there.
    """

    edge: float
    power: float
    ends: float
    tip: float


BARS, TEXELS = OnRims(0.085, 1.0, 0.9, 0.1), OnRims(0.16, 0.5, 2.7, 0.1)
TIP = 0.012  # of white itself, as ``OnRims.tip``


def left_at_tips(setup: Setup, tip: float) -> Array:
    """What a whole pixel leaves of white where a rim begins near the centre, shape (K,); see
    ``OnRims.tip``.
    """
    begins = np.abs(setup.rims.reach - setup.rims.slope)
    return np.where(
        begins < NEAR * setup.pixel_width, tip / np.maximum(setup.rims.width, 1e-9), 0.0
    )


def pixel_parts(setup: Setup, sharp: Flags, left: OnRims = BARS) -> tuple[Whole, Flags]:
    """Into how many parts a side a pixel in the rim is divided for each kind of rim, and which
    kinds are steep.

    Where an entry is sharp an edge leaves SHARP / (w n^2) of white, in others what is ``left``;
    overlapping micro-images add theirs up. A steep kind's rim is narrower than such a part, and
    leaves 0.1 w in all, measured.
    """
    width, allowed = np.maximum(setup.rims.width, 1e-9), 0.5 * setup.tolerance / setup.overlap
    any_sharp = np.bincount(setup.rims.kind[sharp], minlength=len(width)) > 0
    softened = left.edge / np.maximum(setup.kind_blur(largest=False), 1.0) ** left.power
    leaves = (
        np.where(any_sharp, SHARP, np.maximum(softened, np.minimum(left.ends / width, BLURRED)))
        / width
    )
    parts = np.sqrt(np.maximum(leaves, left_at_tips(setup, left.tip)) / allowed)
    parts = np.clip(np.ceil(parts), 1, MOST_RIM_PARTS)
    if setup.pixel_width == 0:
        return np.ones(len(width), dtype=np.int64), setup.rims.slope == 0
    steep = width * parts < 1
    return np.where(steep, STEEP_PARTS, parts).astype(np.int64), steep


def rim_rows(setup: Setup, parts: Whole, steep: Flags) -> Array:
    """The tables of the rims' light for pixels divided into so many parts a side; n steps leave 0.2
    to 3 / n^1.5 of white.
    """
    steps = int(np.clip((0.035 * setup.tolerance) ** (-1 / 1.5), TABLE_STEPS, MOST_STEPS))
    unseen = np.bincount(setup.rims.kind, minlength=len(steep)) == 0
    return rim_tables(setup.rims, setup.pixel_width / parts, steep | unseen, steps)


def strip_counts(setup: Setup, roughness: float = 1.0) -> Whole:
    """How many strips across the pupil each kind of rim needs, (K, 2): in most pixels, and where
    the target's height ends.

    Measured on square bars, 8 strips leave at most 0.001 + 0.00045 blur + 0.000016 blur^2 of white,
    never more than 0.03, and n strips, from 2 up, the power -2.2 of that; a target with
    ``roughness`` leaves that times more.
    """
    blur = setup.kind_blur(largest=True)
    allowed = 0.5 * setup.tolerance / setup.overlap
    eight = np.minimum(
        0.001 + 0.00045 * np.minimum(blur, 1e4) + 1.6e-5 * np.minimum(blur, 1e4) ** 2, 0.03
    )
    counts = np.clip(
        np.ceil(8 * (roughness * eight / allowed) ** (1 / 2.2)), LEAST_STRIPS, MOST_STRIPS
    )
    return np.stack([counts, np.where(blur > 0, 4 * counts, LEAST_STRIPS)], axis=1).astype(np.int64)


def grid_counts(blur: Array, tolerance: float) -> Whole:
    """How many points a side across the pupil a blur in pixels needs.

    Measured on dots 0.3 to 210 pixels in radius: n of them leave at most c blur / n^2 of white,
    where c is 0.18 in blurs up to 2.6 pixels and grows with the blur to 0.5.
    """
    left = np.clip(0.07 * blur, 0.18, 0.5) * blur
    return np.clip(np.ceil(np.sqrt(left / (0.6 * tolerance))), 1, MOST_POINTS).astype(np.int64)


def spot_parts(blur: Array, tolerance: float) -> Whole:
    """Into how many parts a side a pixel is divided for the three-disc formula; n of them leave
    0.07 / (n^2 sqrt(blur)) of white.
    """
    parts = np.ceil(np.sqrt(0.07 / (np.sqrt(np.maximum(blur, 0.1)) * 0.6 * tolerance)))
    return np.clip(parts, 2, MOST_SPOT_PARTS).astype(np.int64)


def in_bands(
    add: Callable[[tuple[int, int]], None], windows: Whole, height: int = BAND_ROWS
) -> None:
    """Call ``add`` for bands of so many rows that hold light, on all cores; bands share no row, so
    overlapping light adds up safely.
    """
    lit = windows[(windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3])]
    if not len(lit):
        return
    first, last = int(lit[:, 2].min()), int(lit[:, 3].max())
    bands = [(start, min(start + height, last)) for start in range(first, last, height)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(add, bands))

"""How finely a target is formed on which pixels stand askew: points of the pupil, and parts of a
pixel.
"""

import numpy as np
import numpy.typing as npt

from flflab.image.geometry.setup import Setup
from flflab.image.light.falloff_orders import falloff_counts
from flflab.image.light.orders import MOST_PARTS, MOST_POINTS, is_sharp

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SLIGHT = (
    1.5  # pixels of blur: up to here points of the pupil are cheaper than strips on a picture askew
)


def is_even(maps: Array, tolerance: float) -> bool:
    """Whether maps to the target (N, 2, 2) keep the directions of rows and columns, as far as the
    tolerance can tell.
    """
    off = np.abs(maps[:, [0, 1], [1, 0]]).max(axis=1)
    return bool(np.all(off <= 0.5 * tolerance * np.abs(maps[:, [0, 1], [0, 1]]).max(axis=1)))


def is_turn(maps: Array, tolerance: float) -> bool:
    """Whether maps (N, 2, 2) are turns with one scale, as far as the tolerance can tell."""
    skew = np.hypot(maps[:, 0, 0] - maps[:, 1, 1], maps[:, 0, 1] + maps[:, 1, 0])
    return bool(
        np.all(
            skew
            <= tolerance * np.hypot(maps[:, 0, 0] + maps[:, 1, 1], maps[:, 0, 1] - maps[:, 1, 0])
        )
    )


def askew_points(setup: Setup) -> Whole:
    """How many points a side across the pupil a target needs that pixels stand askew on, each a
    parallelogram; shape (N,).

    Measured on black and white texels of 0.25 to 4 pixels: in a blur of b pixels n points leave up
    to 1.25 b^2 / n^3 of white. As many as the fall-off needs, however slight the blur.
    """
    points = np.ceil(np.cbrt(1.25 * np.minimum(setup.blur, 1e4) ** 2 / _allowed(setup)))
    return np.clip(
        np.maximum(points, falloff_counts(setup)[setup.rims.kind]), 1, MOST_POINTS
    ).astype(np.int64)


def picture_points(setup: Setup) -> Whole:
    """The same for pictures; 0 where these lie along the pixels, are sharp, or so blurred that
    strips are cheaper.
    """
    slight = ~is_sharp(setup) & (setup.blur < SLIGHT)
    return np.where(
        slight & (not is_even(setup.by_sensor, setup.tolerance)), askew_points(setup), 0
    )


def picture_parts(setup: Setup) -> Whole:
    """Into how many parts a side a pixel is divided that strips are to see, shape (N,).

    A part that stands askew on a picture counts as a square along its axes. Measured as in
    ``askew_points``: n parts leave up to 0.03 / (b^2 n^3) of white.
    """
    if is_even(setup.by_sensor, setup.tolerance):
        return np.ones(len(setup.blur), dtype=np.int64)
    parts = np.cbrt(0.03 / (np.maximum(setup.blur, SLIGHT) ** 2 * _allowed(setup)))
    return np.clip(np.ceil(parts), 1, MOST_PARTS).astype(np.int64)


def end_points(setup: Setup) -> Whole:
    """Points as ``askew_points`` for the ends of bars, shape (N,); 0 where these are sharp, or
    strips are right.

    Strips count a pixel's light along and across the bars apart. Measured on bars turned by 0.1 to
    0.8 rad, that leaves 0.1 of the sides' slope, up to 0.03 of white, the less the more they are
    blurred.
    """
    sides = np.sort(np.abs(setup.by_sensor), axis=2)
    slope = (sides[:, :, 0] / np.maximum(sides[:, :, 1], 1e-300)).max(axis=1)
    left = np.minimum(0.1 * slope, 0.03) / (1 + 5 * setup.blur**2)
    return np.where(~is_sharp(setup) & (left > _allowed(setup)), askew_points(setup), 0)


def _allowed(setup: Setup) -> float:
    return 0.5 * setup.tolerance / setup.overlap

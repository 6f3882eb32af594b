"""A step of Gauss-Newton for spots that share focus, softness and radius: summed over their pixels
on all cores, solved together.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.spots.fit import DARKEST, LIT, Lit, Spots, moved_by
from flflab.measurement.spots.focus import SHARE_OF_SOFTER, Focus, common_step
from flflab.measurement.spots.law import Square

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SHARED = 6  # x, y, brightness, and of the frame blur, softness, radius


@numba.njit(cache=True, nogil=True, error_model="numpy")
def count_pixel(
    normal: Array, right: Array, slopes: Array, rest: float, weight: float
) -> None:  # pragma: no cover - compiled
    """Add a pixel to a spot's normal matrix, its lower half, and right side.

    Args:
        normal: shape (6, 6).
        right: shape (6,).
        slopes: of its light by each number.
        rest: what the fit leaves of it.
        weight: one over its variance.
    """
    for i in range(SHARED):
        right[i] += weight * rest * slopes[i]
        for j in range(i + 1):
            normal[i, j] += weight * slopes[i] * slopes[j]


def on_all_cores(
    sums: Callable[[Whole], tuple[Array, Array, Array, Array]], which: Whole
) -> tuple[Array, Array, Array]:
    """Normal matrices, right sides and chi squared a pixel of the spots at these positions.

    Args:
        sums: gives, for the spots at some positions, lower halves of normal matrices, right sides,
            chi squared and numbers of pixels.
        which: positions.
    """
    parts = np.array_split(which, numba.get_num_threads())
    with ThreadPoolExecutor(len(parts)) as pool:
        lower, right, misfit, count = (
            np.concatenate(part) for part in zip(*pool.map(sums, parts), strict=True)
        )
    return lower + np.tril(lower, -1).swapaxes(1, 2), right, misfit / np.maximum(count - 3, 1)


def stepped(
    spots: Spots,
    which: Whole,
    own: Lit,
    summed: tuple[Array, Array, Array],
    focus: Focus,
    radius: float,
    square: Square,
    moved: float,
    astray: float = SHARE_OF_SOFTER,
) -> tuple[Spots, Focus, float]:
    """The spots at positions ``which`` after a step together, and the focus and radius that they
    then show; the others stay.

    Args:
        spots: as they are known.
        which: positions of those that are fitted.
        own: micro-images of all.
        summed: see ``on_all_cores``, by (x, y, brightness) of each and blur, softness and radius of
            the frame.
        focus: as it is known.
        radius: of a spot in focus, px, as it is known.
        square: what the law says of it.
        moved: by how much spots moved last, px; infinite as long as they are not where they belong.
        astray: see ``common_step``.
    """
    normal, right, chi2 = summed
    mine = spots.those(which)
    lit = own.share_at(spots.centres)[which] > LIT
    bright = mine.brightness > DARKEST
    step = common_step(
        normal,
        right,
        chi2,
        bright,
        lit,
        focus,
        radius,
        square.those(which),
        math.isinf(moved),
        astray,
    )
    new = moved_by(np.concatenate([mine.centres, mine.brightness[:, None]], axis=1), step.steps)
    fitted = Spots(new[:, :2], new[:, 2], step.covariance, chi2, step.together)
    return spots.with_those(which, fitted), step.focus, step.radius

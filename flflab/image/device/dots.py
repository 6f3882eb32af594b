"""One pixel of a dot, as a thread works it out."""

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.device.pieces import Pieces, holds
from flflab.image.light.sampled import DotSeen, dot_light

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def dot_pixel(
    light: float, row: int, column: int, near: Whole, room: Array, pieces: Pieces, seen: DotSeen
) -> float:
    """The light of a pixel with what it gets through the entries near it, in their order.

    Args:
        light: of the pixel before.
        row: of the pixel.
        column: the same.
        near: the pieces that may hold the pixel, see ``pieces_by_block``.
        room: scratch, shape (MOST_SQUARES, 3).
        pieces: all pieces.
        seen: the dot.
    """
    lenses = seen.lenses
    for piece in near:
        if holds(pieces.windows[piece], row, column, lenses.wanted):
            entry = int(pieces.entries[piece])
            dx, dy = (
                lenses.xs[column] - lenses.centres[entry, 0],
                lenses.ys[row] - lenses.centres[entry, 1],
            )
            light += float(lenses.levels[entry]) * dot_light(dx, dy, entry, seen, room)
    return light

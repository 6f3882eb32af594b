"""One pixel of a picture, as a thread works it out, and the tables of texels that the pieces of
micro-images read from.
"""

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.device.pieces import Pieces, holds
from flflab.image.light.texel_sums import fill_sums
from flflab.image.light.texels import FRAME, PictureSeen, picture_lens, seen_texels, texel_light

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

ROOM = 3  # numbers to work in


class TexelTables(NamedTuple):
    """What every piece of a micro-image sees of a picture.

    Attributes:
        held: summed-area tables one below the other, as wide as the widest, see ``fill_sums``.
        begins: where each piece's rows begin, (M + 1); a piece that sees no texel has none.
        widths: its columns, (M,).
        frames: see ``seen_texels``, (M, FRAME).
    """

    held: Array
    begins: Whole
    widths: Whole
    frames: Array


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_tables(pieces: Pieces, seen: PictureSeen, most: int) -> TexelTables:
    """Gather what the pieces see; nothing is held where that would be more than ``most``
    numbers.
    """
    count = len(pieces.entries)
    begins, widths, frames = (
        np.zeros(count + 1, dtype=np.int64),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, FRAME)),
    )
    inside = np.zeros((count, 4), dtype=np.int64)
    for piece in range(count):
        inside[piece] = seen_texels(
            seen, int(pieces.entries[piece]), pieces.windows[piece], frames[piece]
        )
        begins[piece + 1] = begins[piece]
        if inside[piece, 2] > 0 and inside[piece, 3] > 0:
            begins[piece + 1] += inside[piece, 3] + 1
            widths[piece] = inside[piece, 2] + 1
    widest = int(widths.max()) if count > 0 else 0
    if 2 * widest * begins[-1] > most:
        return TexelTables(np.empty((0, 0, 2)), begins, widths, frames)
    held = np.empty((begins[-1], widest, 2))
    for piece in range(count):
        if widths[piece] > 0:
            column, row, columns, rows = inside[piece]
            held[begins[piece] : begins[piece + 1], : widths[piece]] = fill_sums(
                seen.values, column, row, columns, rows
            )
    return TexelTables(held, begins, widths, frames)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_pixel(
    light: float,
    row: int,
    column: int,
    near: Whole,
    room: Array,
    pieces: Pieces,
    tables: TexelTables,
    seen: PictureSeen,
) -> float:
    """The light of a pixel with what it gets through the entries near it, in their order.

    Args:
        light: of the pixel before.
        row: of the pixel.
        column: the same.
        near: the pieces that may hold the pixel, see ``pieces_by_block``.
        room: scratch, shape (ROOM,).
        pieces: all pieces.
        tables: what they see.
        seen: the picture.
    """
    lenses = seen.lenses
    for piece in near:
        if tables.widths[piece] > 0 and holds(pieces.windows[piece], row, column, lenses.wanted):
            entry = int(pieces.entries[piece])
            dx, dy = (
                lenses.xs[column] - lenses.centres[entry, 0],
                lenses.ys[row] - lenses.centres[entry, 1],
            )
            sums = tables.held[
                tables.begins[piece] : tables.begins[piece + 1], : tables.widths[piece]
            ]
            frame, areas = tables.frames[piece], sums[:, :, 0]
            light += float(lenses.levels[entry]) * texel_light(
                dx, dy, picture_lens(seen, entry), frame, sums, areas, room
            )
    return light

"""The pixels that entries light, cut as the processor cuts them, and which of these pieces every
block of a device's threads looks at.
"""

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.geometry.tiles import shrink

Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

WIDE, HIGH = 32, 8  # threads of a block: neighbours in a row read and write together


class Pieces(NamedTuple):
    """Parts of the entries' windows.

    Attributes:
        windows: first column, column after the last, first row, row after the last, of every piece;
            shape (M, 4).
        entries: the entry of each.
    """

    windows: Whole
    entries: Whole


@numba.njit(cache=True, nogil=True, error_model="numpy")
def holds(window: Whole, row: int, column: int, wanted: Chosen) -> bool:
    """Whether a pixel lies in a window, and is wanted."""
    if column < window[0] or column >= window[1] or row < window[2] or row >= window[3]:
        return False
    return wanted.size == 0 or wanted[row, column]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cut_windows(windows: Whole, height: int, wanted: Chosen) -> Pieces:
    """Cut windows into bands of rows, and shrink them to the wanted pixels.

    The tables that a kernel makes of an entry depend on where its piece of a window begins and
    ends: cut alike, they are the same.

    Args:
        windows: first column, column after the last, first row, row after the last, of every entry;
            shape (N, 4).
        height: rows of a band; the first begins where any light does.
        wanted: which pixels to compute, [row, column]; empty for all.

    Returns:
        The pieces, band by band and in each in the order of the entries.
    """
    lit = (windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3])
    first, last, most = 0, 0, 0
    if lit.any():
        first, last = int(windows[lit, 2].min()), int(windows[lit, 3].max())
    for entry in range(windows.shape[0]):
        if lit[entry]:
            most += (
                (windows[entry, 3] - 1 - first) // height
                - (windows[entry, 2] - first) // height
                + 1
            )
    pieces, entries, count = np.empty((most, 4), dtype=np.int64), np.empty(most, dtype=np.int64), 0
    for band in range(first, last, height):
        for entry in range(windows.shape[0]):
            start, end = int(windows[entry, 0]), int(windows[entry, 1])
            low, high = (
                max(band, int(windows[entry, 2])),
                min(band + height, int(windows[entry, 3])),
            )
            if wanted.size > 0:
                start, end, low, high = shrink(wanted, start, end, low, high)
            if lit[entry] and start < end and low < high:
                pieces[count, 0], pieces[count, 1], pieces[count, 2], pieces[count, 3] = (
                    start,
                    end,
                    low,
                    high,
                )
                entries[count] = entry
                count += 1
    return Pieces(pieces[:count].copy(), entries[:count].copy())


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pieces_by_block(pieces: Whole, rows: int, columns: int) -> tuple[Whole, Whole]:
    """Which windows of pieces reach the pixels of each block of threads.

    Returns:
        Where each block's pieces begin in the list, row by row of blocks, shape (B + 1,), and the
        list, in each block in ascending order.
    """
    across = (columns + WIDE - 1) // WIDE
    counts = np.zeros(across * ((rows + HIGH - 1) // HIGH) + 1, dtype=np.int64)
    for piece in range(pieces.shape[0]):
        for y in range(pieces[piece, 2] // HIGH, (pieces[piece, 3] - 1) // HIGH + 1):
            for x in range(pieces[piece, 0] // WIDE, (pieces[piece, 1] - 1) // WIDE + 1):
                counts[y * across + x + 1] += 1
    begins = np.cumsum(counts)
    listed, filled = np.empty(begins[-1], dtype=np.int64), begins.copy()
    for piece in range(pieces.shape[0]):
        for y in range(pieces[piece, 2] // HIGH, (pieces[piece, 3] - 1) // HIGH + 1):
            for x in range(pieces[piece, 0] // WIDE, (pieces[piece, 1] - 1) // WIDE + 1):
                listed[filled[y * across + x]] = piece
                filled[y * across + x] += 1
    return begins, listed

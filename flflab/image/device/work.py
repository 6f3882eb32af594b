"""What a device is given to work on: a target seen through all entries, as arrays, and the function
that works out one pixel of it.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from flflab.image.device.pieces import HIGH, Pieces, cut_windows, pieces_by_block
from flflab.image.device.ruled import RuledTables, ruled_tables
from flflab.image.device.texels import texel_tables
from flflab.image.light.orders import BAND_ROWS
from flflab.image.light.ruled_seen import RuledSeen
from flflab.image.light.sampled import DotSeen
from flflab.image.light.texels import PictureSeen

Whole = npt.NDArray[np.int64]

MOST = (
    2**27
)  # numbers in tables, 1 GiB: more are left to the processor, which makes one table at a time


class Work(NamedTuple):
    """One plane for a device.

    Attributes:
        rows: the first row with light, down to a whole block of threads, and the one after the
            last.
        begins: where the list of every block of threads begins, see ``pieces_by_block``.
        listed: the lists.
        arguments: what a pixel's function is given from the pieces on.
    """

    rows: tuple[int, int]
    begins: Whole
    listed: Whole
    arguments: tuple[Any, ...]


def ruled_work(shape: tuple[int, int], windows: Whole, seen: RuledSeen) -> Work | None:
    """What ``ruled_pixel`` needs for a picture of this shape; None where that is too much."""
    pieces = cut_windows(windows, BAND_ROWS, seen.lenses.wanted)
    ends, most = (
        np.linspace(0, len(pieces.entries), 4 * (os.cpu_count() or 1) + 1).astype(int),
        MOST // (4 * (os.cpu_count() or 1)),
    )
    some = [
        Pieces(pieces.windows[start:end], pieces.entries[start:end])
        for start, end in pairwise(ends)
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = list(pool.map(lambda part: ruled_tables(part, seen, most), some))
    if max(part.begins[-1] for part in parts) > most:
        return None
    sizes = np.concatenate([np.diff(part.begins) for part in parts])
    held, places, boxes = (
        np.concatenate(ones)
        for ones in zip(*((p.held, p.places, p.boxes) for p in parts), strict=True)
    )
    return _work(
        shape,
        pieces,
        RuledTables(held, np.concatenate([[0], np.cumsum(sizes)]), places, boxes),
        seen,
    )


def dots_work(shape: tuple[int, int], windows: Whole, seen: DotSeen) -> Work:
    """What ``dot_pixel`` needs."""
    return _work(shape, cut_windows(windows, BAND_ROWS, seen.lenses.wanted), seen)


def texels_work(shape: tuple[int, int], windows: Whole, seen: PictureSeen) -> Work | None:
    """What ``texel_pixel`` needs; None where that is too much."""
    pieces = cut_windows(windows, BAND_ROWS, seen.lenses.wanted)
    tables = texel_tables(pieces, seen, MOST)
    if len(tables.held) < tables.begins[-1]:
        return None
    return _work(shape, pieces, tables, seen)


def _work(shape: tuple[int, int], pieces: Pieces, *seen: Any) -> Work:
    lit = pieces.windows
    rows = (int(lit[:, 2].min()) // HIGH * HIGH, int(lit[:, 3].max())) if len(lit) else (0, 0)
    return Work(rows, *pieces_by_block(lit, *shape), (pieces, *seen))

"""What a device is given to work on: a target seen through all entries, as arrays, and the function that works out one pixel of it."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from flflab.image.device.pieces import HIGH, cut_windows, pieces_by_block
from flflab.image.device.ruled import ruled_tables
from flflab.image.device.texels import texel_tables
from flflab.image.orders import BAND_ROWS

Whole = npt.NDArray[np.int64]

MOST = 2**27  # numbers in tables, 1 GiB: more are left to the processor, which makes one table at a time


class Work(NamedTuple):
    """One plane for a device.

    Attributes:
        rows: the first row with light, down to a whole block of threads, and the one after the last.
        begins: where the list of every block of threads begins, see ``pieces_by_block``.
        listed: the lists.
        arguments: what a pixel's function is given from the pieces on.
    """

    rows: tuple[int, int]
    begins: Whole
    listed: Whole
    arguments: tuple[Any, ...]


def ruled_work(shape: tuple[int, int], windows: Whole, *arguments: Any) -> Work | None:
    """What ``ruled_pixel`` needs for a picture of this shape; arguments as in ``add_ruled``, without the band of rows. None: too much."""
    kinds, centres, cones, maps, _, _, sharp, parts = arguments[:8]
    rims, _, xs, ys, pixel, width, fine, table, law, ways = arguments[16:26]
    pieces, entries = cut_windows(windows, BAND_ROWS, arguments[-1])

    def seen_by(some: slice) -> tuple[Any, ...]:
        given = kinds, centres, cones, maps, sharp, parts, rims, xs, ys, pixel, width, fine, table, law, ways
        return ruled_tables(pieces[some], entries[some], *given, MOST // (4 * _cores()))

    held, begins, places, boxes = zip(*_in_parts(seen_by, len(pieces)), strict=True)
    if max(int(part[-1]) for part in begins) > MOST // (4 * _cores()):
        return None
    starts = np.cumsum([0] + [part[-1] for part in begins])
    whole = np.concatenate([[0]] + [part[1:] + start for part, start in zip(begins, starts[:-1], strict=True)])
    seen = np.concatenate(held), whole, np.concatenate(places), np.concatenate(boxes)
    return _work(shape, pieces, (pieces, entries, *seen, *arguments))


def dots_work(shape: tuple[int, int], windows: Whole, *arguments: Any) -> Work:
    """What ``dot_pixel`` needs; arguments as in ``add_dots``, without the band of rows."""
    pieces, entries = cut_windows(windows, BAND_ROWS, arguments[-1])
    return _work(shape, pieces, (pieces, entries, *arguments))


def texels_work(shape: tuple[int, int], windows: Whole, *arguments: Any) -> Work | None:
    """What ``texel_pixel`` needs; arguments as in ``add_texels``, without the band of rows. None: too much."""
    kinds, centres, cones, maps, slants, levels, sharp, parts, askew, divisions, grid, grids = arguments[:12]
    rest, (xs, ys, width, texel, values), last = arguments[12:19], arguments[19:24], arguments[24:]
    pieces, entries = cut_windows(windows, BAND_ROWS, arguments[-1])
    seen = texel_tables(pieces, entries, centres, maps, sharp, grid, grids, xs, ys, width, texel, values, MOST)
    if len(seen[0]) < seen[1][-1]:
        return None
    lenses = kinds, centres, cones, slants, levels, sharp, parts, askew, divisions, grid, grids
    return _work(shape, pieces, (pieces, entries, *seen, *lenses, *rest, xs, ys, width, *last))


def _cores() -> int:
    return os.cpu_count() or 1


def _work(shape: tuple[int, int], pieces: Whole, arguments: tuple[Any, ...]) -> Work:
    rows = (int(pieces[:, 2].min()) // HIGH * HIGH, int(pieces[:, 3].max())) if len(pieces) else (0, 0)
    return Work(rows, *pieces_by_block(pieces, *shape), arguments)


def _in_parts(make: Callable[[slice], tuple[Any, ...]], count: int) -> list[tuple[Any, ...]]:
    """What is made of some of so many pieces after others, on all cores."""
    ends = np.linspace(0, count, 4 * _cores() + 1).astype(int)
    with ThreadPoolExecutor(_cores()) as pool:
        return list(pool.map(make, (slice(int(start), int(end)) for start, end in pairwise(ends))))

"""One pixel of a dot, as a thread works it out."""

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.sampled import dot_light

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def dot_pixel(
    light: float,
    row: int,
    column: int,
    near: Whole,
    room: Array,
    pieces: Whole,
    entries: Whole,
    kinds: Whole,
    centres: Array,
    cones: Array,
    maps: Array,
    slants: Array,
    levels: Array,
    parts: Whole,
    counts: Whole,
    strips: Array,
    chords: Array,
    fewest: Whole,
    fewer_strips: Array,
    fewer_chords: Array,
    rims: Array,
    nodes: Array,
    xs: Array,
    ys: Array,
    width: float,
    numbers: Array,
    table: Array,
    law: Array,
    sums: Array,
    allowed: float,
    wanted: Chosen,
) -> float:
    """The light of a pixel with what it gets through the entries near it, in their order.

    ``near`` are the pieces that may hold the pixel (see ``pieces_by_block``), ``room`` is scratch of shape (MOST_SQUARES, 3), ``pieces``
    and ``entries`` are as in ``cut_windows``, and what follows as in ``add_dots``.
    """
    if wanted.size > 0 and not wanted[row, column]:
        return light
    for piece in near:
        window = pieces[piece]
        if column < window[0] or column >= window[1] or row < window[2] or row >= window[3]:
            continue
        entry = entries[piece]
        kind = kinds[entry]
        light += float(levels[entry]) * dot_light(
            xs[column] - centres[entry, 0],
            ys[row] - centres[entry, 1],
            width,
            cones[entry],
            maps[entry],
            slants[entry],
            int(parts[kind]),
            int(counts[kind]),
            strips[kind],
            chords[kind],
            int(fewest[kind]),
            fewer_strips[kind],
            fewer_chords[kind],
            rims[kind],
            nodes,
            numbers,
            table,
            law,
            sums,
            allowed,
            room,
        )
    return light

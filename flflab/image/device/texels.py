"""One pixel of a picture, as a thread works it out, and the tables of texels that the pieces of micro-images read from."""

import numba
import numpy as np
import numpy.typing as npt

from flflab.image.texels import FRAME, fill_sums, seen_texels, texel_light

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

ROOM = 3  # numbers to work in


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_tables(
    pieces: Whole,
    entries: Whole,
    centres: Array,
    maps: Array,
    sharp: Chosen,
    grid: Whole,
    grids: Whole,
    xs: Array,
    ys: Array,
    width: float,
    texel: float,
    values: Array,
    most: int,
) -> tuple[Array, Whole, Whole, Array]:
    """What every piece of a micro-image sees of a picture; ``pieces`` and ``entries`` as in ``cut_windows``, the rest as in ``add_texels``.

    Where that is more than ``most`` numbers it is not gathered.

    Returns:
        Summed-area tables one below the other, as wide as the widest (see ``fill_sums``), where each piece's rows begin (M + 1), its
        columns (M,), and each piece's frame (M, FRAME), see ``seen_texels``. A piece that sees no texel has no rows.
    """
    count = pieces.shape[0]
    begins, widths, frames = np.zeros(count + 1, dtype=np.int64), np.zeros(count, dtype=np.int64), np.zeros((count, FRAME))
    seen = np.zeros((count, 4), dtype=np.int64)
    for piece in range(count):
        entry = entries[piece]
        blurred = not sharp[entry] and grids[grid[entry]] == 0
        seen[piece] = seen_texels(pieces[piece], centres[entry], maps[entry], blurred, xs, ys, width, texel, values, frames[piece])
        begins[piece + 1] = begins[piece]
        if seen[piece, 2] > 0 and seen[piece, 3] > 0:
            begins[piece + 1] += seen[piece, 3] + 1
            widths[piece] = seen[piece, 2] + 1
    widest = max(widths.max(), 1) if count > 0 else 1
    size = 2 * widest * begins[-1]
    held = np.empty((begins[-1] if size <= most else 0, widest, 2))
    if size > most:
        return held, begins, widths, frames
    for piece in range(count):
        if widths[piece] > 0:
            column, row, columns, rows = seen[piece]
            held[begins[piece] : begins[piece + 1], : widths[piece]] = fill_sums(values, column, row, columns, rows)
    return held, begins, widths, frames


@numba.njit(cache=True, nogil=True, error_model="numpy")
def texel_pixel(
    light: float,
    row: int,
    column: int,
    near: Whole,
    room: Array,
    pieces: Whole,
    entries: Whole,
    held: Array,
    begins: Whole,
    widths: Whole,
    frames: Array,
    kinds: Whole,
    centres: Array,
    cones: Array,
    slants: Array,
    levels: Array,
    sharp: Chosen,
    parts: Whole,
    askew: bool,
    divisions: Whole,
    grid: Whole,
    grids: Whole,
    rows_of_points: Array,
    chords: Array,
    counts: Whole,
    strips: Array,
    chunks: int,
    rims: Array,
    nodes: Array,
    xs: Array,
    ys: Array,
    width: float,
    numbers: Array,
    table: Array,
    law: Array,
    wanted: Chosen,
) -> float:
    """The light of a pixel with what it gets through the entries near it, in their order.

    ``near`` are the pieces that may hold the pixel (see ``pieces_by_block``), ``room`` is scratch of shape (ROOM,), what follows up to
    ``frames`` is as in ``cut_windows`` and ``texel_tables``, and from there on as in ``add_texels``.
    """
    if wanted.size > 0 and not wanted[row, column]:
        return light
    for piece in near:
        window = pieces[piece]
        if column < window[0] or column >= window[1] or row < window[2] or row >= window[3] or widths[piece] == 0:
            continue
        entry = entries[piece]
        kind, own = kinds[entry], grid[entry]
        sums = held[begins[piece] : begins[piece + 1], : widths[piece]]
        light += float(levels[entry]) * texel_light(
            xs[column] - centres[entry, 0],
            ys[row] - centres[entry, 1],
            width,
            cones[entry],
            frames[piece],
            slants[entry],
            bool(sharp[entry]),
            int(parts[kind]),
            askew,
            int(divisions[entry]),
            int(grids[own]),
            rows_of_points[own],
            chords[own],
            int(counts[kind]),
            strips[kind],
            chunks,
            rims[kind],
            nodes,
            numbers,
            table,
            law,
            sums,
            sums[:, :, 0],
            room,
        )
    return light

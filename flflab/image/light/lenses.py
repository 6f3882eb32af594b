"""What kernels are given of all microlenses, or parts of their micro-images: where each looks, how
brightly, and what cuts its light.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


class Lenses(NamedTuple):
    """N entries, each a microlens or a part of its micro-image, of K kinds of rims, before a
    sensor.

    Attributes:
        kinds: kind of rim of every entry.
        centres: centre of every micro-image, mm, shape (N, 2).
        cones: slope and reach of every entry, mm, shape (N, 2).
        maps: x', y' = (0, 1) + [[2, 3], [4, 5]] pupil + [[6, 7], [8, 9]] sensor, target mm, shape
            (N, 10).
        slants: slope (x, y) of the middle ray at the sensor, its change per mm on the sensor and
            per unit of pupil, shape (N, 4); 0 leaves the fall-off out.
        levels: light at full pupil.
        parts: parts a side of a pixel in the rim, for each kind of rim.
        rims: see ``rim_tables``; steep kinds start with a negative distance.
        nodes: pupil points for steep rims.
        xs: positions of the columns, mm.
        ys: positions of the rows, mm.
        pixel: distance of the pixels, mm.
        width: side of a pixel that gathers light, mm.
        wanted: which pixels to compute, [row, column]; empty for all.
    """

    kinds: Whole
    centres: Array
    cones: Array
    maps: Array
    slants: Array
    levels: Array
    parts: Whole
    rims: Array
    nodes: Array
    xs: Array
    ys: Array
    pixel: float
    width: float
    wanted: npt.NDArray[np.bool_]


def packed(seen: Any) -> Any:
    """The same with the numbers of all arrays side by side: a kernel is compiled once for every way
    in which they lie.
    """
    if isinstance(seen, np.ndarray):
        return np.ascontiguousarray(seen)
    return type(seen)(*map(packed, seen)) if isinstance(seen, tuple) else seen

"""The spectrum of dots that a box cuts, as polygons: a field need then be no larger than the box,
however large the dots.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

LEAST_SIDES = 16
# of the shortest wave that light keeps: so long sides differ from an arc by shorter waves only
WITHIN_WAVE = 0.8
SAGITTA = (
    0.2  # of the tolerance times the blur: an arc so far off changes 0.1 of the tolerance at most
)


def cut_dots_spectrum(
    centres: Array, radii: Array, low: Array, high: Array, side: float, x: Array, y: Array
) -> ComplexArray:
    """Spectrum of the parts of white discs inside a box.

    Args:
        centres: of the discs, pixels along x' and y', shape (n, 2).
        radii: of each along x' and y'.
        low: the box's corner of least x' and y'.
        high: that of most.
        side: longest of the polygons' sides on the discs' rims, pixels.
        x: frequencies along x', cycles/pixel.
        y: along y'.

    Returns:
        Shape (y, x).
    """
    count = max(LEAST_SIDES, math.ceil(2 * math.pi * float(radii.max()) / side))
    angles = 2 * np.pi * np.arange(count) / count
    # As large as the disc.
    circle = np.column_stack([np.cos(angles), np.sin(angles)]) * math.sqrt(
        2 * math.pi / (count * math.sin(2 * math.pi / count))
    )
    total = np.zeros((len(y), len(x)), dtype=np.complex128)
    for centre in centres:
        corners = clipped(centre + radii * circle, low, high)
        if len(corners):
            add_polygon_spectrum(total, corners, x, y)
    return total


def side_of_arc(radius: float, cutoff: float, blur: float, tolerance: float) -> float:
    """How long a side stands for an arc, pixels.

    Args:
        radius: of the arc, pixels.
        cutoff: up to which waves are kept, cycles/pixel.
        blur: radius of the blur, pixels.
        tolerance: of white.
    """
    return max(WITHIN_WAVE / cutoff, math.sqrt(8 * radius * SAGITTA * tolerance * abs(blur)))


def clipped(corners: Array, low: Array, high: Array) -> Array:
    """The corners (n, 2) of a convex polygon's part inside a box; none where nothing is."""
    for axis in (0, 1):
        for bound, sign in ((low[axis], 1.0), (high[axis], -1.0)):
            if not len(corners):
                return corners
            inside = sign * (corners[:, axis] - bound)
            following, next_inside = np.roll(corners, -1, axis=0), np.roll(inside, -1)
            crosses = (inside >= 0) != (next_inside >= 0)
            share = np.divide(
                inside, inside - next_inside, out=np.zeros_like(inside), where=crosses
            )
            both = np.stack(
                [corners, corners + share[:, None] * (following - corners)], axis=1
            ).reshape(-1, 2)
            corners = both[np.stack([inside >= 0, crosses], axis=1).ravel()]
    return corners


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_polygon_spectrum(total: ComplexArray, corners: Array, x: Array, y: Array) -> None:
    """Add a polygon's spectrum, its corners (n, 2) in the mathematical sense of turning, at
    frequencies along x' and y'.

    By the divergence theorem it is the sum over the sides of i f.n L sinc(f.t L) exp(-2 pi i f.m) /
    (2 pi f^2), with a side's middle m, direction t, outward normal n and length L.
    """
    count = corners.shape[0]
    by_x, by_y = (
        np.empty((count, x.size), dtype=np.complex128),
        np.empty((count, y.size), dtype=np.complex128),
    )
    sides, area = np.empty((count, 2)), 0.0
    for index in range(count):
        after = (index + 1) % count
        sides[index] = corners[after] - corners[index]
        middle = 0.5 * (corners[after] + corners[index])
        area += 0.5 * (middle[0] * sides[index, 1] - middle[1] * sides[index, 0])
        for column in range(x.size):
            by_x[index, column] = np.exp(-2j * np.pi * x[column] * middle[0])
        for row in range(y.size):
            by_y[index, row] = np.exp(-2j * np.pi * y[row] * middle[1])
    for row in range(y.size):
        for column in range(x.size):
            square = x[column] * x[column] + y[row] * y[row]
            if square == 0.0:
                total[row, column] += area
                continue
            light = 0.0j
            for index in range(count):
                across = x[column] * sides[index, 1] - y[row] * sides[index, 0]
                turn = np.pi * (x[column] * sides[index, 0] + y[row] * sides[index, 1])
                kept = np.sin(turn) / turn if abs(turn) > 1e-6 else 1.0
                light += across * kept * (by_x[index, column] * by_y[index, row])
            total[row, column] += 1j * light / (2 * np.pi * square)

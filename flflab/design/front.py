"""The Pareto front of a stream of points: nothing kept is dominated, and everything seen is
dominated within a factor 1 + epsilon.

Epsilon boxes after Laumanns, Thiele, Deb and Zitzler (Evolutionary Computation 10, 2002): each
objective's logarithm is cut into steps of log(1 + epsilon); one point is kept for each box that no
other box dominates. With epsilon 0 the front is exact, equal points included.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

SMALLEST = 1e-12  # objectives at and below it count as nothing


@dataclass(frozen=True)
class Front:
    """Points of which none dominates another.

    Attributes:
        numbers: which configurations they are, ascending, shape (n,).
        values: their objectives, all to be as large as possible, shape (n, m).
        epsilon: of the boxes; 0 for an exact front.
    """

    numbers: Whole
    values: Array
    epsilon: float


def empty_front(objectives: int, epsilon: float) -> Front:
    """A front before the first point."""
    return Front(np.zeros(0, dtype=np.int64), np.zeros((0, objectives)), epsilon)


def merged(front: Front, numbers: Whole, values: Array) -> Front:
    """The front of a front and further points; the same whatever the order in which points come, up
    to the choice within a box.
    """
    if len(numbers) == 0:
        return front
    every, points = np.concatenate([front.numbers, numbers]), np.concatenate([front.values, values])
    boxes = (
        points
        if front.epsilon == 0
        else np.floor(np.log(np.maximum(points, SMALLEST)) / math.log1p(front.epsilon))
    )
    # good points first, so that most others fall to the first ones they meet; equal ones in the
    # order of their numbers
    order = np.lexsort((every, -np.log(np.maximum(points, SMALLEST)).sum(axis=1)))
    kept = order[_survivors(np.ascontiguousarray(boxes[order]), front.epsilon > 0)]
    kept = kept[np.argsort(every[kept])]
    return Front(every[kept], points[kept], front.epsilon)


@numba.njit(cache=True, nogil=True)
def _survivors(boxes: Array, one_a_box: bool) -> Whole:
    """Indices of the rows that no other row dominates; of equal rows the first only, where one a
    box is wanted.
    """
    count, width = boxes.shape
    kept = np.empty(count, dtype=np.int64)
    size = 0
    for row in range(count):
        falls = False
        at = 0
        while at < size:
            other = kept[at]
            better = False
            worse = False
            for column in range(width):
                if boxes[other, column] > boxes[row, column]:
                    better = True
                elif boxes[other, column] < boxes[row, column]:
                    worse = True
            if not worse and (better or one_a_box):
                falls = True
                if at > 0:  # a row that fells others moves forward
                    kept[at], kept[at - 1] = kept[at - 1], kept[at]
                break
            if worse and not better:
                size -= 1
                kept[at] = kept[size]
            else:
                at += 1
        if not falls:
            kept[size] = row
            size += 1
    return np.sort(kept[:size])

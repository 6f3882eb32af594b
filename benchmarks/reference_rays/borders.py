"""Where straight paths over a target cross the borders of what is on it: between two crossings the
radiance is smooth.
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.image.scene import Plane
from flflab.targets import Bars, Edge, FourDot, Picture

Array = npt.NDArray[np.float64]


def crossings(plane: Plane, start: Array, end: Array) -> Array:
    """Fractions of the way from ``start`` to ``end`` at which borders of the target or of its card
    are crossed.

    Args:
        plane: the target.
        start: places in the target's own coordinates, shape (N, 2).
        end: the same.

    Returns:
        Shape (N, K): every crossing inside the way, in no order; anything outside 0 to 1, or nan,
        stands for none.
    """
    found = [np.zeros((len(start), 0))]
    if plane.size is not None:
        found += _box(start, end, plane.size[0], plane.size[1])
    match plane.target:
        case Edge(angle):
            normal = np.array([math.cos(angle), math.sin(angle)])
            found.append(_levels(start @ normal, end @ normal, np.zeros((1, 1))))
        case FourDot() as dots:
            found += [
                _circle(start - centre, end - centre, dots.diameter / 2) for centre in dots.centres
            ]
        case Bars() as bars:
            found += [
                *_box(start, end, bars.width, bars.height),
                _bars(bars, start[:, 0], end[:, 0]),
            ]
        case Picture() as picture:
            found.append(
                _grid(
                    start[:, 0] + picture.width / 2,
                    end[:, 0] + picture.width / 2,
                    picture.texel,
                    picture.values.shape[1],
                )
            )
            found.append(
                _grid(
                    start[:, 1] + picture.height / 2,
                    end[:, 1] + picture.height / 2,
                    picture.texel,
                    picture.values.shape[0],
                )
            )
        case _:
            pass
    return np.concatenate(found, axis=1)


def _levels(start: Array, end: Array, levels: Array) -> Array:
    """Fractions where a coordinate that goes from ``start`` to ``end``, shape (N,), takes levels of
    shape (N or 1, K).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return (levels - start[:, None]) / (end - start)[:, None]


def _box(start: Array, end: Array, width: float, height: float) -> list[Array]:
    return [
        _levels(start[:, axis], end[:, axis], np.array([[-side / 2, side / 2]]))
        for axis, side in ((0, width), (1, height))
    ]


def _circle(start: Array, end: Array, radius: float) -> Array:
    (x, y), (dx, dy) = start.T, (end - start).T
    square = dx**2 + dy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = -(x * dx + y * dy) / square
        nearest = (x + middle * dx) ** 2 + (y + middle * dy) ** 2  # no difference of large squares
        half = np.sqrt((radius**2 - nearest) / square)
        return np.stack([middle - half, middle + half], axis=1)


def _grid(start: Array, end: Array, step: float, count: int) -> Array:
    """Crossings of 0, step, ..., count step."""
    first, last = (
        np.clip(edge, 0, count)
        for edge in (
            np.ceil(np.minimum(start, end) / step),
            np.floor(np.maximum(start, end) / step),
        )
    )
    return _levels(start, end, step * _counting(first, last))


def _bars(bars: Bars, start: Array, end: Array) -> Array:
    """Crossings of the borders of bars, every half cycle."""
    left, right = (
        2 * bars.phase(np.clip(edge(start, end), -bars.width / 2, bars.width / 2))
        for edge in (np.minimum, np.maximum)
    )
    halves = np.minimum(_counting(np.ceil(left), np.floor(right)), 2 * bars.cycles)
    return _levels(start, end, bars.position(halves / 2))


def _counting(first: Array, last: Array) -> Array:
    """Rows of whole numbers from ``first`` up, as many in each as the longest way to ``last``
    needs.
    """
    most = int(max(0.0, np.max(last - first, initial=-1.0) + 1))
    return first[:, None] + np.arange(most, dtype=np.float64)

"""What a least-squares fit can tell: derivatives, covariance, and the directions in which nothing
is told.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

WORST_CONDITION = 1e7


def jacobian(function: Callable[[Array], Array], place: Array, steps: Array | float) -> Array:
    """Central differences, shape (values, parameters)."""
    moves = np.eye(len(place)) * steps
    sizes = np.broadcast_to(2 * np.asarray(steps), len(place))
    return np.stack(
        [
            (function(place + move) - function(place - move)) / size
            for move, size in zip(moves, sizes, strict=True)
        ],
        axis=1,
    )


def covariance(jacobian: Array) -> Array:
    """Inverse of J'J, with the columns scaled to length 1 first; infinite where they are not
    independent.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if not np.all(scale > 0) or np.linalg.cond(jacobian / scale) > WORST_CONDITION:
        return np.full((len(scale), len(scale)), np.inf)
    unit = jacobian / scale
    return np.linalg.inv(unit.T @ unit) / np.outer(scale, scale)


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that a fit does not tell.

    Attributes:
        words: what it is, empty where nobody has a name for it.
        parts: the parameters in it with their changes, in their own units; one of them changes by
            one natural unit.
        uncertainty: standard uncertainty along it, as a multiple of these changes; infinite where
            nothing measured changes at all.
    """

    words: str
    parts: dict[str, float]
    uncertainty: float


def untold(
    jacobian: Array,
    names: Sequence[str],
    natural: Array,
    known: Mapping[str, Array],
    worst: float = 1.0,
    least_part: float = 0.05,
) -> tuple[Direction, ...]:
    """The directions in which the whitened values change by less than one standard deviation over
    ``worst`` natural units.

    Args:
        jacobian: of the values over their standard uncertainties, shape (values, parameters).
        names: of the parameters.
        natural: what counts as much of each parameter, shape (parameters,).
        known: directions that have a name, in the parameters' own units; those that are not told
            come first, the others go without.
        worst: natural units.
        least_part: parts smaller than this share of the largest are left out of the words.
    """
    scaled = jacobian * natural
    _, values, vectors = np.linalg.svd(scaled, full_matrices=True)
    sizes = np.zeros(len(names))
    sizes[: len(values)] = values
    weak = vectors[sizes * worst < 1]
    named = {
        words: vector / natural / np.abs(vector / natural).max() for words, vector in known.items()
    }
    named = {
        words: vector
        for words, vector in named.items()
        if np.linalg.norm(scaled @ vector) * worst < 1
    }
    if named:
        basis = np.linalg.qr(np.stack(list(named.values()), axis=1))[0]
        rest = weak - weak @ basis @ basis.T
        weak = np.linalg.svd(rest, full_matrices=False)[2][: max(0, len(weak) - len(named))]

    def direction(words: str, vector: Array) -> Direction:
        parts = {
            name: float(part * unit)
            for name, part, unit in zip(names, vector, natural, strict=True)
            if abs(part) >= least_part
        }
        change = float(np.linalg.norm(scaled @ vector))
        return Direction(words, parts, 1 / change if change > 0 else float("inf"))

    found = [direction(words, vector) for words, vector in named.items()]
    return (
        *found,
        *sorted(
            (direction("", vector) for vector in _plain(weak)), key=lambda one: -one.uncertainty
        ),
    )


def _plain(vectors: Array) -> Array:
    """Other vectors of the same space, each with a parameter of its own that is 1 there and 0 in
    the others: fewer parts to name.
    """
    rows = vectors.copy()
    left = np.ones(rows.shape, dtype=np.bool_)
    for _ in range(len(rows)):
        row, column = np.unravel_index(
            int(np.argmax(np.where(left, np.abs(rows), -1.0))), rows.shape
        )
        rows[row] /= rows[row, column]
        others = np.arange(len(rows)) != row
        rows[others] -= np.outer(rows[others, column], rows[row])
        left[row], left[:, column] = False, False
    return rows

"""Which micro-images can reach one another, and even points to count on: sets too large for all
pairs.
"""

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera, nearest_neighbour
from flflab.optics.illumination import surely_blocked, useful_radii
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]


# Fractional steps of the additive sequence whose points fill a square most evenly: powers of the
# plastic number's inverse.
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
# Candidate pairs held in memory at a time.
_CHUNK = 1 << 20


def even_points(count: int) -> Array:
    """Points that fill the square from 0 to 1 evenly, any first few of them too, shape (count,
    2).
    """
    return np.mod(0.5 + np.arange(1, count + 1)[:, None] * _STEPS, 1.0)


def neighbours_of(
    smms: Smms, camera: Camera, slack: float = 0.0, radii: tuple[Array, Array] | None = None
) -> npt.NDArray[np.int64]:
    """Which other micro-images can reach the useful region of each, shape (N, K); -1 where there
    are fewer.

    Of a micro-image whose centre lies deep in others' light, so that nothing of it is useful, some
    of these others do: their number has no bound.

    Args:
        smms: the systems, fields of shape (N,).
        camera: whose rules hold.
        slack: share by which the reach is enlarged, for systems that will be disturbed.
        radii: what ``useful_radii`` says of them, where it is known already.
    """
    centre = np.stack([smms.centre_x, smms.centre_y], axis=1) * smms.image_scale[:, None]
    enlarged = (1 + slack) * (1.0 if camera.aperture_shape == "round" else np.sqrt(2.0))
    radius, blocked = (part * enlarged for part in radii or useful_radii(smms, camera))
    reach = float(radius.max() + blocked.max())
    near = min(reach, 2 * nearest_neighbour(camera.array) * float(smms.image_scale.max()))
    every = np.arange(len(centre))
    pairs, apart = _reached(centre, radius, blocked, every, near)
    if near < reach:
        deep = surely_blocked(smms, camera)[pairs[:, 1]] / (1 + slack) ** 2
        hidden = np.unique(pairs[apart < deep, 0])
        of_hidden = np.isin(pairs[:, 0], hidden)
        further = _reached(centre, radius, blocked, np.setdiff1d(every, hidden), reach)
        pairs = np.concatenate([pairs[of_hidden], further[0]])
        apart = np.concatenate([apart[of_hidden], further[1]])
    # Nearest first: they cut most, and what they cut needs no further look.
    pairs = pairs[np.lexsort((apart, pairs[:, 0]))]
    counts = np.bincount(pairs[:, 0], minlength=len(centre))
    column = np.arange(len(pairs)) - np.repeat(np.cumsum(counts) - counts, counts)
    neighbours = np.full((len(centre), int(counts.max(initial=0))), -1, dtype=np.int64)
    neighbours[pairs[:, 0], column] = pairs[:, 1]
    return neighbours


def _reached(
    centre: Array, radius: Array, blocked: Array, some: npt.NDArray[np.int64], reach: float
) -> tuple[npt.NDArray[np.int64], Array]:
    """Pairs (i, j) with i of ``some`` of which j can reach i's useful region, and how far apart
    they are.
    """
    pairs = pairs_within(centre[some], centre, reach)
    pairs[:, 0] = some[pairs[:, 0]]
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    apart = np.hypot(*(centre[pairs[:, 1]] - centre[pairs[:, 0]]).T)
    reached = apart < radius[pairs[:, 0]] + blocked[pairs[:, 1]]
    return pairs[reached], apart[reached]


def pairs_within(points: Array, others: Array, reach: float) -> npt.NDArray[np.int64]:
    """Pairs (i, j) of points and other points at most ``reach`` apart in x and in y, shape (K, 2),
    by cells of that size.
    """
    lowest = others.min(axis=0)
    size = max(
        reach * (1 + 1e-9), float(np.ptp(others, axis=0).max()) / 1000, np.finfo(np.float64).tiny
    )
    cells = np.floor((others - lowest) / size).astype(np.int64)
    columns = int(cells[:, 0].max()) + 3
    order = np.argsort(cells[:, 1] * columns + cells[:, 0], kind="stable")
    keys = (cells[:, 1] * columns + cells[:, 0])[order]
    near = np.flatnonzero(
        np.all((points >= lowest - reach) & (points <= others.max(axis=0) + reach), axis=1)
    )
    cell = np.floor((points[near] - lowest) / size).astype(np.int64)
    # Three cells side by side have consecutive keys.
    key = (cell[:, 1] + np.array([[-1], [0], [1]])) * columns + cell[:, 0]
    first = np.searchsorted(keys, key - 1, side="left")
    counts = np.searchsorted(keys, key + 1, side="right") - first
    chunk = np.cumsum(counts.sum(axis=0)) // _CHUNK
    found = [np.zeros((0, 2), dtype=np.int64)]
    for part in np.split(np.arange(len(near)), np.flatnonzero(np.diff(chunk)) + 1):
        some, start = counts[:, part].ravel(), first[:, part].ravel()
        owner = np.repeat(np.tile(near[part], 3), some)
        other = order[
            np.arange(len(owner)) - np.repeat(np.cumsum(some) - some, some) + np.repeat(start, some)
        ]
        close = np.all(np.abs(points[owner] - others[other]) <= reach, axis=1)
        found.append(np.stack([owner[close], other[close]], axis=1))
    return np.concatenate(found)

"""Where the four dots stand: one fit to the centroids of all their spots.

Three numbers a dot (its direction and its vergence) and one for all, by how much the focus of the
microlenses differs from the camera's. Residuals count by noise, by how surely each lens's own
centre and focus are known, and by the model's own error; outliers (dust, a neighbour's light) have
less weight. Views that scatter more than that make all of it less sure.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from flflab.measurement.dots.model import Microlenses, Shown, shown
from flflab.measurement.solver import settle

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

# by which slopes are told: direction, vergence, kappa, and place (x, y) and rise of the lens
STEPS = 1e-3, 1e-3, 1e-5, 1e-3, 1e-4, 1e-4, 1e-5
MOST_LOOKS, CLOSE = 20, 1e-4  # of the fit; fall of chi squared that ends it
OUTLYING = 2.0  # standard deviations from which on a residual has less weight
VERGENCE, DIRECTION = 0.3, 0.2  # standard deviations of what is known before: a share, and rad


@dataclass(frozen=True)
class Seen:
    """What is fitted: a spot an entry; lengths in mm.

    Attributes:
        lenses: the microlens of each.
        dot: number of each spot's dot.
        lens: number of each spot's lens in the lattice.
        centroids: from the micro-image's centre, shape (n, 2).
        variance: of both coordinates, by noise and the model, shape (n, 2).
        place: standard uncertainty of the micro-image's own centre, shape (n,).
        focus: standard deviation of kappa from lens to lens.
        counted: which spots are fitted.
        kappa: by how much kappa differs from the camera's, as the white picture shows it, and its
            standard uncertainty.
        size: diameter of a dot times its vergence, rad.
    """

    lenses: Microlenses
    dot: Whole
    lens: Whole
    centroids: Array
    variance: Array
    place: Array
    focus: float
    counted: Flags
    kappa: tuple[float, float]
    size: float


@dataclass(frozen=True)
class Stand:
    """Where the dots stand.

    Attributes:
        values: (x, y) of each dot times its vergence, rad, and that, 1/mm, shape (dots, 3).
        focus: kappa less the camera's.
        shown: what the spots then are.
        spread: standard deviation of each spot's own coordinates, mm, shape (n, 2).
        covariance: of (values, focus), as spots and lenses scatter.
        lenses: numbers in the lattice of those that show fitted spots, shape (m,).
        by_lens: how these move with a standard deviation of each one's place (x, y) and focus,
            shape (3 dots + 1, 3 m): the spots of several dots in a lens are off together.
        gains: how these move with each counted coordinate, per mm, shape (3 dots + 1, 2 n).
        chief_slopes: how each chief ray's landing moves with these, shape (2 n, 3 dots + 1).
        lags: how it moves with them more than the centroid, the same way.
        by_centre: how each spot moves with its micro-image's centre, from which it is counted,
            shape (n, 2, 2).
        by_rise: how it moves with ``Microlenses.rise``, shape (n, 2).
        excess: variance of the residuals over what was expected, at least 1.
        freedom: degrees of freedom of that.
    """

    values: Array
    focus: float
    shown: Shown
    spread: Array
    covariance: Array
    lenses: Whole
    by_lens: Array
    gains: Array
    chief_slopes: Array
    lags: Array
    by_centre: Array
    by_rise: Array
    excess: float
    freedom: float


def stand_of(seen: Seen, known: Array, start: Array, focus: float) -> Stand:
    """Fit the dots' places.

    Args:
        seen: the spots.
        known: ``values`` as they are known before, roughly.
        start: the same to begin with.
        focus: to begin with.
    """
    prior = np.stack([*np.full((2, len(known)), DIRECTION), VERGENCE * known[:, 2]], axis=1)
    sure = np.diag(np.append(prior, seen.kappa[1]) ** -2.0)
    before = np.append(known, seen.kappa[0])

    def look(trial: Array) -> tuple[float, Callable[[float], Array]]:
        there = _equations(seen, trial, before, sure)
        damped = np.diag(np.diag(there.normal))
        return (
            there.cost,
            lambda damping: trial + _inverse(there.normal + damping * damped) @ there.right,
        )

    free = settle(np.append(start, focus), look, CLOSE, MOST_LOOKS)
    at = _equations(seen, free, before, sure)
    here, by_spot, weights, rest, spread = at.shown, at.by_spot, at.weights, at.rest, at.spread
    by_centre, inverse = by_spot[..., 4:6] + np.eye(2), _inverse(at.normal)
    freedom = max(float(weights.sum()) - len(free), 0.0)
    excess = max(1.0, float((weights * rest**2).sum()) / freedom) if freedom > 0 else 1.0
    # a variance of few degrees of freedom counts more
    excess = 1 + (excess - 1) * float(student.ppf(0.8413, max(freedom, 1.0))) ** 2
    gains = inverse @ (at.rows.T * weights) / spread.reshape(-1)
    lenses, by_lens = _by_lens(seen, gains, by_centre, here.pupil)
    scatter = (gains * seen.variance.reshape(-1)) @ gains.T + by_lens @ by_lens.T
    chief_slopes = _of_dots(at.by_chief, seen.dot, len(free))
    return Stand(
        free[:-1].reshape(-1, 3),
        float(free[-1]),
        here,
        spread,
        excess * scatter + inverse @ sure @ inverse,
        lenses,
        np.sqrt(excess) * by_lens,
        gains,
        chief_slopes,
        chief_slopes - _of_dots(by_spot, seen.dot, len(free)),
        by_centre,
        by_spot[..., 6],
        excess,
        freedom,
    )


@dataclass(frozen=True)
class _Equations:
    """Normal equations of the fit somewhere, and what they are made of: residuals over their
    spreads, their weights, their slopes by all that is free, (2 n, free); chi squared.
    """

    shown: Shown
    by_spot: Array
    by_chief: Array
    spread: Array
    rest: Array
    weights: Array
    rows: Array
    normal: Array
    right: Array
    cost: float


def _equations(seen: Seen, free: Array, before: Array, sure: Array) -> _Equations:
    """Where a fit sees the spots.

    Args:
        seen: the spots.
        free: dots' numbers and focus.
        before: the same as they are known before.
        sure: inverse of their covariance then.
    """
    here, by_spot, by_chief = _slopes(seen, free)
    by_centre, which = by_spot[..., 4:6] + np.eye(2), np.repeat(seen.counted, 2)
    own = (seen.place[:, None] * np.hypot(by_centre[..., 0], by_centre[..., 1])) ** 2
    spread = np.sqrt(seen.variance + own + (seen.focus * here.pupil) ** 2)
    rest = np.where(which, ((seen.centroids - here.centroid) / spread).reshape(-1), 0.0)
    typical = max(1.0, 1.4826 * float(np.median(np.abs(rest[which]))))
    weights = np.minimum(1.0, OUTLYING * typical / np.maximum(np.abs(rest), 1e-9)) * which
    rows = _of_dots(by_spot, seen.dot, len(free)) / spread.reshape(-1)[:, None]
    left = before - free
    # Huber's: beyond its limit a residual counts by its size, not by its square
    cost = float((weights * (2 - weights) * rest**2).sum() + left @ sure @ left)
    normal = (rows.T * weights) @ rows + sure
    right = rows.T @ (weights * rest) + sure @ left
    return _Equations(here, by_spot, by_chief, spread, rest, weights, rows, normal, right, cost)


def _by_lens(seen: Seen, gains: Array, by_centre: Array, pupil: Array) -> tuple[Whole, Array]:
    """``Stand.lenses`` and ``Stand.by_lens``, the latter as lenses are expected to scatter."""
    spots = np.flatnonzero(seen.counted)
    lenses, which = np.unique(seen.lens[spots], return_inverse=True)
    own = seen.place[:, None, None] * by_centre, seen.focus * pupil[..., None]
    of_spots = gains.reshape(len(gains), -1, 2)[:, spots]
    moved = np.einsum("ksi,sij->skj", of_spots, np.concatenate(own, axis=2)[spots])
    total = np.zeros((len(lenses), len(gains), 3))
    np.add.at(total, which, moved)
    return lenses, total.transpose(1, 0, 2).reshape(len(gains), -1)


def _slopes(seen: Seen, free: Array) -> tuple[Shown, Array, Array]:
    """What is shown, and how each spot's centroid and its chief ray's landing move with the numbers
    of ``STEPS``, shape (n, 2, 7).
    """
    values, lenses = free[:-1].reshape(-1, 3)[seen.dot], replace(seen.lenses, focus=float(free[-1]))
    here = shown(lenses, values[:, :2], values[:, 2], seen.size)
    by_spot, by_chief = np.zeros((2, len(values), 2, len(STEPS)))
    for part, step in enumerate(STEPS):
        at, other = values.copy(), lenses
        if part < 3:
            at[:, part] += step
        elif part == 3:
            other = replace(lenses, focus=lenses.focus + step)
        elif part < 6:
            other = replace(lenses, centres=lenses.centres + step * np.eye(2)[part - 4])
        else:
            other = replace(lenses, rise=lenses.rise + step)
        there = shown(other, at[:, :2], at[:, 2], seen.size)
        by_spot[..., part] = (there.centroid - here.centroid) / step
        by_chief[..., part] = (there.chief - here.chief) / step
    return here, by_spot, by_chief


def _of_dots(by: Array, dot: Whole, free: int) -> Array:
    """Slopes by the numbers of the spot's own dot and kappa as those by all that is free, shape
    (2 n, ``free``).
    """
    found, spots = np.zeros((len(dot), 2, free)), np.arange(len(dot))
    for part in range(3):
        found[spots, :, 3 * dot + part] = by[..., part]
    found[..., -1] = by[..., 3]
    return found.reshape(-1, free)


def _inverse(normal: Array) -> Array:
    scale = np.sqrt(np.outer(np.diag(normal), np.diag(normal)))
    return np.asarray(np.linalg.inv(normal / scale) / scale, dtype=np.float64)

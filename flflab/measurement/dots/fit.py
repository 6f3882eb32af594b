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

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int64]

STEPS = 1e-3, 1e-3, 1e-5, 1e-3  # by which slopes are told: direction, vergence, kappa
MOST_STEPS, SETTLED = 20, 0.01  # of the fit, until none is more than that of an uncertainty
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
        slopes: how each coordinate moves with these, shape (2 n, 3 dots + 1).
        lags: how the chief ray's place moves with them more than that, the same way.
        by_centre: how each spot moves with its micro-image's centre, shape (n, 2, 2).
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
    slopes: Array
    lags: Array
    by_centre: Array
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
    prior = np.append(
        np.stack([*np.full((2, len(known)), DIRECTION), VERGENCE * known[:, 2]], axis=1),
        seen.kappa[1],
    )
    before, free = np.append(known, seen.kappa[0]), np.append(start, focus)
    by_centre = _by_centre(seen, free)
    own = (seen.place[:, None] * np.hypot(by_centre[..., 0], by_centre[..., 1])) ** 2
    which = np.repeat(seen.counted, 2)
    steps = 0
    while True:
        here, slopes, lags = _slopes(seen, free)
        spread = np.sqrt(seen.variance + own + (seen.focus * here.pupil) ** 2)
        rest = np.where(which, ((seen.centroids - here.centroid) / spread).reshape(-1), 0.0)
        typical = max(1.0, 1.4826 * float(np.median(np.abs(rest[which]))))
        weights = which * np.minimum(1.0, OUTLYING * typical / np.maximum(np.abs(rest), 1e-9))
        rows = slopes / spread.reshape(-1)[:, None]
        inverse = _inverse((rows.T * weights) @ rows + np.diag(prior**-2.0))
        step = inverse @ (rows.T @ (weights * rest) + (before - free) / prior**2)
        steps += 1
        if steps == MOST_STEPS or np.all(np.abs(step) < SETTLED * np.sqrt(np.diag(inverse))):
            break
        free = free + step
    freedom = max(float(weights.sum()) - len(free), 0.0)
    excess = max(1.0, float((weights * rest**2).sum()) / freedom) if freedom > 0 else 1.0
    excess = 1 + (excess - 1) * _sure(freedom)
    gains = inverse @ (rows.T * weights) / spread.reshape(-1)
    lenses, by_lens = _by_lens(seen, gains, by_centre, here.pupil)
    scatter = (gains * seen.variance.reshape(-1)) @ gains.T + by_lens @ by_lens.T
    return Stand(
        free[:-1].reshape(-1, 3),
        float(free[-1]),
        here,
        spread,
        excess * scatter + inverse @ np.diag(prior**-2.0) @ inverse,
        lenses,
        np.sqrt(excess) * by_lens,
        gains,
        slopes,
        lags,
        by_centre,
        excess,
        freedom,
    )


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


def _formed(seen: Seen, free: Array) -> Shown:
    values = free[:-1].reshape(-1, 3)[seen.dot]
    lenses = seen.lenses.refocused(float(free[-1]))
    return shown(lenses, values[:, :2], values[:, 2], seen.size)


def _slopes(seen: Seen, free: Array) -> tuple[Shown, Array, Array]:
    """What is shown, how each spot's coordinates move with each free number, and how much more its
    chief ray's; shapes (2 n, 3 dots + 1).
    """
    here, spots = _formed(seen, free), np.arange(len(seen.dot))
    found = np.zeros((2, len(spots), 2, len(free)))
    for part, step in enumerate(STEPS):
        moved = free.copy()
        moved[slice(part, -1, 3) if part < 3 else -1] += step
        there = _formed(seen, moved)
        column = 3 * seen.dot + part if part < 3 else np.full(len(spots), len(free) - 1)
        by_spot = (there.centroid - here.centroid) / step
        found[0][spots, :, column] = by_spot
        found[1][spots, :, column] = (there.chief - here.chief) / step - by_spot
    return here, found[0].reshape(-1, len(free)), found[1].reshape(-1, len(free))


def moved_by(seen: Seen, stand: Stand, change: Callable[[Microlenses], Microlenses]) -> Array:
    """How far spots move, mm, when their microlenses are others, shape (n, 2)."""
    free = np.append(stand.values, stand.focus)
    return _formed(replace(seen, lenses=change(seen.lenses)), free).centroid - stand.shown.centroid


def _by_centre(seen: Seen, free: Array) -> Array:
    """How a spot moves with its micro-image's centre, from which it is counted, shape (n, 2, 2)."""
    here, step, found = _formed(seen, free), 1e-4, np.zeros((len(seen.dot), 2, 2))
    for axis in range(2):
        centres = seen.lenses.centres + step * np.eye(2)[axis]
        moved = _formed(replace(seen, lenses=replace(seen.lenses, centres=centres)), free)
        found[:, :, axis] = (moved.centroid - here.centroid) / step + np.eye(2)[axis]
    return found


def _inverse(normal: Array) -> Array:
    scale = np.sqrt(np.outer(np.diag(normal), np.diag(normal)))
    return np.asarray(np.linalg.inv(normal / scale) / scale, dtype=np.float64)


def _sure(freedom: float) -> float:
    """By how much a variance of so few degrees of freedom counts more."""
    return float(student.ppf(0.8413, max(freedom, 1.0))) ** 2

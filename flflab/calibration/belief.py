"""What of a description to believe where pictures disagree with it: the bench is fitted as
described and with each statement doubted.

A wrong zero or scale can be made up for by others, each a little: whoever fits first and then
doubts what came out far off doubts those. So each is doubted in turn from the start, and of all
these fits the likeliest is kept: chi^2 of pictures and of the description, and for every standard
uncertainty s that was taken for a stated one s0 the 2 ln(s/s0) by which a normal distribution is
lower that is wider, and what it costs to call a statement wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.calibration.bench_model import BenchModel
from flflab.calibration.least_squares import jacobian
from flflab.calibration.quantities import NAMES, Quantities

Array = npt.NDArray[np.float64]

FAR = 3.0  # standard uncertainties from which on a description is called wrong
DOUBT = 9.2  # what doubting a statement costs: of a hundred one is taken to be wrong, 2 ln(100)
MOST_DOUBTS = 8
MOST_STEPS = 200  # of a fit; from a start on the right side of the exit pupil ten are enough
RADII = [NAMES.index("outside"), NAMES.index("inside")]


@dataclass(frozen=True)
class Task:
    """A bench and what was measured on it.

    Attributes:
        model: the bench; ``free`` are the places of the parameters that are not described as exact,
            n of them.
        values: measured, shape (settings, 7).
        angles: of the lattices, rad.
        whiten: what makes the quantities of a setting independent with standard deviation 1; 0 for
            those that were not measured.
    """

    model: BenchModel
    free: npt.NDArray[np.intp]
    nominal: Array
    values: Array
    angles: tuple[float, ...]
    whiten: Array

    @property
    def prior(self) -> Array:
        """Standard uncertainties as described, infinite where there are none, shape (n,)."""
        return self.model.prior[self.free]

    @property
    def natural(self) -> Array:
        """What counts as much of each, shape (n,)."""
        return self.model.natural[self.free]

    def parameters(self, changed: Array) -> Array:
        """All parameters, of which the free ones are changed."""
        parameters = self.nominal.copy()
        parameters[self.free] = changed
        return parameters

    def pictures(self, changed: Array) -> Array:
        """Measured less expected, in standard uncertainties."""
        rest = np.nan_to_num(
            self.model.residuals(self.parameters(changed), self.values, self.angles)
        )
        return np.einsum("nij,nj->ni", self.whiten, rest).ravel()

    def residuals(self, changed: Array, prior: Array, trust: float = 1.0) -> Array:
        """The pictures', weighted by ``trust``, then the description's."""
        # what nothing determines stays where it is described: too weak to shift anything else by a
        # hundredth of its uncertainty
        known = np.where(np.isfinite(prior), prior, 1e4 * self.natural)
        return np.concatenate(
            [trust * self.pictures(changed), (changed - self.nominal[self.free]) / known]
        )

    def derivatives(self, changed: Array, prior: Array, trust: float = 1.0) -> Array:
        """Of the residuals."""
        return jacobian(
            lambda place: self.residuals(place, prior, trust), changed, 1e-6 * self.natural
        )

    def settle(self, start: Array, prior: Array, trust: float = 1.0) -> Array:
        """Where pictures and description agree best."""
        found = least_squares(
            self.residuals,
            start,
            self.derivatives,  # pyright: ignore[reportArgumentType]
            x_scale=self.natural,
            xtol=1e-13,
            ftol=1e-13,
            gtol=1e-13,
            max_nfev=MOST_STEPS,
            args=(prior, trust),
        )
        return np.asarray(found.x)


@dataclass(frozen=True)
class Belief:
    """A fit, and how far it believes the description.

    Attributes:
        changed: the free parameters.
        prior: their standard uncertainties: as stated, or as far as they turned out to be off.
        of_pictures: chi^2.
        of_description: chi^2 and what its doubts cost.
    """

    changed: Array
    prior: Array
    of_pictures: float
    of_description: float


def begin(model: BenchModel, measured: Sequence[Quantities]) -> tuple[Task, Array]:
    """The task, and where its fits start.

    The radii show the shadow of a microlens, but not on which side of the exit pupil the sensor
    stands, and fits from the wrong side end there. All other quantities tell where the elements
    stand whatever was described, so the start is what they say alone.
    """
    free = np.flatnonzero(model.prior > 0)
    values, angles = (
        np.array([one.values for one in measured]),
        tuple(one.angle for one in measured),
    )
    variances = [one.covariance for one in measured]
    task = Task(
        model,
        free,
        model.nominal,
        values,
        angles,
        np.array([_whitening(variance) for variance in variances]),
    )
    without_radii = replace(
        task, whiten=np.array([_whitening(_without(variance, RADII)) for variance in variances])
    )
    return task, without_radii.settle(model.start(values, angles)[free], task.natural)


def likeliest(task: Task, start: Array) -> Belief:
    """The likeliest of the fits with nothing doubted from the start and with one of what is
    described.
    """
    stated = np.flatnonzero(np.isfinite(task.prior))
    beliefs = [
        _believe(task, start, task.prior),
        *(_believe(task, start, _doubted(task, start, place)) for place in stated),
    ]
    # pictures that no fit explains count as much as the best of them leaves
    least = max(
        1.0,
        min(belief.of_pictures for belief in beliefs) / np.count_nonzero(np.isfinite(task.values)),
    )
    return min(beliefs, key=lambda belief: belief.of_pictures / least + belief.of_description)


def _doubted(task: Task, start: Array, place: np.intp) -> Array:
    """Prior in which one parameter is believed no better than it is off where next to nothing is
    believed of it.
    """
    prior = task.prior
    prior[place] = task.natural[place]
    off = abs(task.settle(start, prior) - task.nominal[task.free])[place]
    prior[place] = off if off > FAR * task.prior[place] else task.prior[place]
    return prior


def _believe(task: Task, start: Array, prior: Array) -> Belief:
    """Fit, and fit anew with what turns out farther off than it may be believed no better than
    that.
    """
    described = task.nominal[task.free]
    changed = task.settle(start, prior)
    for _ in range(MOST_DOUBTS):
        off = np.abs(changed - described) / prior
        if not np.any(off > FAR):
            break
        prior = prior * np.where(off > FAR, off, 1.0)
        changed = task.settle(start, prior)
    stated = np.isfinite(prior)
    off, wider = (changed - described)[stated] / prior[stated], prior[stated] / task.prior[stated]
    doubts = np.where(wider > 1, DOUBT + 2 * np.log(wider), 0.0)
    return Belief(
        changed, prior, float(np.sum(task.pictures(changed) ** 2)), float(np.sum(off**2 + doubts))
    )


def _without(covariance: Array, places: list[int]) -> Array:
    """The same with some not measured."""
    changed = covariance.copy()
    changed[places, places] = np.inf
    return changed


def _whitening(covariance: Array) -> Array:
    """A matrix that makes the measured numbers independent with standard deviation 1; rows of 0 for
    what was not measured.
    """
    finite = np.isfinite(np.diag(covariance))
    whiten = np.zeros_like(covariance)
    whiten[np.ix_(finite, finite)] = np.linalg.inv(
        np.linalg.cholesky(covariance[np.ix_(finite, finite)])
    )
    return whiten

"""The least-squares fit of a bench to the quantities measured on it, with covariance, and with what
the pictures cannot tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.calibration.belief import FAR, Belief, Task, begin, likeliest
from flflab.calibration.bench_model import BenchModel
from flflab.calibration.least_squares import Direction, jacobian, untold
from flflab.calibration.quantities import NAMES, Quantities
from flflab.errors import MeasurementError

Array = npt.NDArray[np.float64]

BARELY = 0.1  # share of what is known of a parameter, below which the pictures tell little of it
UNDETERMINED = 10.0  # natural units; what is not known better gets no value


@dataclass(frozen=True)
class Hiding:
    """A zero that pictures tell less well than the description does: were it wrong, others would be
    found off instead.

    Attributes:
        name: of the zero.
        told: standard uncertainty to which the pictures alone would tell it.
        taken: by how much others are found off where it is so much off and believed as described,
            and how what is found of them and of it would be correlated were it not believed.
    """

    name: str
    told: float
    taken: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Fit:
    """A bench as its pictures have it.

    Attributes:
        names: of the parameters, as ``BenchModel.names``.
        nominal: as described.
        prior: standard uncertainty by the description, infinite where it gives none.
        values: fitted; nan where neither pictures nor description determine one.
        covariance: of the values.
        by_pictures: share of what is known of each parameter that the pictures told, 0 to 1.
        untold: directions in which the pictures alone say nothing.
        chi2: reduced chi^2 of the pictures; where it is above 1 their uncertainties were taken
            larger by its root.
        count: numbers fitted.
        freedom: how many more they are than the pictures told parameters.
        off: measured less expected quantities, made independent, in standard uncertainties as
            measured, shape (settings, 7).
    """

    names: tuple[str, ...]
    nominal: Array
    prior: Array
    values: Array
    covariance: Array
    by_pictures: Array
    untold: tuple[Direction, ...]
    chi2: float
    count: int
    freedom: float
    off: Array

    @property
    def most_by_noise(self) -> float:
        """Reduced chi^2 that noise hardly exceeds: three standard deviations above 1."""
        return 1 + FAR * (2 / self.freedom) ** 0.5

    @property
    def farthest(self) -> str:
        """The quantity that is farthest off, in words."""
        setting, column = np.unravel_index(int(np.argmax(np.abs(self.off))), self.off.shape)
        return (
            f"{NAMES[column]} of setting {setting + 1}, by {abs(self.off[setting, column]):.3g} of"
            " its uncertainties"
        )

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))

    def value(self, name: str) -> tuple[float, float]:
        """A parameter and its standard uncertainty."""
        place = self.names.index(name)
        return float(self.values[place]), float(self.uncertainty[place])


def fit_bench(model: BenchModel, measured: Sequence[Quantities]) -> Fit:
    """Fit zeros, scales and optics to the quantities of every setting.

    The description's uncertainties of zeros and scales count as measurements; what they give as
    exact (0) is not fitted, and of the optics nothing is taken for granted but pitch and pixel. One
    that turns out farther off than it may be is believed no better than that: which one is asked of
    the pictures, since a wrong one could be made up for by the others.

    Args:
        model: the bench as described, with the settings.
        measured: one a setting.

    Raises:
        MeasurementError: fewer than two settings.
    """
    if len(measured) < 2:
        raise MeasurementError(
            f"calibration: {len(measured)} settings; at least 2 at different places are due"
        )
    task, start = begin(model, measured)
    belief = likeliest(task, start)
    changed, covariance, pictures = _with_covariance(task, belief, 1.0)
    count = int(np.count_nonzero(np.isfinite(task.values)))
    freedom = max(count - float(np.trace(covariance @ pictures.T @ pictures)), 1.0)
    chi2 = belief.of_pictures / freedom
    if chi2 > 1:
        changed, covariance, pictures = _with_covariance(task, belief, chi2**-0.5)
    free, nominal, prior, natural = task.free, task.nominal, belief.prior, task.natural
    parameters, spread, shares = (
        nominal.copy(),
        np.zeros((len(nominal), len(nominal))),
        np.zeros(len(nominal)),
    )
    parameters[free], spread[np.ix_(free, free)] = changed, covariance
    shares[free] = 1 - np.minimum(np.diag(covariance) / prior**2, 1.0)
    lost = np.sqrt(np.diag(spread)) > UNDETERMINED * model.natural
    parameters[lost], shares[lost] = np.nan, 0.0
    names = tuple(model.names[place] for place in free)
    known_directions = {words: vector[free] for words, vector in model.symmetries.items()}
    off = task.pictures(changed).reshape(task.values.shape)
    directions = untold(pictures, names, natural, known_directions)
    return Fit(
        model.names,
        nominal,
        model.prior,
        parameters,
        spread,
        shares,
        directions,
        chi2,
        count,
        freedom,
        off,
    )


def hidings(fit: Fit) -> tuple[Hiding, ...]:
    """Zeros whose errors the pictures would not show before another parameter is off by more than
    is stated for it.

    Without the description's word s on a parameter of variance C its variance were C s^2/(s^2 - C),
    and the others moved with it as their covariance says (Sherman and Morrison).
    """
    found = list[Hiding]()
    for place, (name, stated, share) in enumerate(
        zip(fit.names, fit.prior, fit.by_pictures, strict=True)
    ):
        variance, with_it = fit.covariance[place, place], fit.covariance[place]
        if not (name.endswith(".zero") and 0 < variance < stated**2 < np.inf and share < BARELY):
            continue
        told = float(np.sqrt(variance / share))
        shifts, own = -with_it / variance * told, np.diag(fit.covariance)
        spread = np.sqrt(own + with_it**2 / (stated**2 - variance))
        taking = [
            other
            for other in np.argsort(-np.abs(shifts))
            if other != place and np.abs(shifts[other]) > own[other] ** 0.5
        ]
        taken = {
            fit.names[other]: (float(shifts[other]), float(-shifts[other] / spread[other]))
            for other in taking
        }
        found += [Hiding(name, told, taken)] if taken else []
    return tuple(found)


def _with_covariance(task: Task, belief: Belief, trust: float) -> tuple[Array, Array, Array]:
    """Where pictures, weighted by ``trust``, and description agree best; the covariance there, and
    the pictures' derivatives.
    """
    found = task.settle(belief.changed, belief.prior, trust)
    scaled = task.derivatives(found, belief.prior, trust) * task.natural
    covariance = np.linalg.inv(scaled.T @ scaled) * np.outer(task.natural, task.natural)
    return found, covariance, jacobian(task.pictures, found, 1e-6 * task.natural)

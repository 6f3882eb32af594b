"""The least-squares fit of a bench to the quantities measured on it, with covariance, and with what the pictures cannot tell."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from flflab.calibration.bench_model import BenchModel
from flflab.calibration.least_squares import Direction, jacobian, untold
from flflab.calibration.quantities import Quantities
from flflab.errors import MeasurementError

Array = npt.NDArray[np.float64]

FAR = 3.0  # standard uncertainties from which on a description is called wrong
MOST_DOUBTS = 8
UNDETERMINED = 10.0  # natural units; what is not known better gets no value


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
        chi2: reduced chi^2 of the pictures; where it is above 1 their uncertainties were taken larger by its root.
        count: numbers fitted.
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

    The description's uncertainties of zeros and scales count as measurements; what they give as exact (0) is not fitted, and of the
    optics nothing is taken for granted but pitch and pixel. One that turns out farther off than it may be is believed no better than
    that, and the bench is fitted anew: a wrong one would be made up for by all the others.

    Args:
        model: the bench as described, with the settings.
        measured: one a setting.

    Raises:
        MeasurementError: fewer than two settings.
    """
    if len(measured) < 2:
        raise MeasurementError(f"calibration: {len(measured)} settings; at least 2 at different places are due")
    values = np.array([one.values for one in measured])
    angles = [one.angle for one in measured]
    whiten = np.array([_whitening(one.covariance) for one in measured])
    free = np.flatnonzero(model.prior > 0)
    nominal, prior, natural = model.nominal, model.prior[free], model.natural[free]

    def known() -> Array:
        # what nothing determines stays where it is described: too weak to shift anything else by a hundredth of its uncertainty
        return 1 / np.where(np.isfinite(prior), prior, 1e4 * natural)

    def of_pictures(changed: Array) -> Array:
        parameters = nominal.copy()
        parameters[free] = changed
        rest = np.nan_to_num(model.residuals(parameters, values, angles))
        return np.einsum("nij,nj->ni", whiten, rest).ravel()

    def solve(start: Array, trust: float) -> tuple[Array, Array, Array]:
        """Where pictures, weighted by ``trust``, and description agree best; the covariance there, and the pictures' derivatives."""

        def residuals(changed: Array) -> Array:
            return np.concatenate([trust * of_pictures(changed), (changed - nominal[free]) * known()])

        def derivatives(place: Array) -> Array:
            return jacobian(residuals, place, 1e-6 * natural)

        found = least_squares(residuals, start, jac=derivatives, x_scale=natural, xtol=1e-13, ftol=1e-13, gtol=1e-13)  # pyright: ignore[reportArgumentType]
        scaled = derivatives(found.x) * natural
        covariance = np.linalg.inv(scaled.T @ scaled) * np.outer(natural, natural)
        return found.x, covariance, jacobian(of_pictures, found.x, 1e-6 * natural)

    begin = model.start(values, angles)[free]
    changed, covariance, pictures = solve(begin, 1.0)
    for _ in range(MOST_DOUBTS):
        off = np.abs(changed - nominal[free]) / prior
        if not np.any(off > FAR):
            break
        prior = prior * np.where(off > FAR, off, 1.0)
        changed, covariance, pictures = solve(begin, 1.0)
    count = int(np.count_nonzero(np.isfinite(values)))
    chi2 = float(np.sum(of_pictures(changed) ** 2)) / max(count - float(np.trace(covariance @ pictures.T @ pictures)), 1.0)
    if chi2 > 1:
        changed, covariance, pictures = solve(changed, chi2**-0.5)
    parameters, spread, shares = nominal.copy(), np.zeros((len(nominal), len(nominal))), np.zeros(len(nominal))
    parameters[free], spread[np.ix_(free, free)] = changed, covariance
    shares[free] = 1 - np.minimum(np.diag(covariance) / prior**2, 1.0)
    lost = np.sqrt(np.diag(spread)) > UNDETERMINED * model.natural
    parameters[lost], shares[lost] = np.nan, 0.0
    names = tuple(model.names[place] for place in free)
    known_directions = {words: vector[free] for words, vector in model.symmetries.items()}
    return Fit(
        model.names, nominal, model.prior, parameters, spread, shares, untold(pictures, names, natural, known_directions), chi2, count
    )


def _whitening(covariance: Array) -> Array:
    """A matrix that makes the measured numbers independent with standard deviation 1; rows of 0 for what was not measured."""
    finite = np.isfinite(np.diag(covariance))
    whiten = np.zeros_like(covariance)
    whiten[np.ix_(finite, finite)] = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(finite, finite)]))
    return whiten

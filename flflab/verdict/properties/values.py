"""The numbers of a property, measured and predicted, in the one shape that rows and verdicts are
made from.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.verdict.comparison import Row, Verdict, count_spread, judge, z_score
from flflab.verdict.properties.measured import Measured
from flflab.verdict.properties.predicted import Predicted

Array = npt.NDArray[np.float64]
SURE = 5.0  # uncertainties by which a number must differ from 0 to be divided by


@dataclass(frozen=True)
class Shared:
    """Errors of measurement that numbers of several ``Values`` have in common.

    Attributes:
        of: what they come from; the same name is the same errors.
        by: how K numbers move with a standard deviation of each of these errors, which are
            independent; shape (K, m).
        which: numbers that tell which m errors these are, shape (m,); None: the same everywhere.
    """

    of: str
    by: Array
    which: npt.NDArray[np.int64] | None = None

    def covariance(self, other: "Shared") -> Array:
        """Of numbers with those of another, shape (K, its K)."""
        if self.of != other.of:
            return np.zeros((len(self.by), len(other.by)))
        if self.which is None or other.which is None:
            return self.by @ other.by.T
        _, mine, theirs = np.intersect1d(self.which, other.which, return_indices=True)
        return self.by[:, mine] @ other.by[:, theirs].T


@dataclass(frozen=True)
class Values:
    """K numbers of one property in one configuration.

    Attributes:
        configuration: which.
        quantity: the property, with its unit where it has one: ``total_field_mm``.
        target: what was shown.
        measured: shape (K,).
        noise: covariance of ``measured``, shape (K, K).
        expected: what the model says, shape (K,).
        draws: the same for benches with drawn errors, shape (n, K); whole numbers for counts.
        dots: the dot each number belongs to, or None.
        cycles_per_mm: the frequency on the target each number belongs to, or None.
        shared: the part of ``noise`` that other numbers share; None where none do.
    """

    configuration: int
    quantity: str
    target: str
    measured: Array
    noise: Array
    expected: Array
    draws: npt.NDArray[np.float64] | npt.NDArray[np.int64]
    dots: tuple[int | None, ...]
    cycles_per_mm: tuple[float | None, ...]
    shared: Shared | None = None

    @property
    def spread(self) -> Array:
        """Standard uncertainties of what the model says, shape (K,)."""
        if self.draws.dtype.kind == "i":
            return count_spread(self.draws.astype(np.int64), self.expected.astype(np.int64))
        return self.draws.std(axis=0, ddof=1)

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainties of measurement and model together, shape (K,)."""
        return np.sqrt(np.diag(self.noise) + self.spread**2)


def single(
    configuration: int,
    quantity: str,
    target: str,
    measured: float,
    uncertainty: float,
    draws: Array,
    shared: Shared | None = None,
) -> Values:
    """One number of one configuration; the model's is the mean of its draws, shape (n,)."""
    return Values(
        configuration, quantity, target, np.array([measured]), np.array([[uncertainty**2]]),
        np.array([draws.mean()]), draws[:, None],
        (None,), (None,), shared,
    )  # fmt: skip


def rows(
    values: Values, one: Measured, model: Predicted, reference: int | None = None
) -> list[Row]:
    """The lines of ``comparison.csv``.

    Args:
        values: the numbers.
        one: the configuration they belong to.
        model: what the model says of it.
        reference: the configuration they are differences or ratios against.
    """
    return [
        Row(
            configuration=values.configuration,
            reference_configuration=reference,
            distance_mm=model.distance,
            array_mm=model.camera.array.distance,
            sensor_mm=model.camera.sensor.distance,
            f_number=one.configuration.f_number,
            target=values.target,
            dot=values.dots[k],
            cycles_per_mm=values.cycles_per_mm[k],
            quantity=values.quantity,
            measured=measured,
            uncertainty=float(values.uncertainty[k]),
            predicted=float(values.expected[k]),
            difference=measured - float(values.expected[k]),
            z=z_score(measured - float(values.expected[k]), float(values.uncertainty[k])),
        )
        for k, measured in enumerate(values.measured.tolist())
    ]


def _shared(one: Values, other: Values) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Positions of the numbers that both have: the same dot, the same frequency."""
    pairs = [
        (k, j)
        for k, (dot, frequency) in enumerate(zip(one.dots, one.cycles_per_mm, strict=True))
        for j, (its_dot, its_frequency) in enumerate(
            zip(other.dots, other.cycles_per_mm, strict=True)
        )
        if dot == its_dot and _same(frequency, its_frequency)
    ]
    mine, theirs = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return mine, theirs


def taken(values: Values, kept: npt.NDArray[np.int64]) -> Values:
    """Some of the numbers."""
    shared = values.shared
    return replace(
        values,
        measured=values.measured[kept],
        noise=values.noise[np.ix_(kept, kept)],
        expected=values.expected[kept],
        draws=values.draws[:, kept],
        dots=tuple(values.dots[k] for k in kept),
        cycles_per_mm=tuple(values.cycles_per_mm[k] for k in kept),
        shared=None if shared is None else replace(shared, by=shared.by[kept]),
    )


def common(values: Values, others: list[Values]) -> Values:
    """The numbers that all the others have, too."""
    kept = set(range(len(values.measured)))
    for other in others:
        kept &= set(_shared(values, other)[0].tolist())
    return taken(values, np.array(sorted(kept), dtype=np.int64))


def positions(one: Values, other: Values) -> npt.NDArray[np.int64]:
    """Where another list, which has them all, holds the numbers of one."""
    return _shared(one, other)[1]


def _same(one: float | None, other: float | None) -> bool:
    return one == other or (
        one is not None and other is not None and math.isclose(one, other, rel_tol=1e-9)
    )


def differences(one: Values, other: Values) -> Values:
    """One configuration's numbers less another's; errors common to both cancel in the draws they
    share.
    """
    mine, theirs = _shared(one, other)
    return Values(
        one.configuration,
        f"difference_{one.quantity}",
        one.target,
        one.measured[mine] - other.measured[theirs],
        one.noise[np.ix_(mine, mine)] + other.noise[np.ix_(theirs, theirs)],
        one.expected[mine] - other.expected[theirs],
        one.draws[:, mine] - other.draws[:, theirs],
        tuple(one.dots[k] for k in mine),
        tuple(one.cycles_per_mm[k] for k in mine),
    )


def ratios(one: Values, other: Values) -> Values:
    """One configuration's numbers over another's, where those are surely not 0: a ratio over
    nothing has no useful distribution.
    """
    mine, theirs = _shared(one, other)
    doubt = other.uncertainty[theirs]
    sure = (
        np.minimum(np.abs(other.measured[theirs]), np.abs(other.expected[theirs])) >= SURE * doubt
    )
    mine, theirs = mine[sure], theirs[sure]
    below, ratio = other.measured[theirs], one.measured[mine] / other.measured[theirs]
    noise = (
        one.noise[np.ix_(mine, mine)] + np.outer(ratio, ratio) * other.noise[np.ix_(theirs, theirs)]
    )
    draws = one.draws[:, mine] / other.draws[:, theirs]
    return Values(
        one.configuration,
        f"ratio_{one.quantity}",
        one.target,
        ratio,
        noise / np.outer(below, below),
        draws.mean(axis=0),
        draws,
        tuple(one.dots[k] for k in mine),
        tuple(one.cycles_per_mm[k] for k in mine),
    )


def verdict(name: str, values: list[Values], threshold: float, rng: np.random.Generator) -> Verdict:
    """Whether a property agrees with the model, over all configurations together.

    Args:
        name: of the property.
        values: its numbers.
        threshold: p-value below which the model is rejected.
        rng: for the measurement noise of the simulated benches.

    Raises:
        InputError: there is nothing to judge.
    """
    measured, noise, draws = joined(values)
    return judge(name, measured, noise, draws, threshold, rng)


def joined(values: list[Values]) -> tuple[Array, Array, Array]:
    """Measured values (K,), covariance of their noise (K, K) and draws (n, K) of several lists of
    numbers as one.
    """
    if not values:
        raise InputError("there are no values to join")
    measured = np.concatenate([one.measured for one in values])
    noise, ends = (
        np.zeros((len(measured), len(measured))),
        np.cumsum([len(one.measured) for one in values]),
    )
    places = [slice(end - len(one.measured), end) for one, end in zip(values, ends, strict=True)]
    for here, one in zip(places, values, strict=True):
        noise[here, here] = one.noise
        for there, other in zip(places, values, strict=True):
            if other is not one and one.shared and other.shared:
                noise[here, there] = one.shared.covariance(other.shared)
    return measured, noise, np.concatenate([one.draws.astype(np.float64) for one in values], axis=1)

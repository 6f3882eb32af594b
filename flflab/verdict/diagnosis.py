"""What may be wrong with a bench whose model is rejected: which single change would explain what
was measured.

Every suspect, a size of the optics or of a target, a turn, the zero of a stage or something that
disturbs, is varied alone over a range as wide as real mistakes; the model's numbers are compared
with the measured ones in their full covariance. The likeliest are drawn anew with their change, as
uncertain as the bench is, for a large change alters what the other uncertainties do. A change
explains the measurement only where what it leaves is no more than such benches leave.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from flflab.digits import plus_minus, two_digits
from flflab.verdict.properties.values import Values, joined

Array = npt.NDArray[np.float64]
FINER, ROUNDS = np.linspace(-1.0, 1.0, 21), 3
# of chi squared: 2 suspects closer than this are not distinguished (4 to 1 odds at least by noise
# alone)
ALIKE = 6.0
CLEAR = 25.0  # of chi squared that a change must explain to be named at all
EXPLAINED = 5.0  # standard deviations of chi squared that a sufficient change may leave
MOST_LEFT = 0.1  # of chi squared that the closest change may leave, to be shown at all
REDRAWN = 6  # the likeliest suspects are drawn anew, either side of each
REACH = 0.2  # share of its size by which a change that is drawn anew may move


@dataclass(frozen=True)
class Suspect:
    """A single change of the bench that would explain what was measured, or part of it.

    Attributes:
        what: what would be different.
        size: of the change, a share, mm or rad.
        change: the same in words with its unit, and its uncertainty where it explains.
        chi2: disagreement left, in the full covariance.
        chi2_before: without the change.
        numbers: how many numbers were compared.
        uncertainty: standard uncertainty of ``size``, enlarged where the change leaves more than
            noise does.
        p_left: p-value of the disagreement left, were all errors normal.
        explains: whether what is left is no more than n + 5 sqrt(2 n) of n numbers.
        remedy: what finds or mends it: ``calibrate``, ``align``, ``light``, ``lenses``, ``lamp`` or
            ``look``.
    """

    what: str
    size: float
    change: str
    chi2: float
    chi2_before: float
    numbers: int
    uncertainty: float
    p_left: float
    explains: bool
    remedy: str

    @property
    def removed(self) -> float:
        """Share of the disagreement that the change removes."""
        return 1 - self.chi2 / self.chi2_before

    @property
    def in_short(self) -> str:
        """The suspect and what it removes."""
        return f"{self.what} {self.change} ({_percent(self.removed)} of the misfit)"

    @property
    def sentence(self) -> str:
        """The suspect in one sentence."""
        left = f"chi² {_rounded(self.chi2)} for {self.numbers} values"
        share = f"{self.what} {self.change}: removes {_percent(self.removed)} of the misfit"
        if self.explains:
            return f"{share}; what is left ({left}) is within the uncertainties"
        return f"{share}, but does not explain it: what is left ({left}) would itself be rejected"


@dataclass(frozen=True)
class Effect:
    """A change that is tried in many sizes.

    Attributes:
        what: its name.
        sizes: that are tried, rising; the effect is absent at the first one or at 0.
        expected: the joined numbers of a bench with each size, shape (n, K).
        in_words: a size with its uncertainty, in words.
        remedy: as of ``Suspect``.
        drawn: the joined numbers of benches that are as uncertain as stated and have the change
            besides, shape (draws, K); None where the uncertainties stay the same.
    """

    what: str
    sizes: Array
    expected: Callable[[Array], Array]
    in_words: Callable[[float, float], str]
    remedy: str
    drawn: Callable[[float], Array] | None = None


@dataclass(frozen=True)
class Metric:
    """How far expected numbers are from the measured ones: chi squared in the full covariance, less
    what a covariance estimated from so many draws makes of it on average (Hartlap et al. 2007).
    """

    measured: Array
    scale: Array
    root: Array
    shrink: float

    def __call__(self, expected: Array) -> Array:
        """Chi squared of expected numbers, shape (..., K)."""
        found = np.sum(((self.measured - expected) / self.scale @ self.root) ** 2, axis=-1)
        return self.shrink * found


def metric_of(measured: Array, noise: Array, draws: Array) -> Metric:
    """The metric of measured numbers (K,), by the covariance of their noise (K, K) and of the draws
    of the model (n, K).
    """
    spread = draws - draws.mean(axis=0)
    covariance = noise + spread.T @ spread / (len(draws) - 1)
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = vectors / np.sqrt(np.maximum(values, values.max() * 1e-10))
    shrink = max((len(draws) - len(measured) - 2) / (len(draws) - 1), 0.1)
    return Metric(measured, scale, root, shrink)


def diagnose(
    found: list[Values], effects: tuple[Effect, ...], redrawn: int = REDRAWN
) -> tuple[Suspect, ...]:
    """Every suspect with the change that fits it best, the best suspect first.

    Args:
        found: what was measured, with the model's draws.
        effects: the changes that are tried.
        redrawn: how many of the likeliest are drawn anew with their change.
    """
    measured, noise, draws = joined(found)
    metric = metric_of(measured, noise, draws)
    before = float(metric(draws.mean(axis=0)))
    tried = sorted(
        (
            (effect, *_best(effect, metric, sizes, 0.0))
            for effect in effects
            for sizes in _sides(effect.sizes)
        ),
        key=lambda one: one[2],
    )
    suspects: dict[str, Suspect] = {}
    for place, (effect, size, chi2, uncertainty) in enumerate(tried):
        best = size, chi2, uncertainty
        if effect.drawn is not None and place < 2 * redrawn and chi2 < before - CLEAR:
            best = _drawn_anew(effect, effect.drawn(size), best, measured, noise)
        suspect = _suspect(effect, best, before, len(measured))
        other = suspects.get(effect.what)
        suspects[effect.what] = min((suspect, other or suspect), key=lambda one: one.chi2)
    return tuple(sorted(suspects.values(), key=lambda suspect: suspect.chi2))


def _sides(sizes: Array) -> list[Array]:
    """Changes to either side, each tried by itself: out of focus both blur alike, and the better
    one shows only where its benches are drawn.
    """
    below, above = sizes[sizes <= 0], sizes[sizes >= 0]
    return [side for side in (below, above) if len(side) > 1] or [sizes]


def _drawn_anew(
    effect: Effect, draws: Array, found: tuple[float, float, float], measured: Array, noise: Array
) -> tuple[float, float, float]:
    """The best size near one that was found, in the covariance of benches drawn with it."""
    size, _, uncertainty = found
    metric = metric_of(measured, noise, draws)
    aside = draws.mean(axis=0) - effect.expected(np.array([size]))[0]
    reach = abs(size) * REACH  # what was found in another covariance is less sure than it seems
    if math.isfinite(uncertainty):
        reach = max(reach, 5 * uncertainty)
    sizes = np.clip(size + reach * FINER, effect.sizes.min(), effect.sizes.max())
    return _best(effect, metric, sizes, aside)


def _best(
    effect: Effect, metric: Metric, sizes: Array, aside: float | Array
) -> tuple[float, float, float]:
    """The size that leaves least, what it leaves, and its standard uncertainty: where the
    disagreement grows by 1, by its curvature there.

    Args:
        effect: with the numbers expected of each size.
        metric: how far they are from those measured.
        sizes: that are tried first.
        aside: what is added to all expected numbers.
    """

    def left(tried: Array) -> Array:
        return metric(effect.expected(tried) + aside)

    tried, chi2 = sizes, left(sizes)
    for _ in range(ROUNDS):
        best = int(np.argmin(chi2))
        ends = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
        tried = np.interp(FINER, (-1.0, 1.0), ends)
        chi2 = left(tried)
    size, least = float(tried[np.argmin(chi2)]), float(chi2.min())
    step = (tried[-1] - tried[0]) / 2
    for _ in range(2):  # the second step is about as long as the uncertainty itself
        around = left(np.array([size - step, size + step]))
        curvature = float(around.sum() - 2 * least)
        if not (math.isfinite(curvature) and curvature > 0):
            return size, least, math.nan
        step = float(np.clip(step * math.sqrt(2 / curvature), 1e-9, np.ptp(sizes) / 4))
    return size, least, step


def _suspect(
    effect: Effect, best: tuple[float, float, float], before: float, numbers: int
) -> Suspect:
    size, chi2, uncertainty = best
    uncertainty *= math.sqrt(max(1.0, chi2 / numbers))
    explains = chi2 < numbers + EXPLAINED * math.sqrt(2 * numbers)
    return Suspect(
        effect.what,
        size,
        effect.in_words(size, uncertainty if explains else math.nan),
        chi2,
        before,
        numbers,
        uncertainty,
        float(stats.chi2.sf(chi2, max(numbers - 1, 1))),
        explains,
        effect.remedy,
    )


def likeliest(suspects: tuple[Suspect, ...]) -> tuple[Suspect, ...]:
    """The suspects that explain the measurement and fit it equally well; where none does, the
    closest one if it removes most of the disagreement.
    """
    if not suspects or suspects[0].chi2_before - suspects[0].chi2 < CLEAR:
        return ()
    best = suspects[0]
    if best.explains:
        alike = ALIKE * max(1.0, best.chi2 / best.numbers)
        return tuple(one for one in suspects if one.explains and one.chi2 <= best.chi2 + alike)
    return (best,) if best.chi2 <= MOST_LEFT * best.chi2_before else ()


def heading(suspects: tuple[Suspect, ...]) -> str:
    """What stands before the suspects that fit best."""
    if not suspects:
        return (
            "No single change explains it: no size of optics or targets, no turn, no zero of a"
            " stage, no exchange of settings, not the light."
        )
    if not suspects[0].explains:
        return "Closest single change, which does not explain it:"
    if len(suspects) == 1:
        return "Most likely cause:"
    return "Equally likely causes, which these measurements cannot distinguish:"


def changed(words: str, per_unit: float = 1.0) -> Callable[[float, float], str]:
    """What says a size with its uncertainty in shown units, in place of ``{}``; a negative one is
    ``smaller``, ``less`` or ``less far``; one without an uncertainty has two digits.
    """

    def in_words(size: float, uncertainty: float) -> str:
        said = words
        if size < 0:
            for up, down in OPPOSITES:
                said = said.replace(f" {up} ", f" {down} ")
        shown = abs(size) * per_unit
        if math.isfinite(uncertainty) and uncertainty > 0:
            return said.format(plus_minus(shown, uncertainty * per_unit))
        return said.replace("({})", f"about {two_digits(shown)}")

    return in_words


OPPOSITES = (("larger", "smaller"), ("more", "less"), ("farther", "less far"))


def _rounded(chi2: float) -> str:
    """Three digits, with commas: ``13,900``."""
    return f"{float(f'{chi2:.3g}'):,.0f}" if chi2 >= 100 else f"{chi2:.3g}"


def _percent(share: float) -> str:
    """A share that never looks complete while something is left: ``99.99 %``."""
    if share > 0.9999:
        return "more than 99.99 %"
    return f"{100 * share:.4g} %" if share > 0.99 else f"{100 * share:.2g} %"

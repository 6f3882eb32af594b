"""What may be wrong with a bench whose model is rejected: which single change would explain what
was measured.

Every suspect, a size of the optics, a turn of the array or the zero of a stage, is varied alone
over a range of values, first coarsely and then about the best; the model's numbers are compared
with the measured ones in their full covariance. Changes that fit equally well stand together. A
change explains the measurement only where what it leaves would not itself be rejected.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from flflab.bench import Bench, Element
from flflab.digits import plus_minus
from flflab.verdict.prediction import ELEMENTS, Errors, OpticsFactors, exact_optics, first_order
from flflab.verdict.properties.values import Values, joined

Array = npt.NDArray[np.float64]
LARGEST_TURN = 0.05  # rad
LARGEST_SHARE, LARGEST_NEAR_MM = (
    0.06,
    0.25,
)  # where the gap is about a millimetre; FAR times that for the target
FAR = 100.0
STEPS = np.geomspace(2e-3, 1.0, 40)
FIRST = np.concatenate([-STEPS[::-1], [0.0], STEPS])
FINER, ROUNDS = np.linspace(-1.0, 1.0, 21), 3
# of chi squared: 2 suspects closer than this are not told apart (4 to 1 odds at least by noise
# alone)
ALIKE = 6.0
CLEAR = 25.0  # of chi squared that a change must explain to be named at all
# of chi squared that a change may leave to be named, or twice the numbers compared: more is another
# fault's
MOST_LEFT = 0.1
KINDS = {
    "lens_focal": "focal length of the main lens",
    "lens_aperture": "aperture of the main lens (the f-number the other way)",
    "focal": "focal length of the microlenses", "aperture": "aperture of the microlenses",
    "pitch": "pitch of the microlenses",
}  # fmt: skip
TURNS = {
    "roll": "roll of the array",
    "yaw": "yaw of the array (its tilt along x)",
    "pitch": "pitch of the array (its tilt along y)",
}
MOVED = {"main_lens.z": "main lens", "array.z": "array", "sensor.z": "sensor", "target.z": "target"}


@dataclass(frozen=True)
class Suspect:
    """A single change of the bench that would explain what was measured, or part of it.

    Attributes:
        what: what would be different.
        size: of the change, a share, mm or rad.
        change: the same in words with unit and uncertainty.
        chi2: disagreement left, in the full covariance.
        chi2_before: without the change.
        numbers: how many numbers were compared.
        uncertainty: standard uncertainty of ``size``, enlarged where the change leaves more than
            noise does.
        p_left: p-value of the disagreement left.
        explains: whether what is left would not be rejected.
        remedy: what finds or mends it: ``calibrate``, ``align``, ``light``, ``lenses`` or ``lamp``.
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
    """Something outside the bench's geometry that may disturb what was measured.

    Attributes:
        what: its name.
        words: the change with its size, uncertainty and unit in place of ``{}``.
        per_unit: how many shown units one unit inside is.
        sizes: that are tried, rising; the effect is absent at the first one or at 0.
        expected: the joined numbers of a bench with each size, shape (n, K).
        remedy: as of ``Suspect``.
    """

    what: str
    words: str
    per_unit: float
    sizes: Array
    expected: Callable[[Array], Array]
    remedy: str


def diagnose(
    found: list[Values],
    numbers: Callable[[Errors], list[Values]],
    bench: Bench,
    effects: tuple[Effect, ...] = (),
    limit: float = 0.01,
) -> tuple[Suspect, ...]:
    """Every suspect with the change that fits it best, the best suspect first.

    Args:
        found: what was measured, with the model's draws.
        numbers: the same numbers for benches with given errors.
        bench: whose stages are suspects.
        effects: further suspects, besides stages and sizes.
        limit: p-value below which what a change leaves would itself be rejected.
    """
    measured, noise, draws = joined(found)
    spread = draws - draws.mean(axis=0)
    covariance = noise + spread.T @ spread / (len(draws) - 1)
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = vectors / np.sqrt(np.maximum(values, values.max() * 1e-10))

    def disagreement(expected: Array) -> Array:
        return np.sum(((measured - expected) / scale @ root) ** 2, axis=-1)

    before = float(disagreement(draws.mean(axis=0)))
    suspects: list[Suspect] = []
    for effect in (*_geometry(bench, numbers), *effects):

        def left(sizes: Array, of: Effect = effect) -> Array:
            return disagreement(of.expected(sizes))

        size, chi2, uncertainty = _best(left, effect.sizes)
        uncertainty *= math.sqrt(max(1.0, chi2 / len(measured)))
        p_left = _p_value(chi2, len(measured), len(draws))
        suspects.append(
            Suspect(
                effect.what,
                size,
                _in_words(effect, size, uncertainty),
                chi2,
                before,
                len(measured),
                uncertainty,
                p_left,
                p_left >= limit,
                effect.remedy,
            )
        )
    return tuple(sorted(suspects, key=lambda suspect: suspect.chi2))


def _best(left: Callable[[Array], Array], sizes: Array) -> tuple[float, float, float]:
    """The size that leaves least, what it leaves, and its standard uncertainty: where the
    disagreement grows by 1, by its curvature there.
    """
    tried, chi2 = sizes, left(sizes)
    for _ in range(ROUNDS):
        best = int(np.argmin(chi2))
        tried = np.interp(
            FINER, (-1.0, 1.0), (tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)])
        )
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


def _p_value(chi2: float, numbers: int, draws: int) -> float:
    """Of a disagreement whose covariance was estimated from draws (Hotelling's T²), with one
    parameter fitted.
    """
    free = max(numbers - 1, 1)
    if draws <= numbers + 1:
        return float(stats.chi2.sf(chi2, free))
    return float(stats.f.sf(chi2 * (draws - free) / (free * (draws - 1)), free, draws - free))


def not_told_apart(suspects: tuple[Suspect, ...]) -> tuple[Suspect, ...]:
    """The best suspect and those that fit equally well; none where no single change removes most of
    the disagreement.
    """
    if not suspects:
        return ()
    best = suspects[0]
    if best.chi2_before - best.chi2 < CLEAR or best.chi2 > max(
        MOST_LEFT * best.chi2_before, 2.0 * best.numbers
    ):
        return ()
    return tuple(suspect for suspect in suspects if suspect.chi2 <= best.chi2 + ALIKE)


def heading(suspects: tuple[Suspect, ...]) -> str:
    """What stands before the suspects that fit best."""
    if not suspects:
        return (
            "No single change explains it: no size of the optics, no turn of the array, no zero of"
            " a stage, not diffraction, blur or the lamp."
        )
    if not suspects[0].explains:
        return "Closest single change:" if len(suspects) == 1 else "Closest single changes:"
    if len(suspects) == 1:
        return "Most likely cause:"
    return "Equally likely causes, which these measurements cannot distinguish:"


def turns_among(suspects: tuple[Suspect, ...]) -> tuple[Suspect, ...]:
    """Those that turn the array."""
    return tuple(suspect for suspect in suspects if suspect.what in TURNS.values())


@dataclass(frozen=True)
class Suspicion:
    """Something that may be other than described.

    Attributes:
        what: its name.
        field: the field of the optics' factors, the element whose place it is, or how the array is
            turned.
        largest: change that is tried at most, as a share, in mm or rad.
        unit: of the change.
    """

    what: str
    field: str
    largest: float
    unit: str


def _suspicions(bench: Bench) -> list[Suspicion]:
    found = [
        Suspicion(KINDS[field.name], field.name, LARGEST_SHARE, "%")
        for field in fields(OpticsFactors)
    ]
    found += [Suspicion(what, turn, LARGEST_TURN, "rad") for turn, what in TURNS.items()]
    for element in ELEMENTS:
        axis = bench.description.axis_of(element)
        name = f"zero of {axis[0]}" if axis else f"place of the {MOVED[element]}"
        found.append(
            Suspicion(
                name, element, LARGEST_NEAR_MM * (FAR if element == "target.z" else 1.0), "mm"
            )
        )
    return found


WORDS = {  # of a change by its unit: words, shown units in one inside, remedy
    "%": ("({}) % larger than described", 100.0, "calibrate"),
    "rad": ("({}) deg more than described", 180 / math.pi, "align"),
    "mm": ("({}) mm farther along z than described", 1.0, "calibrate"),
}
OPPOSITES = (("larger", "smaller"), ("more", "less"), ("farther", "less far"))


def _geometry(bench: Bench, numbers: Callable[[Errors], list[Values]]) -> list[Effect]:
    """Sizes of the optics, turns of the array and zeros of the stages."""

    def effect(suspicion: Suspicion) -> Effect:
        words, per_unit, remedy = WORDS[suspicion.unit]

        def expected(changes: Array) -> Array:
            return joined(numbers(_errors(suspicion, changes)))[2]

        sizes = suspicion.largest * FIRST
        return Effect(suspicion.what, words, per_unit, sizes, expected, remedy)

    return [effect(suspicion) for suspicion in _suspicions(bench)]


def _errors(suspect: Suspicion, changes: Array) -> Errors:
    """Benches with just that change, one for each."""
    still, exact = np.zeros(len(changes)), exact_optics(len(changes))
    stages: dict[Element, tuple[Array, Array]] = {
        element: (changes if element == suspect.field else still, still) for element in ELEMENTS
    }
    turned = suspect.unit == "rad"  # a pitch may be of the microlenses too
    attitude = np.stack(
        [changes if turned and turn == suspect.field else still for turn in TURNS], axis=1
    )
    changed = {suspect.field: 1 + changes} if suspect.unit == "%" else {}
    if suspect.field == "lens_focal":
        changed["lens_aperture"] = (
            1 + changes
        )  # the f-number stays: a longer lens has a wider aperture
    return Errors(stages, replace(exact, **changed), attitude, first_order(len(changes)))


def _in_words(effect: Effect, size: float, uncertainty: float) -> str:
    """``(1.850 ± 0.020) % larger than described``."""
    words = effect.words
    if size < 0:
        for up, down in OPPOSITES:
            words = words.replace(f" {up} ", f" {down} ")
    shown = plus_minus(abs(size) * effect.per_unit, uncertainty * effect.per_unit)
    return words.format(shown) if "±" in shown else words.replace("({})", shown)


def _rounded(chi2: float) -> str:
    """Three digits, with commas: ``13,900``."""
    return f"{float(f'{chi2:.3g}'):,.0f}" if chi2 >= 100 else f"{chi2:.3g}"


def _percent(share: float) -> str:
    """A share that never looks complete while something is left: ``99.99 %``."""
    if share > 0.9999:
        return "more than 99.99 %"
    return f"{100 * share:.4g} %" if share > 0.99 else f"{100 * share:.2g} %"

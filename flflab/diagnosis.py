"""What may be wrong with a bench whose model is rejected: which single change would explain what
was measured.

Every suspect, a size of the optics, a turn of the array or the zero of a stage, is varied alone
over a range of values, first coarsely and then about the best; the model's numbers are compared
with the measured ones in their full covariance. What explains as well as the best cannot be told
from it, and that is said.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench, Element
from flflab.prediction import ELEMENTS, Errors, OpticsFactors, exact_optics, first_order
from flflab.properties.values import Values, joined

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
    """A single change of the bench that would explain what was measured.

    Attributes:
        what: what would be different.
        size: of the change, a share, mm or rad.
        change: the same in words with a unit.
        chi2: disagreement left, in the full covariance.
        chi2_before: without the change.
        numbers: how many numbers were compared.
    """

    what: str
    size: float
    change: str
    chi2: float
    chi2_before: float
    numbers: int

    @property
    def sentence(self) -> str:
        """The suspect in one sentence."""
        return (
            f"{self.what} {self.change} than described would leave a disagreement of"
            f" {self.chi2:.3g} instead of {self.chi2_before:.3g} (chi squared of {self.numbers}"
            " values)"
        )


def diagnose(
    found: list[Values], numbers: Callable[[Errors], list[Values]], bench: Bench
) -> tuple[Suspect, ...]:
    """Every suspect with the change that fits it best, the best suspect first.

    Args:
        found: what was measured, with the model's draws.
        numbers: the same numbers for benches with given errors.
        bench: whose stages are suspects.
    """
    measured, noise, draws = joined(found)
    spread = draws - draws.mean(axis=0)
    covariance = noise + spread.T @ spread / (len(draws) - 1)
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = vectors / np.sqrt(np.maximum(values, values.max() * 1e-10))

    def disagreement(expected: Array) -> Array:
        return np.sum(((measured - expected) / scale @ root) ** 2, axis=-1)

    def left(suspect: Suspicion, changes: Array) -> Array:
        return disagreement(joined(numbers(_errors(suspect, changes)))[2])

    before = float(disagreement(draws.mean(axis=0)))
    suspects: list[Suspect] = []
    for suspect in _suspicions(bench):
        tried = suspect.largest * FIRST
        chi2 = left(suspect, tried)
        for _ in range(ROUNDS):
            best = int(np.argmin(chi2))
            tried = np.interp(
                FINER, (-1.0, 1.0), (tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)])
            )
            chi2 = left(suspect, tried)
        change = float(tried[np.argmin(chi2)])
        suspects.append(
            Suspect(
                suspect.what,
                change,
                _words(change, suspect.unit),
                float(chi2.min()),
                before,
                len(measured),
            )
        )
    return tuple(sorted(suspects, key=lambda suspect: suspect.chi2))


def not_told_apart(suspects: tuple[Suspect, ...]) -> tuple[Suspect, ...]:
    """The best suspect and those that explain as well; none where no single change explains most of
    it.
    """
    if not suspects:
        return ()
    best = suspects[0]
    if best.chi2_before - best.chi2 < CLEAR or best.chi2 > max(
        MOST_LEFT * best.chi2_before, 2.0 * best.numbers
    ):
        return ()
    return tuple(suspect for suspect in suspects if suspect.chi2 <= best.chi2 + ALIKE)


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


def _words(change: float, unit: str) -> str:
    if unit == "%":
        return f"{abs(100 * change):.3g} % {'larger' if change > 0 else 'smaller'}"
    if unit == "rad":
        return f"{abs(math.degrees(change)):.3g} deg {'more' if change > 0 else 'less'}"
    return f"{abs(change):.3g} mm {'farther' if change > 0 else 'less far'} along z"

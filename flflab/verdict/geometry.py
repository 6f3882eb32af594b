"""Changes of a bench's geometry, as suspects of ``diagnose``: sizes of optics and targets, turns of
array and target, zeros of stages.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.bench import Bench
from flflab.verdict.diagnosis import Effect, changed
from flflab.verdict.prediction import ELEMENTS, Errors, as_described
from flflab.verdict.properties.values import Values, joined

Array = npt.NDArray[np.float64]
LARGEST_TURN, LARGEST_SHARE = 0.2, 0.2  # rad, and of a size: as large as mistakes are
LARGEST_NEAR = 0.25  # mm, where the gap is about a millimetre
FAR = 100.0  # times that for the target
STEPS = np.geomspace(1e-3, 1.0, 40)
ALL_STEPS = np.concatenate([-STEPS[::-1], [0.0], STEPS])
SIZES = {  # fields of the optics' factors that change together
    "focal length of the main lens (its f-number as set)": ("lens_focal", "lens_aperture"),
    "focal length of the main lens (its stop as it is)": ("lens_focal",),
    "aperture of the main lens (its f-number changes inversely)": ("lens_aperture",),
    "focal length of the microlenses": ("focal",),
    "aperture of the microlenses": ("aperture",),
    "pitch of the microlenses": ("pitch",),
    "pixel size": ("pixel",),
}
TURNS = ("roll of the array", "yaw of the array (its tilt along x)",
         "pitch of the array (its tilt along y)")  # fmt: skip
TARGET_TURNS = ("roll of the target", "tilt of the target along x", "tilt of the target along y")
MOVED = {"main_lens.z": "main lens", "array.z": "array", "sensor.z": "sensor", "target.z": "target"}
Change = Callable[[Errors, Array], Errors]  # errors with a change of each size besides


@dataclass(frozen=True)
class Suspicion:
    """Something of the geometry that may be other than described.

    Attributes:
        what: its name.
        largest: change that is tried at most, as a share, in rad or in mm.
        words: of a change.
        unit: that is shown.
        per_unit: shown units in one of the change's.
        remedy: as of ``Suspect``.
        change: adds changes to errors.
    """

    what: str
    largest: float
    words: str
    unit: str
    per_unit: float
    remedy: str
    change: Change


def geometry(
    bench: Bench, errors: Errors, numbers: Callable[[Errors], list[Values]]
) -> tuple[Effect, ...]:
    """Every change of the geometry.

    Args:
        bench: whose stages are suspects.
        errors: draws of what the bench file states.
        numbers: the numbers that are explained, for benches with given errors.
    """
    mean = joined(numbers(errors))[2].mean(axis=0)
    plain = joined(numbers(as_described(1)))[2][0]

    def effect(one: Suspicion) -> Effect:
        def expected(sizes: Array) -> Array:
            # what the errors' spread adds to the mean is kept
            changed_alone = joined(numbers(one.change(as_described(len(sizes)), sizes)))[2]
            return changed_alone - plain + mean

        def drawn(size: float) -> Array:
            return joined(numbers(one.change(errors, np.full(len(errors.attitude), size))))[2]

        words = changed(one.words, one.per_unit)
        return Effect(one.what, one.largest * ALL_STEPS, expected, words, one.remedy, drawn)

    return tuple(effect(one) for one in suspicions(bench))


def suspicions(bench: Bench) -> list[Suspicion]:
    """All that is tried for this bench."""
    found = [
        Suspicion(what, LARGEST_SHARE, "({}) % larger than described", "%", 100.0, "calibrate",
                  _larger(names))
        for what, names in SIZES.items()
    ]  # fmt: skip
    plates: dict[str, Change] = {
        "spacing of the dots": lambda errors, sizes: replace(
            errors, dots=errors.dots * (1 + sizes)
        ),
        "frequency of the bars": lambda errors, sizes: replace(
            errors, bars=errors.bars / (1 + sizes)
        ),
    }
    found += [
        Suspicion(what, LARGEST_SHARE, "({}) % larger than described", "%", 100.0, "calibrate",
                  change)
        for what, change in plates.items()
    ]  # fmt: skip
    found += [
        Suspicion(what, LARGEST_TURN, "({}) deg more than described", "deg", 180 / math.pi, "align",
                  _turned(name, axis))
        for name, turns in (("attitude", TURNS), ("target", TARGET_TURNS))
        for axis, what in enumerate(turns)
    ]  # fmt: skip
    for element in ELEMENTS:
        axis = bench.description.axis_of(element)
        name = f"zero of {axis[0]}" if axis else f"place of the {MOVED[element]}"
        largest = LARGEST_NEAR * (FAR if element == "target.z" else 1.0)
        words = "({}) mm farther along z than described"
        found.append(Suspicion(name, largest, words, "mm", 1.0, "calibrate", _moved(element)))
    return found


def _larger(names: tuple[str, ...]) -> Change:
    def change(errors: Errors, sizes: Array) -> Errors:
        larger = {name: getattr(errors.optics, name) * (1 + sizes) for name in names}
        return replace(errors, optics=replace(errors.optics, **larger))

    return change


def _turned(name: str, axis: int) -> Change:
    def change(errors: Errors, sizes: Array) -> Errors:
        turned = getattr(errors, name) + sizes[:, None] * (np.arange(3) == axis)
        return replace(errors, **{name: turned})

    return change


def _moved(element: str) -> Change:
    def change(errors: Errors, sizes: Array) -> Errors:
        stages = {
            one: (zero + sizes * (one == element), scale)
            for one, (zero, scale) in errors.stages.items()
        }
        return replace(errors, stages=stages)

    return change

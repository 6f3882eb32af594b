"""How well a configuration must be built: what each dimension's error changes, and how many of many
built ones meet the demands.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.design.dual import Dual, dimensions
from flflab.design.figures import half_seen, marginal_angle, solve_figures
from flflab.design.grid import Candidates
from flflab.design.judgement import demands, met
from flflab.design.requirements import Requirements, TolerancesDescription
from flflab.optics.configurations import properties_of

Array = npt.NDArray[np.float64]

DIMENSIONS = (
    "gap",
    "tilt",
    "array_distance",
    "focal_length",
    "aperture",
    "pitch",
    "main_lens_focal_length",
    "f_number",
)
RELATIVE = ("focal_length", "aperture", "pitch", "main_lens_focal_length", "f_number")
MODEL_NAMES = {
    "gap": "gap",
    "array_distance": "array_distance",
    "focal_length": "focal",
    "aperture": "aperture",
    "pitch": "pitch",
    "main_lens_focal_length": "lens_focal",
    "f_number": "f_number",
}
PROPERTIES = {
    "virtual_depth": ("", 1.0),
    "magnification": ("", 1.0),
    "blur": ("um", 1e3),
    "contrast": ("", 1.0),
    "useful_width": ("um", 1e3),
    "elr": ("px", 1.0),
    "sharp_distance": ("mm", 1.0),
    "marginal_angle": ("deg", 180 / math.pi),
}
CONE = ("gap", "array_distance", "lens_focal", "f_number", "focal", "aperture")
DRAWS = 20_000
_KEY = 20260


@dataclass(frozen=True)
class Sensitivity:
    """What one property does when dimensions are off.

    Attributes:
        name: of the property.
        unit: of the numbers below.
        value: of the property as asked for.
        per_tolerance: its change, to first order, when a dimension is off by its tolerance; one for
            each of ``DIMENSIONS``.
    """

    name: str
    unit: str
    value: float
    per_tolerance: tuple[float, ...]


@dataclass(frozen=True)
class Yield:
    """How many built cameras meet every demand.

    Attributes:
        share: of them.
        uncertainty: its standard uncertainty from the number of draws.
        halved: the share where one tolerance is half as wide, by its name; only tolerances above 0.
    """

    share: float
    uncertainty: float
    halved: dict[str, float]

    @property
    def buys_most(self) -> str | None:
        """The tolerance whose halving raises the share most; None where none does."""
        if not self.halved:
            return None
        name = max(self.halved, key=lambda one: self.halved[one])
        return name if self.halved[name] > self.share else None


def sensitivities(given: Candidates, wanted: Requirements) -> tuple[Sensitivity, ...]:
    """Derivatives of the properties in the middle of the depth, exact to rounding, times the
    tolerances.

    A tilt moves a microlens at the array's edge along the axis by tilt times half the width: the
    array distance grows as the gap shrinks.

    Args:
        given: one configuration.
        wanted: the requirements with the tolerances.
    """
    near, far = wanted.measure.depth
    start = [given.gap[0], given.place[0], given.focal[0], given.aperture[0], given.pitch[0]]
    start += [given.lens_focal[0], given.f_number[0]]
    duals = dict(
        zip(
            (name for name in DIMENSIONS if name != "tilt"),
            dimensions([float(value) for value in start]),
            strict=True,
        )
    )
    fixed = {"distance": 2 * near * far / (near + far), "pixel": given.sensor.pixel}
    fixed["cycles_per_mm"] = wanted.require.contrast.at if wanted.require.contrast else 0.0
    numbers: dict[str, Any] = {MODEL_NAMES[name]: dual for name, dual in duals.items()}
    numbers |= {name: np.array([value]) for name, value in fixed.items()}
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found: dict[str, Any] = dict(
            properties_of(
                numbers,
                given.array.count[0],
                given.sensor.resolution[0],
                wanted.minimum_illumination,
            )
        )
        found["sharp_distance"] = 1 / found["sharp_vergence"]
        found["marginal_angle"] = marginal_angle(*(numbers[name] for name in CONE))
    steps = _steps(given, wanted.tolerances)
    edge = float(half_seen(given)[0])
    rows: list[Sensitivity] = []
    for name, (unit, factor) in PROPERTIES.items():
        dual: Dual = found[name]
        by = dict(zip(duals, dual.slope[0], strict=True))
        by["tilt"] = edge * (by["array_distance"] - by["gap"])
        changes = tuple(factor * float(by[one]) * steps[one] for one in DIMENSIONS)
        rows.append(Sensitivity(name, unit, factor * float(dual.value[0]), changes))
    return tuple(rows)


def _steps(given: Candidates, tolerances: TolerancesDescription) -> dict[str, float]:
    """Every tolerance in mm, rad or, for the f-number, as a number."""
    base = {
        "focal_length": float(given.focal[0]),
        "aperture": float(given.aperture[0]),
        "pitch": float(given.pitch[0]),
        "main_lens_focal_length": float(given.lens_focal[0]),
        "f_number": float(given.f_number[0]),
    }
    return {
        name: getattr(tolerances, name) * (base[name] if name in RELATIVE else 1.0)
        for name in DIMENSIONS
    }


def built_yield(given: Candidates, wanted: Requirements, draws: int = DRAWS) -> Yield:
    """Build a configuration many times within the tolerances and count those that meet every
    demand, at both edges of the array too.

    The same draws serve every halved tolerance, so that small differences are no accident of
    drawing.

    Args:
        given: one configuration.
        wanted: the requirements with the tolerances.
        draws: how many are built.
    """
    unit = np.random.Generator(np.random.Philox(key=_KEY)).uniform(
        -1.0, 1.0, (len(DIMENSIONS), draws)
    )
    steps = _steps(given, wanted.tolerances)

    def share(widths: dict[str, float]) -> float:
        return float(
            _all_met(
                given,
                wanted,
                {name: widths[name] * unit[row] for row, name in enumerate(DIMENSIONS)},
            ).mean()
        )

    whole = share(steps)
    halved = {
        name: share(steps | {name: steps[name] / 2}) for name in DIMENSIONS if steps[name] > 0
    }
    return Yield(whole, math.sqrt(max(whole * (1 - whole), 1 / draws) / draws), halved)


def _all_met(
    given: Candidates, wanted: Requirements, off: dict[str, Array]
) -> npt.NDArray[np.bool_]:
    asked, edge = demands(wanted), float(half_seen(given)[0])
    good = np.ones(len(off["gap"]), dtype=np.bool_)
    for side in (-1.0, 0.0, 1.0):
        rise = side * edge * np.tan(off["tilt"])
        built = _built(given, off, rise)
        good &= met(asked, solve_figures(built, wanted))
    return good


def _built(given: Candidates, off: dict[str, Array], rise: Array) -> Candidates:
    """The configuration built many times; an array that is off carries the sensor with it, a tilted
    one does not.
    """
    count = len(off["gap"])
    pitch = given.pitch + off["pitch"]
    return replace(
        given,
        number_in_grid=np.repeat(given.number_in_grid, count),
        lens=np.repeat(given.lens, count),
        lens_focal=given.lens_focal + off["main_lens_focal_length"],
        f_number=given.f_number + off["f_number"],
        place=given.place + off["array_distance"] + rise,
        gap=np.maximum(given.gap + off["gap"] - rise, 1e-6),
        focal=given.focal + off["focal_length"],
        pitch=pitch,
        aperture=np.minimum(given.aperture + off["aperture"], pitch),
    )

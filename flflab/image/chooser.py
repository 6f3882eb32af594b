"""Which effects a picture needs to be right to a tolerance, and what they leave of the tolerance to
the orders of quadrature.

An effect's bound holds whichever of the others are left out, so the picture without some of them is
off by at most the sum of their bounds. What a bound takes from the tolerance the quadrature must
make good by finer orders, which cost time. So an effect's share of the tolerance is its share of
the time: what is left out has a bound within it, and the bounds together stay below half the
tolerance. Most of the rest goes to the quadrature of what is kept.
"""

import math
from dataclasses import dataclass

from flflab.errors import InputError
from flflab.image.effects.defocus import Defocus
from flflab.image.effects.effect import Effect
from flflab.image.effects.misalignment import Misalignment
from flflab.image.effects.occlusion import Occlusion
from flflab.image.effects.overlap import Overlap
from flflab.image.effects.pixel import Pixel
from flflab.image.effects.vignetting import Vignetting
from flflab.image.regime import Regime
from flflab.image.render import LEAST_TOLERANCE, TOLERANCE
from flflab.image.scene import ALL, Scene
from flflab.image.survey import survey

LEVELS = ("auto", "fast", "reference")
FAST = 5.0  # what ``fast`` makes of the tolerance
SHARE = 0.5  # of the tolerance, for all effects left out
KEPT = 0.7  # of the rest, for the quadrature: measured errors are up to 1.2 times its tolerance
LIGHT = (
    "defocus",
    "vignetting",
    "overlap",
    "pixel",
    "diffraction",
    "falloff",
    "distortion",
    "misalignment",
    "occlusion",
    "scatter",
    "stray-light",
    "colour-filter",
    "motion",
)
NOISE = (
    "shot-noise",
    "read-noise",
    "dark-current",
    "fixed-pattern",
    "dead-pixels",
    "saturation",
    "quantisation",
)


@dataclass(frozen=True)
class Decision:
    """Whether an effect is in the picture, and what speaks for it; a size of None: the scene has no
    such effect.
    """

    name: str
    on: bool
    size: float | None
    unit: str
    bound: float
    why: str
    cost: float


@dataclass(frozen=True)
class Choice:
    """What a picture is formed of: every effect of the light, the tolerance of the quadrature, and
    the largest error promised.
    """

    decisions: tuple[Decision, ...]
    tolerance: float
    promised: float
    regime: Regime

    @property
    def effects(self) -> frozenset[str]:
        """The names of what is on."""
        return frozenset(decision.name for decision in self.decisions if decision.on)

    @property
    def formed(self) -> frozenset[str]:
        """Those that ``render`` can leave out; cards hide what is behind them always."""
        return self.effects & ALL


def effects_of(scene: Scene) -> tuple[Effect, ...]:
    """The effects of the light that a scene has; misalignment and occlusion only where something is
    out of line or hides something.
    """
    turned = tuple((plane.roll, math.hypot(*plane.tilt)) for plane in scene.planes)
    described = (
        scene.diffraction,
        scene.falloff,
        scene.distortion,
        scene.scatter,
        scene.stray_light,
        scene.colour_filter,
        scene.motion,
    )
    array, sensor = scene.camera.array, scene.camera.sensor
    out_of_line = any(
        (
            *array.offset,
            array.roll,
            *array.tilt,
            *sensor.offset,
            *(part for plane in turned for part in plane),
        )
    )
    return (
        Defocus(),
        Vignetting(),
        Overlap(),
        Pixel(),
        *([Misalignment(turned, scene.camera.main_lens.aperture)] if out_of_line else []),
        *([Occlusion()] if len(scene.planes) > 1 else []),
        *(effect for effect in described if effect is not None),
    )


def choose(scene: Scene, tolerance: float, asked: str = "auto") -> Choice:
    """Choose the effects of a picture.

    Args:
        scene: what is pictured.
        tolerance: largest error asked for, of white.
        asked: ``auto``, ``fast`` (five times the tolerance), ``reference`` (all the scene has, as
            finely as it goes), or names of effects joined by commas; those of the noise are passed
            over.

    Raises:
        InputError: an unknown name, or a tolerance that is not a share of white or below what the
            quadrature can keep.
    """
    check_tolerance(tolerance)
    regime = survey(scene)
    present = {effect.name: effect for effect in effects_of(scene)}
    bounds = {name: effect.bound(regime) for name, effect in present.items()}
    if asked in LEVELS:
        allowed = (
            LEAST_TOLERANCE
            if asked == "reference"
            else min(tolerance * (FAST if asked == "fast" else 1.0), 0.5)
        )
        shares = _shares(
            {name: effect.cost(regime) for name, effect in present.items()},
            0.0 if asked == "reference" else allowed,
        )
        left_out = _left_out(
            {name: bounds[name] for name in present.keys() & ALL}, shares, SHARE * allowed
        )
        rest = max(KEPT * (allowed - sum(bounds[name] for name in left_out)), LEAST_TOLERANCE)
        on = present.keys() - left_out
    else:
        on, rest, allowed = present.keys() & named(asked), tolerance, math.inf
        for name in sorted(present.keys() - ALL - on):
            raise InputError(
                f"effects: '{name}' cannot be left out of this scene; add it to the list"
            )
    decisions = [
        _decide(name, present.get(name), name in on, bounds.get(name, 0.0), asked, regime)
        for name in LIGHT
    ]
    return Choice(tuple(decisions), rest, allowed, regime)


def check_tolerance(tolerance: float) -> None:
    """Refuse what no picture can keep.

    Raises:
        InputError: the tolerance is not a number above what the quadrature can keep and below
            white.
    """
    if not (math.isfinite(tolerance) and 2 * LEAST_TOLERANCE <= tolerance < 1):
        raise InputError(
            f"tolerance: {tolerance:g} of white; from {2 * LEAST_TOLERANCE:g}, below which the"
            f" reference itself is not sure, to below 1 is allowed; give {TOLERANCE:g}, for"
            " instance"
        )


def named(asked: str) -> frozenset[str]:
    """The names in a list of effects.

    Raises:
        InputError: one of them is unknown or stands alone, or there is none.
    """
    names = frozenset(name.strip() for name in asked.split(",") if name.strip())
    allowed = f"one of {', '.join(LEVELS)}, or a list of {', '.join((*LIGHT, *NOISE))}"
    if names & {*LEVELS}:
        raise InputError(
            f"effects: '{asked}' is a list; {', '.join(LEVELS)} stand alone; give {allowed}"
        )
    for name in sorted(names - {*LIGHT, *NOISE}):
        raise InputError(f"effects: there is no '{name}'; allowed: {allowed}")
    if not names:
        raise InputError(f"effects: the list is empty; give {allowed}")
    return names


def _shares(costs: dict[str, float], allowed: float) -> dict[str, float]:
    """Each effect's share of the tolerance, which is its share of the time."""
    total = sum(costs.values())
    return {name: allowed * cost / total for name, cost in costs.items()}


def _left_out(bounds: dict[str, float], shares: dict[str, float], most: float) -> set[str]:
    """The effects whose bounds are within their shares, the smallest first, as long as the bounds'
    sum is no larger than ``most``.
    """
    out: set[str] = set()
    total = 0.0
    for name, bound in sorted(bounds.items(), key=lambda item: item[1]):
        if bound <= shares[name] and total + bound <= most:
            total += bound
            out.add(name)
    return out


def _decide(
    name: str, effect: Effect | None, on: bool, bound: float, asked: str, regime: Regime
) -> Decision:
    if effect is None:
        return Decision(name, False, None, "", 0.0, "the scene has none", 0.0)
    why = effect.why(regime)
    if not on:
        why += ": too little to matter" if asked in LEVELS else ": not asked for"
    elif asked not in ("auto", "fast") and bound < LEAST_TOLERANCE:
        why += ": too little to matter, but asked for"
    return Decision(name, on, effect.size(regime), effect.unit, bound, why, effect.cost(regime))

"""Which effects a picture needs to be right to a tolerance, and what they leave of the tolerance
for forming it.

An effect's bound holds whichever of the others are left out, so the picture without some of them is
off by at most the sum of their bounds. An effect is left out where its bound is within its share
and that saves time: its share of the tolerance is its share of the time. An effect whose absence
lets closed forms take the place of rays saves the difference.
"""

import math
from dataclasses import dataclass, fields

from flflab.errors import InputError
from flflab.image.accuracy import FAST, LEAST_TOLERANCE, LEFT_OUT, check_tolerance, for_forming
from flflab.image.effects.defocus import Defocus
from flflab.image.effects.effect import Effect
from flflab.image.effects.misalignment import Misalignment
from flflab.image.effects.occlusion import Occlusion
from flflab.image.effects.overlap import Overlap
from flflab.image.effects.pixel import Pixel
from flflab.image.effects.vignetting import Vignetting
from flflab.image.path import path_of
from flflab.image.regime import Regime
from flflab.image.scene import ALL, DESCRIBED, Scene, without
from flflab.image.sensor.response import SensorResponse
from flflab.image.survey import survey

LEVELS = ("auto", "fast", "reference")
WORTH = 0.1  # of the time: what saves less is not left out
# effects for whose sake a scene may need rays
PATH = ("distortion", "misalignment", "motion", "spherical-aberration")
LIGHT = ("defocus", "vignetting", "overlap", "pixel", "misalignment", "occlusion", *DESCRIBED)
NOISE = tuple(one.name.replace("_", "-") for one in fields(SensorResponse))


@dataclass(frozen=True)
class Decision:
    """Whether an effect is in the picture, its size in ``unit``, most that leaving it out can
    change (of white), why, and the milliseconds that it costs.

    A size of None: the scene has no such effect, or it has no size.
    """

    name: str
    on: bool
    size: float | None
    unit: str
    bound: float
    why: str
    ms: float


@dataclass(frozen=True)
class Choice:
    """What a picture is formed of: every effect of the light, the tolerance left for forming it,
    and the sum of the bounds of what is left out.
    """

    decisions: tuple[Decision, ...]
    tolerance: float
    left_out: float
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
    turned = tuple((plane.askew, math.hypot(*plane.tilt)) for plane in scene.planes)
    described = (getattr(scene, name.replace("-", "_")) for name in DESCRIBED)
    in_line = without(scene, ALL - {"misalignment"}).camera == scene.camera
    out_of_line = not in_line or any(map(any, turned))
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
        tolerance: root mean square of the error asked for, of white.
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
        allowed, left_out = LEAST_TOLERANCE, frozenset[str]()
        if asked != "reference":
            allowed = min(tolerance * (FAST if asked == "fast" else 1.0), 0.5)
            left_out = _left_out(bounds, _costs(scene, present, regime, allowed), allowed)
        rest = for_forming(allowed, sum(bounds[name] for name in left_out))
        on = present.keys() - left_out
    else:
        on, rest = present.keys() & named(asked), tolerance
        for name in sorted(present.keys() - ALL - on):
            raise InputError(
                f"effects: '{name}' cannot be left out of this scene; add it to the list"
            )
    decisions: list[Decision] = []
    for name in LIGHT:
        remark = ""
        if name not in on:
            remark = ": too little to matter" if asked in LEVELS else ": not requested"
        elif asked not in ("auto", "fast") and bounds[name] < LEAST_TOLERANCE:
            remark = ": too little to matter, but requested"
        decisions.append(decided(name, present.get(name), regime, name in on, remark))
    lost = sum(bounds[name] for name in present.keys() - on) if asked in LEVELS else 0.0
    return Choice(tuple(decisions), rest, lost, regime)


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


def _costs(
    scene: Scene, present: dict[str, Effect], regime: Regime, tolerance: float
) -> dict[str, float]:
    """What each effect costs, ms on one core; one for whose sake no rays are needed costs
    nothing.
    """
    costs = {name: effect.cost(regime) for name, effect in present.items()}
    by_rays = path_of(scene, tolerance)[0] == "rays"
    for name in present.keys() & set(PATH):
        needed = by_rays and path_of(without(scene, ALL - {name}), tolerance)[0] != "rays"
        costs[name] = costs[name] if needed else 0.0
    return costs


def _left_out(bounds: dict[str, float], costs: dict[str, float], allowed: float) -> frozenset[str]:
    """The effects whose bounds are within their shares of the tolerance, which are their shares of
    the time, the smallest first, as long as the bounds' sum is within ``LEFT_OUT``.
    """
    out: set[str] = set()
    total, lost = max(sum(costs.values()), 1e-300), 0.0
    for name in sorted(costs.keys() & ALL, key=lambda name: bounds[name]):
        share, bound = costs[name] / total, bounds[name]
        if share > WORTH and bound <= share * allowed and lost + bound <= LEFT_OUT * allowed:
            lost += bound
            out.add(name)
    return frozenset(out)


def decided(
    name: str, effect: Effect | None, regime: Regime, on: bool, remark: str, of: str = "scene"
) -> Decision:
    """What an effect says of itself, and a remark; None where the scene, or what it is of, has
    none.
    """
    if effect is None:
        return Decision(name, False, None, "", 0.0, f"the {of} has none", 0.0)
    size, bound, cost = effect.size(regime), effect.bound(regime), effect.cost(regime)
    return Decision(name, on, size, effect.unit, bound, effect.why(regime) + remark, cost)

"""The one true state of the simulated bench, hidden errors included: where everything really stands
and what the camera sees.

Hidden errors are drawn once, each from a generator keyed by the seed and its name, so that none
depends on another or on the order of drawing. Travel is measured from a stage's home end in mm, or
in rad from its home for what turns the array; its place in the world is zero + sign (1 + scale)
travel.
"""

import hashlib
import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from flflab.bench import AxisDescription, Bench, Element, Turn
from flflab.errors import InputError
from flflab.files.target import target_from
from flflab.optics.camera import Camera, MicrolensArray, nearest_neighbour
from flflab.optics.focus import sharp_vergence
from flflab.optics.smms import camera_smms
from flflab.targets import Target
from flflab.units import Dimension, parse_quantity
from sim.clock import Clock
from sim.drift import drifts
from sim.motion import Motion, rest

WHEEL = ("four-dot", "bars", "white", "black", "chirp", "edge", "texture", "bars-y")
REMEMBERED = 64  # motions of a carriage
NANOMETRE = 1e-6  # mm: states of the world closer than this are one and the same
Truths = Mapping[str, str | float]


def keyed(*parts: object) -> np.random.Generator:
    """A generator that depends on these parts and on nothing else."""
    digest = hashlib.blake2b(
        "|".join(repr(part) for part in parts).encode(), digest_size=16
    ).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))


@dataclass(frozen=True)
class TrueAxis:
    """How an axis really moves its element: place = zero + sign (1 + scale) travel, mm or rad;
    ``start`` is its first travel.
    """

    moves: str
    sign: int
    zero: float
    scale: float
    start: float

    def world(self, travel: float) -> float:
        """World z of the element, mm, or the angle of the array, rad."""
        return self.zero + self.sign * (1 + self.scale) * travel


def wheel_targets(bench: Bench) -> dict[str, Target]:
    """What is on the target wheel: every kind as the bench file has it in ``simulated.targets``, or
    by its defaults; bars along y are by theirs the chart of bars.

    Raises:
        InputError: a kind the wheel does not have, or a target that is described wrongly.
    """
    given = bench.description.simulated.targets
    for kind in given:
        if kind not in WHEEL:
            raise InputError(
                f"{bench.where('simulated', 'targets', kind)}: there is no {kind!r} on the wheel;"
                f" allowed: {', '.join(WHEEL)}"
            )
    source, folder = f"{bench.file}: simulated.targets", bench.file.parent
    charts = {kind: given.get(kind.removesuffix("-y"), {}) | given.get(kind, {}) for kind in WHEEL}
    return {kind: target_from(charts[kind] | {"kind": kind}, source, folder) for kind in WHEEL}


class Carriage:
    """Something that moves along one coordinate; remembers its last motions, for exposures that
    began before them.
    """

    def __init__(self, clock: Clock, start: float) -> None:
        """Stand at ``start``."""
        self.clock = clock
        self._begun = 0
        self._motions: tuple[tuple[float, Motion], ...] = ((-np.inf, rest(start)),)

    @property
    def motion(self) -> Motion:
        """The present motion."""
        return self._motions[-1][1]

    @motion.setter
    def motion(self, motion: Motion) -> None:
        self._motions = (*self._motions[-REMEMBERED:], (self.clock.now(), motion))
        self._begun += 1

    def begun(self, instant: float) -> int:
        """How many motions had begun at an instant, now or lately."""
        return self._begun - sum(since > instant for since, _ in self._motions)

    def at(self, instant: float) -> float:
        """Where it was at an instant, now or lately."""
        known = next(
            (motion for since, motion in reversed(self._motions) if since <= instant),
            self._motions[0][1],
        )
        return known.at(instant)[0]

    def moving(self, instant: float) -> bool:
        """Whether it moves."""
        return self.motion.moving(instant)


@dataclass(frozen=True)
class Scene:
    """What stands before the camera at an instant; ``camera`` and ``distance`` None where the parts
    are in no possible order.
    """

    camera: Camera | None
    distance: float | None
    target: Target
    state: tuple[object, ...]


class World:
    """The truth; every access under ``lock``."""

    def __init__(self, bench: Bench, clock: Clock) -> None:
        """Set up the bench as it was left: everything where the camera file puts it, as far as the
        limits allow.

        Raises:
            InputError: a planted truth has no meaning here.
        """
        simulated = bench.description.simulated
        self.bench = bench
        self.lock = threading.RLock()
        self.clock = clock
        self.seed = simulated.seed
        check_truths(bench)
        self._drift, self._began = drifts(bench), clock.now()
        self.optics = true_optics(bench, simulated.truths)
        left_at = {
            "main_lens.z": 0.0,
            "array.z": bench.optics.array.distance,
            "sensor.z": bench.optics.sensor.distance,
            "target.z": -sharp_distance(bench.optics),
            **_turns(bench.optics.array),
        }
        fixed = {
            moved: place.at
            + float(keyed(simulated.seed, "fixed", moved).normal()) * place.uncertainty
            for moved, place in bench.description.fixed.stated().items()
        }
        self._fixed = left_at | _turns(self.optics.array) | fixed
        doubt = bench.description.optics_uncertainty
        set_by = {
            "array.pitch": doubt.array_tilt,
            "array.yaw": doubt.array_tilt,
            "array.roll": doubt.array_roll,
        }
        self.axes = {
            name: true_axis(
                name,
                axis,
                left_at[axis.moves],
                simulated.seed,
                simulated.truths,
                set_by.get(axis.moves, 0.0),
            )
            for name, axis in bench.description.axes.items()
        }
        self.carriages = {name: Carriage(clock, axis.start) for name, axis in self.axes.items()}
        self.iris = Carriage(clock, bench.optics.main_lens.f_number)
        self.wheel = Carriage(clock, WHEEL.index("white"))
        drawn = (
            keyed(self.seed, "optics", "f_number").normal()
            * bench.description.optics_uncertainty.f_number
        )
        again, truths = bench.description.repeatability, simulated.truths
        self._stage_repeats = _planted(truths, "repeatability.stages", "length", again.stages)
        self._iris_repeats = _planted(truths, "repeatability.f_number", "ratio", again.f_number)
        self._lamp_unsure = bench.description.light_uncertainty
        self._iris_scale = _planted(truths, "iris.scale", "ratio", float(drawn))
        self.targets = wheel_targets(bench)
        self._envelopes = bench.description.envelopes

    def elements(self, instant: float) -> dict[str, float]:
        """True world z of every element, mm."""
        return {
            moved: place
            for moved, place in self._places(instant).items()
            if moved in get_args(Element)
        }

    def angles(self, instant: float) -> dict[str, float]:
        """True pitch, yaw and roll of the array, rad, as ``array.pitch`` and so on."""
        return {
            moved: place
            for moved, place in self._places(instant).items()
            if moved in get_args(Turn)
        }

    def gap(self, instant: float) -> float:
        """True distance from the array to the sensor, metal and glass counted, mm; negative where
        they have met.
        """
        places, array, sensor = self._places(instant), self._envelopes.array, self._envelopes.sensor
        reach = plate_reach(self.optics.array, places, array.rear, array.radius)
        return places["sensor.z"] - sensor.front - places["array.z"] - reach

    def lens_gap(self, instant: float) -> float:
        """True distance from the main lens to the array as ``gap`` has it of array and sensor,
        mm.
        """
        places, array, lens = (
            self._places(instant),
            self._envelopes.array,
            self._envelopes.main_lens,
        )
        mirrored = places | {turn: -places[turn] for turn in ("array.yaw", "array.pitch")}
        reach = plate_reach(self.optics.array, mirrored, array.front, array.radius)
        return places["array.z"] - reach - places["main_lens.z"] - lens.rear

    def _places(self, instant: float) -> dict[str, float]:
        with self.lock:
            moved = {
                axis.moves: axis.world(self.carriages[name].at(instant))
                + self._drift.get(name, 0.0) * (instant - self._began)
                + (axis.moves in get_args(Element))
                * self._stage_repeats
                * self._anew(name, instant)
                for name, axis in self.axes.items()
            }
        return self._fixed | moved

    def _anew(self, name: str, instant: float) -> float:
        """A normal number for every motion of a stage or the iris."""
        carriage = self.carriages.get(name, self.iris)
        return float(keyed(self.seed, "approach", name, carriage.begun(instant)).normal())

    def f_number(self, instant: float) -> float:
        """True f-number."""
        with self.lock:
            off = self._iris_scale + self._iris_repeats * self._anew("iris", instant)
            return self.iris.at(instant) * (1 + off)

    def lamp(self, scene: "Scene") -> float:
        """The light over what it is stated to be: another in every setting, whatever is shown."""
        return 1 + float(keyed(self.seed, "lamp", scene.state[:-1]).normal()) * self._lamp_unsure

    def target_name(self, instant: float) -> str:
        """What the wheel shows; empty between two places."""
        with self.lock:
            place = self.wheel.at(instant)
        return WHEEL[round(place)] if place == round(place) else ""

    def scene(self, instant: float) -> Scene:
        """What the camera sees at an instant."""
        places, f_number, name = (
            self._places(instant),
            self.f_number(instant),
            self.target_name(instant),
        )
        lens = places["main_lens.z"]
        state = (*(round(value / NANOMETRE) for value in places.values()), round(f_number, 6), name)
        target = self.targets[name or "black"]
        tilt = (math.tan(places["array.yaw"]), math.tan(places["array.pitch"]))
        distance = lens - places["target.z"]
        try:
            camera = replace(
                self.optics,
                main_lens=replace(self.optics.main_lens, f_number=f_number),
                array=replace(
                    self.optics.array,
                    distance=places["array.z"] - lens,
                    tilt=tilt,
                    roll=places["array.roll"],
                ),
                sensor=replace(self.optics.sensor, distance=places["sensor.z"] - lens),
            )
        except InputError:
            return Scene(None, None, target, state)
        return (
            Scene(camera, distance, target, state)
            if distance > 0
            else Scene(None, None, target, state)
        )


def _turns(array: MicrolensArray) -> dict[str, float]:
    return {
        "array.pitch": math.atan(array.tilt[1]),
        "array.yaw": math.atan(array.tilt[0]),
        "array.roll": array.roll,
    }


def plate_reach(
    array: MicrolensArray, angles: Mapping[str, float], thickness: float = 0.0, radius: float = 0.0
) -> float:
    """How far the foremost corner of the turned array, or the rim of its holder, stands out of the
    plane through its middle towards the sensor, mm.

    The array is a stiff plate that is rolled about its middle, shifted by its offset and then
    tilted about where the main axis meets it; its holder is round about that point.
    """
    x, y = (
        (count * pitch + array.aperture) / 2
        for count, pitch in zip(array.count, array.pitch, strict=True)
    )
    cos, sin = math.cos(angles["array.roll"]), math.sin(angles["array.roll"])
    slope_x, slope_y = math.tan(angles["array.yaw"]), math.tan(angles["array.pitch"])
    steepness = math.sqrt(1 + slope_x**2 + slope_y**2)
    rolled = max(
        slope_x * (cos * a - sin * b) + slope_y * (sin * a + cos * b)
        for a in (-x, x)
        for b in (-y, y)
    )
    corner = rolled + slope_x * array.offset[0] + slope_y * array.offset[1]
    return (max(corner, radius * math.hypot(slope_x, slope_y)) + thickness) / steepness


def true_axis(
    name: str, axis: AxisDescription, left_at: float, seed: int, truths: Truths, set_by: float = 0.0
) -> TrueAxis:
    """Draw an axis's hidden errors, unless they are planted.

    Args:
        name: the axis's name in the bench file.
        axis: its description.
        left_at: place in mm or rad where its element was left.
        seed: the recorded seed.
        truths: planted truths ``<axis>.zero`` (error of the zero), ``<axis>.scale`` (error of the
            scale), ``<axis>.start`` (reading).
        set_by: how well the array was set upon an axis that turns it, rad, beside the axis's own
            zero.
    """
    dimension = axis.coordinate.dimension
    zero, scale = keyed(seed, "axis", name).normal(size=2) * (
        math.hypot(axis.zero_uncertainty, set_by),
        axis.scale_uncertainty,
    )
    reading = axis.reading(left_at)
    if not axis.limits[0] <= reading <= axis.limits[1]:
        reading = (axis.limits[0] + axis.limits[1]) / 2
    return TrueAxis(
        moves=axis.moves,
        sign=axis.sign,
        zero=axis.zero + _planted(truths, f"{name}.zero", dimension, float(zero)),
        scale=_planted(truths, f"{name}.scale", "ratio", float(scale)),
        start=_planted(truths, f"{name}.start", dimension, reading),
    )


def true_optics(bench: Bench, truths: Truths) -> Camera:
    """The camera file's optics with hidden errors drawn from the bench file's uncertainties, and
    the planted truths about them.

    Microlenses that are drawn wider than there is room between neighbours touch: so do those
    described as touching in every second draw.
    """
    lens, array, doubt = (
        bench.optics.main_lens,
        bench.optics.array,
        bench.description.optics_uncertainty,
    )
    seed = bench.description.simulated.seed

    def factor(name: str, share: float) -> float:
        return 1 + float(keyed(seed, "optics", name).normal()) * share

    def angle(name: str, described: float, uncertainty: float) -> float:
        drawn = float(keyed(seed, "optics", f"array.{name}").normal()) * uncertainty
        return _planted(truths, f"microlens_array.{name}", "angle", described + drawn)

    focal, pitch = (
        factor("focal", doubt.microlens_focal_length),
        factor("pitch", math.hypot(doubt.pitch, bench.description.workmanship.scale)),
    )
    first = _planted(
        truths, "microlens_array.focal_length", "length", array.focal_lengths[0] * focal
    )
    lens_focal = lens.focal_length * factor("lens", doubt.main_lens_focal_length)
    array = replace(array, pitch=(array.pitch[0] * pitch, array.pitch[1] * pitch))
    aperture = min(
        array.aperture * factor("aperture", doubt.microlens_aperture), nearest_neighbour(array)
    )
    return replace(
        bench.optics,
        main_lens=replace(
            lens, focal_length=_planted(truths, "main_lens.focal_length", "length", lens_focal)
        ),
        array=replace(
            array,
            focal_lengths=(first, *(one * focal for one in array.focal_lengths[1:])),
            aperture=_planted(truths, "microlens_array.aperture", "length", aperture),
            roll=angle("roll", array.roll, doubt.array_roll),
            tilt=tuple(
                math.tan(angle(turn, math.atan(slope), doubt.array_tilt))
                for turn, slope in zip(("yaw", "pitch"), array.tilt, strict=True)
            ),
        ),
    )


def check_truths(bench: Bench) -> None:
    """Refuse planted truths that nothing here would heed, or that are no quantities.

    Raises:
        InputError: with file, line, the truth and what is allowed.
    """
    allowed: dict[str, Dimension] = {}
    for name, axis in bench.description.axes.items():
        allowed |= {
            f"{name}.zero": axis.coordinate.dimension,
            f"{name}.scale": "ratio",
            f"{name}.start": axis.coordinate.dimension,
        }
    allowed |= {"repeatability.stages": "length", "repeatability.f_number": "ratio"}
    allowed |= {"iris.scale": "ratio", "main_lens.focal_length": "length"}
    allowed |= {"microlens_array.focal_length": "length", "microlens_array.aperture": "length"}
    allowed |= {f"microlens_array.{turn}": "angle" for turn in ("roll", "yaw", "pitch")}
    for name, given in bench.description.simulated.truths.items():
        where = bench.where("simulated", "truths", name)
        if name not in allowed:
            raise InputError(f"{where}: there is no such truth; allowed here: {', '.join(allowed)}")
        try:
            parse_quantity(given, allowed[name])
        except InputError as error:
            raise InputError(f"{where}: {error}") from error


def sharp_distance(optics: Camera) -> float:
    """Distance in mm of what is sharp behind the array's middle; 500 mm where nothing real is."""
    systems = camera_smms(optics)
    vergence = float(sharp_vergence(systems)[len(systems.gap) // 2])
    return 1 / vergence if np.isfinite(vergence) and vergence > 0 else 500.0


def _planted(truths: Truths, name: str, dimension: Dimension, otherwise: float) -> float:
    return parse_quantity(truths[name], dimension) if name in truths else otherwise

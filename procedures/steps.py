"""What a procedure would do, as data: steps that can be printed, timed and checked before anything connects or moves."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from drivers.interlocks import gap_rule, order_moves
from flflab.bench import ANGLE, LENGTH, AxisDescription, Bench, Element, Turn
from flflab.errors import InputError, InterlockError, LimitError
from flflab.study import Configuration, Study

WHITE, BLACK = "white", "black"
BY_HAND_S = 30.0  # a person turns an iris or swaps a target
BY_MOTOR_S = 2.0
FRAME_S = 0.5  # exposure, readout and transfer, before the exposure is known
TRIALS_EXPECTED = 2
NOT_MOVED = 1e-9  # mm


@dataclass(frozen=True)
class Home:
    """Axes look for their reference, all at once."""

    axes: tuple[str, ...]

    def __str__(self) -> str:
        return f"home {', '.join(self.axes)}"


@dataclass(frozen=True)
class SetIris:
    """The iris goes to an f-number."""

    f_number: float

    def __str__(self) -> str:
        return f"iris to f/{self.f_number:g}"


@dataclass(frozen=True)
class ShowTarget:
    """A target comes before the camera."""

    kind: str

    def __str__(self) -> str:
        return f"show the {self.kind} target"


@dataclass(frozen=True)
class Move:
    """Axes go to readings in mm, rad for those that turn, one group after the other, those of a group at once."""

    configuration: int
    groups: tuple[Mapping[str, float], ...]
    turning: frozenset[str] = frozenset()

    def __str__(self) -> str:
        def show(axis: str, reading: float) -> str:
            return f"{axis} to {(ANGLE if axis in self.turning else LENGTH).show(reading, '.4f')}"

        places = ", then ".join(", ".join(show(*item) for item in group.items()) for group in self.groups)
        return f"configuration {self.configuration}: {places}"


@dataclass(frozen=True)
class Expose:
    """The exposure of a configuration is found on the white target; the frame that fits is recorded."""

    configuration: Configuration

    @property
    def key(self) -> str:
        """The recorded point."""
        return f"c{self.configuration.index}/{WHITE}/0"

    def __str__(self) -> str:
        return f"{self.key}: find the exposure and take a frame"


@dataclass(frozen=True)
class Capture:
    """A frame of a target at its configuration's exposure."""

    configuration: Configuration
    target: str
    repeat: int

    @property
    def key(self) -> str:
        """The recorded point."""
        return f"c{self.configuration.index}/{self.target}/{self.repeat}"

    def __str__(self) -> str:
        return f"{self.key}: take a frame"


@dataclass(frozen=True)
class CaptureDark:
    """Dark frames, so many for every exposure that the run used."""

    frames: int

    def __str__(self) -> str:
        return "take dark frames for every exposure used"


Step: TypeAlias = Home | SetIris | ShowTarget | Move | Expose | Capture | CaptureDark
Readings = Mapping[str, float]


def home_steps(bench: Bench) -> tuple[Home, ...]:
    """Array and sensor first, what homes away from its neighbour before what homes towards it; the other axes then."""
    axes = bench.description.axes
    away = {"array.z": "-z", "sensor.z": "+z"}
    retreating = tuple(name for name, axis in axes.items() if away.get(axis.moves) == axis.home_towards)
    approaching = tuple(name for name, axis in axes.items() if axis.moves in away and name not in retreating)
    others = tuple(name for name, axis in axes.items() if axis.moves not in away)
    return tuple(Home(group) for group in (retreating, *((name,) for name in approaching), others) if group)


def homed_readings(bench: Bench) -> dict[str, float]:
    """Where every axis stands after homing: at the end of its limits towards which it homes, one that turns the array at 0."""
    axes = bench.description.axes
    return {name: 0.0 if axis.coordinate.unit == "rad" else axis.limits[1 if axis.homes_up else 0] for name, axis in axes.items()}


def sweep_steps(study: Study, bench: Bench, start: Readings) -> tuple[Step, ...]:
    """A study's points, ordered so that a person acts as seldom as possible: by iris, then target, then configuration.

    White comes first, it gives the exposures; the configurations are passed to and fro; dark frames come last, once for all.

    Args:
        study: what to take.
        bench: on what.
        start: where every axis stands before, readings in mm.

    Raises:
        LimitError: a configuration is out of an axis's reach.
        InterlockError: array and sensor would come too near to each other.
        InputError: a configuration needs an element moved that no axis moves.
    """
    steps: list[Step] = []
    now = dict(start)
    frames = study.description.exposure.frames
    by_iris = itertools.groupby(sorted(study.configurations, key=lambda one: one.f_number), key=lambda one: one.f_number)
    for f_number, group in by_iris:
        steps.append(SetIris(f_number))
        configurations = sorted(group, key=lambda one: (one.distance, one.sensor))
        for target in (WHITE, study.dots.kind, study.bars.kind):
            steps.append(ShowTarget(target))
            for configuration in configurations:
                move = move_step(configuration, bench, now)
                if move.groups:
                    steps.append(move)
                    now.update(item for together in move.groups for item in together.items())
                steps += _frames(configuration, target, frames)
            configurations.reverse()
    return (*steps, ShowTarget(BLACK), CaptureDark(frames))


def steps(study: Study, bench: Bench) -> tuple[Step, ...]:
    """Everything ``validate`` does on a bench; errors as ``sweep_steps``."""
    return (*home_steps(bench), *sweep_steps(study, bench, homed_readings(bench)))


def most_frames(steps: tuple[Step, ...]) -> int:
    """How many frames the steps record at most: every configuration may need an exposure of its own, so a dark frame too."""
    exposures = sum(isinstance(step, Expose) for step in steps)
    taken = exposures + sum(isinstance(step, Capture) for step in steps)
    return taken + sum(step.frames * exposures for step in steps if isinstance(step, CaptureDark))


def durations(steps: tuple[Step, ...], bench: Bench) -> tuple[float, ...]:
    """How long each step takes on the real bench, s, as far as speeds and habits tell."""
    description = bench.description
    now = {name: axis.limits[0] for name, axis in description.axes.items()}
    exposures = sum(isinstance(step, Expose) for step in steps)

    def takes(step: Step) -> float:
        match step:
            case Home(axes):
                now.update({name: homed_readings(bench)[name] for name in axes})
                homing = (description.axes[name] for name in axes)
                return max((axis.limits[1] - axis.limits[0]) / axis.speed for axis in homing)
            case SetIris():
                return BY_HAND_S if description.iris.driver == "manual" else BY_MOTOR_S
            case ShowTarget():
                return BY_HAND_S if description.target.driver == "manual" else BY_MOTOR_S
            case Move(_, groups):
                total = sum(max(abs(mm - now[name]) / description.axes[name].speed for name, mm in group.items()) for group in groups)
                now.update(item for group in groups for item in group.items())
                return total
            case Expose():
                return TRIALS_EXPECTED * FRAME_S
            case Capture():
                return FRAME_S
            case CaptureDark(frames):
                return FRAME_S * frames * exposures

    return tuple(takes(step) for step in steps)


def _frames(configuration: Configuration, target: str, frames: int) -> Iterator[Step]:
    if target == WHITE:
        yield Expose(configuration)
    yield from (Capture(configuration, target, repeat) for repeat in range(1 if target == WHITE else 0, frames))


def move_step(configuration: Configuration, bench: Bench, now: Readings) -> Move:
    """The axes that have to move for a configuration from these readings, in an order in which the gap holds; errors as ``sweep_steps``."""
    worlds: dict[Element, float] = {
        "main_lens.z": 0.0, "array.z": configuration.array, "sensor.z": configuration.sensor, "target.z": -configuration.distance,
    }  # fmt: skip
    wanted: dict[str, float] = {}
    for turn, angle in _angles(bench).items():
        if (turning := bench.description.axis_of(turn)) is not None:
            name, axis = turning
            reading = axis.reading(angle)
            _require_within(configuration, name, axis, reading)
            if abs(reading - now[name]) > NOT_MOVED:
                wanted[name] = reading
    for element, world in worlds.items():
        found = bench.description.axis_of(element)
        if found is None:
            _require_standing_there(configuration, element, world, bench)
            continue
        name, axis = found
        reading = axis.reading(world)
        _require_within(configuration, name, axis, reading)
        if abs(reading - now[name]) > NOT_MOVED:
            wanted[name] = reading
    rule = gap_rule(bench, {name: axis.limits for name, axis in bench.description.axes.items()})
    free = {name: mm for name, mm in wanted.items() if rule is None or name not in rule.movers}
    bound = {name: mm for name, mm in wanted.items() if name not in free}
    try:
        order = order_moves(rule, {name: (mm, mm) for name, mm in now.items()}, bound)
    except InterlockError as error:
        raise InterlockError(f"configuration {configuration.index}: {error}") from error
    groups = tuple(group for group in (free, *({name: bound[name]} for name in order)) if group)
    return Move(configuration.index, groups, frozenset(name for name in wanted if bench.description.axes[name].coordinate is ANGLE))


def _angles(bench: Bench) -> dict[Turn, float]:
    """How the array is to be turned, rad: as the camera file has it."""
    array = bench.optics.array
    return {"array.pitch": math.atan(array.tilt[1]), "array.yaw": math.atan(array.tilt[0]), "array.roll": array.roll}


def standing(bench: Bench) -> dict[Element, float]:
    """World z in mm of what no axis moves: as the camera file has it, the main lens at 0; of the target nobody knows."""
    places: dict[Element, float] = {"main_lens.z": 0.0, "array.z": bench.optics.array.distance, "sensor.z": bench.optics.sensor.distance}
    return {element: world for element, world in places.items() if bench.description.axis_of(element) is None}


def _require_standing_there(configuration: Configuration, element: Element, world: float, bench: Bench) -> None:
    place = standing(bench).get(element)
    if place is None or not math.isclose(place, world, abs_tol=1e-6):
        where = "nobody knows where it stands" if place is None else f"it stands at {place:g} mm"
        raise InputError(
            f"configuration {configuration.index} needs {element} at {world:g} mm, but {where} and no axis of {bench.file} moves it; "
            "give the axis or change the study"
        )


def _require_within(configuration: Configuration, name: str, axis: AxisDescription, reading: float) -> None:
    low, high = axis.limits
    if not low <= reading <= high:
        raise LimitError(
            f"configuration {configuration.index}: {name} would have to go to {axis.coordinate.show(reading, '.4f')}, outside its limits, "
            f"{axis.coordinate.show(low, 'g')} to {axis.coordinate.show(high, 'g')}; nothing moved, change the study or the bench"
        )

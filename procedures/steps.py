# longer than 450 lines because the steps of a study and the ways between them are one plan
"""What a procedure would do, as data: steps that can be printed, timed and checked before anything
connects or moves.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias, get_args

from drivers.interlocks import Gap, gap_rules, goes_any_time, homing_groups, order_moves
from flflab.bench import ANGLE, LENGTH, AxisDescription, Bench, Element, Turn
from flflab.errors import InputError, InterlockError, LimitError
from flflab.study import Configuration, Study

WHITE, BLACK = "white", "black"
NOT_MOVED = 1e-9  # mm
ASIDE = 0.2  # mm, from which a setting is approached anew


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
    """Axes go to readings in mm, rad for those that turn, one group after the other, those of a
    group at once.
    """

    configuration: int
    groups: tuple[Mapping[str, float], ...]
    turning: frozenset[str] = frozenset()

    @property
    def axes(self) -> frozenset[str]:
        """The axes that move."""
        return frozenset(name for group in self.groups for name in group)

    def __str__(self) -> str:
        def show(axis: str, reading: float) -> str:
            return f"{axis} to {(ANGLE if axis in self.turning else LENGTH).show(reading, '.4f')}"

        places = ", then ".join(
            ", ".join(show(*item) for item in group.items()) for group in self.groups
        )
        return f"configuration {self.configuration}: {places}"


@dataclass(frozen=True)
class Expose:
    """The exposure of a configuration is found on the white target; the frame that fits is
    recorded.
    """

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
class CaptureUntil:
    """Frames of a target until the MTF measured in their mean is as sure as was asked for; no fewer
    than least, no more than most.
    """

    configuration: Configuration
    target: str
    mtf_standard_uncertainty: float
    least: int
    most: int

    def key(self, repeat: int) -> str:
        """The recorded point of a frame."""
        return f"c{self.configuration.index}/{self.target}/{repeat}"

    def __str__(self) -> str:
        return (
            f"c{self.configuration.index}/{self.target}: take frames until the MTF is known to"
            f" {self.mtf_standard_uncertainty:g}, at most {self.most}"
        )


@dataclass(frozen=True)
class CaptureDark:
    """Dark frames, so many for every exposure that the run used."""

    frames: int

    def key(self, exposure_s: float, repeat: int) -> str:
        """The recorded point of a frame."""
        return f"dark/{exposure_s:.6g}s/{repeat}"

    def __str__(self) -> str:
        return "take dark frames for every exposure used"


Step: TypeAlias = Home | SetIris | ShowTarget | Move | Expose | Capture | CaptureUntil | CaptureDark
Readings = Mapping[str, float]


def home_steps(bench: Bench) -> tuple[Home, ...]:
    """What shifts main lens, array and sensor first, each while its neighbours are out of its way;
    the other axes then.
    """
    return tuple(Home(group) for group in homing_groups(bench))


def homed_readings(bench: Bench) -> dict[str, float]:
    """Where every axis is taken to stand after homing: the end of its limits towards which it
    homes, 0 of one that turns the array.
    """
    axes = bench.description.axes
    return {
        name: 0.0 if axis.coordinate.unit == "rad" else axis.limits[1 if axis.homes_up else 0]
        for name, axis in axes.items()
    }


def unsure_when_homed(bench: Bench) -> frozenset[str]:
    """Axes that may stand elsewhere after homing: a reference reads 0, limits that begin elsewhere
    do not say where it lies.
    """
    return frozenset(name for name, reading in homed_readings(bench).items() if reading != 0)


def sweep_steps(
    study: Study, bench: Bench, start: Readings, unsure: frozenset[str] = frozenset()
) -> tuple[Step, ...]:
    """A study's points, ordered so that a person acts as seldom as possible: by iris, then target,
    then configuration.

    White comes first, it gives the exposures; the configurations are passed to and fro; a study
    that repeats begins again with the first iris; dark frames come last, once for all.

    Args:
        study: what to take.
        bench: on what.
        start: where every axis stands before, readings in mm.
        unsure: axes that may stand elsewhere.

    Raises:
        LimitError: a configuration is out of an axis's reach.
        InterlockError: array and sensor would come too near to each other.
        InputError: a configuration needs an element moved that no axis moves, or the study asks
            for an accuracy below the measurement's floor.
    """
    _require_above_floor(study, bench)
    steps: list[Step] = []
    now = dict(start)
    by_iris = itertools.groupby(
        sorted(study.configurations, key=_repetition_and_iris), key=_repetition_and_iris
    )
    for (_, f_number), group in by_iris:
        steps.append(SetIris(f_number))
        configurations = sorted(group, key=_place)
        for target in (WHITE, *study.shown):
            steps.append(ShowTarget(target))
            for configuration in configurations:
                ways: list[Move] = []
                if study.description.reapproach:
                    ways.append(aside_step(configuration, bench, now))
                    unsure = unsure - ways[0].axes
                ways.append(move_step(configuration, bench, _after(now, ways), unsure))
                unsure = frozenset[str]()  # it moves them all
                now = _after(now, ways)
                steps += (move for move in ways if move.groups)
                steps += _frames(study, configuration, target)
            configurations.reverse()
    return (*steps, ShowTarget(BLACK), CaptureDark(study.description.exposure.frames))


def _after(now: Readings, moves: Iterable[Move]) -> dict[str, float]:
    return dict(now) | {
        name: mm for move in moves for group in move.groups for name, mm in group.items()
    }


def _repetition_and_iris(configuration: Configuration) -> tuple[int, float]:
    return configuration.repetition, configuration.f_number


def steps(study: Study, bench: Bench) -> tuple[Step, ...]:
    """Everything ``validate`` does on a bench; errors as ``sweep_steps``."""
    return (
        *home_steps(bench),
        *sweep_steps(study, bench, homed_readings(bench), unsure_when_homed(bench)),
    )


def most_frames(steps: tuple[Step, ...]) -> int:
    """How many frames the steps record at most: every configuration may need an exposure of its
    own, so a dark frame too.
    """
    exposures = sum(isinstance(step, Expose) for step in steps)

    def most(step: Step) -> int:
        match step:
            case Expose() | Capture():
                return 1
            case CaptureUntil():
                return step.most
            case CaptureDark(frames):
                return frames * exposures
            case _:
                return 0

    return sum(most(step) for step in steps)


def _frames(study: Study, configuration: Configuration, target: str) -> Iterator[Step]:
    exposure, wanted = study.description.exposure, study.description.mtf_standard_uncertainty
    if target == study.bars.kind and wanted is not None:
        yield CaptureUntil(configuration, target, wanted, exposure.frames, exposure.most_frames)
        return
    if target == WHITE:
        yield Expose(configuration)
    yield from (
        Capture(configuration, target, repeat)
        for repeat in range(1 if target == WHITE else 0, exposure.frames)
    )


def aside_step(configuration: Configuration, bench: Bench, now: Readings) -> Move:
    """What shifts elements goes beside a configuration, to the side from which it homes, so that
    the configuration is approached anew and from there; errors as ``sweep_steps``.
    """
    wanted: dict[str, float] = {}
    for element, world in worlds_of(configuration).items():
        if (found := bench.description.axis_of(element)) is not None:
            name, axis = found
            reading, (low, high) = axis.reading(world), axis.limits
            side = ASIDE if axis.homes_up else -ASIDE
            beside = reading + side if low <= reading + side <= high else reading - side
            wanted[name] = min(max(beside, low), high)
    return _ordered(configuration, bench, now, wanted)


def worlds_of(configuration: Configuration) -> dict[Element, float]:
    """World z of every element in a configuration, mm."""
    lens = configuration.main_lens
    return {
        "main_lens.z": lens, "array.z": lens + configuration.array,
        "sensor.z": lens + configuration.sensor,
        "target.z": lens - configuration.distance,
    }  # fmt: skip


def move_step(
    configuration: Configuration, bench: Bench, now: Readings, unsure: frozenset[str] = frozenset()
) -> Move:
    """The axes that have to move for a configuration from these readings, in an order in which the
    gap holds; errors as ``sweep_steps``.

    Those that may stand elsewhere, ``unsure``, are sent also to where they are taken to stand.
    """
    wanted: dict[str, float] = {}
    for turn, angle in _angles(configuration, bench).items():
        if (turning := bench.description.axis_of(turn)) is not None:
            name, axis = turning
            reading = axis.reading(angle)
            _require_within(configuration, name, axis, reading)
            if name in unsure or abs(reading - now[name]) > NOT_MOVED:
                wanted[name] = reading
        elif not math.isclose(angle, (stands := _angles(None, bench)[turn]), abs_tol=1e-9):
            raise InputError(
                f"configuration {configuration.index} needs {turn} at {ANGLE.show(angle, 'g')}, but"
                f" no axis of {bench.file} turns it and the camera file has"
                f" {ANGLE.show(stands, 'g')}; give the axis or change the study"
            )
    for element, world in worlds_of(configuration).items():
        found = bench.description.axis_of(element)
        if found is None:
            _require_standing_there(configuration, element, world, bench)
            continue
        name, axis = found
        reading = axis.reading(world)
        _require_within(configuration, name, axis, reading)
        if name in unsure or abs(reading - now[name]) > NOT_MOVED:
            wanted[name] = reading
    return _ordered(configuration, bench, now, wanted)


def _ordered(configuration: Configuration, bench: Bench, now: Readings, wanted: Readings) -> Move:
    """The way to readings in an order in which the gaps hold."""
    gaps = gap_rules(bench, {name: axis.limits for name, axis in bench.description.axes.items()})
    try:
        groups = in_order(gaps, {name: (mm, mm) for name, mm in now.items()}, wanted)
    except InterlockError as error:
        raise InterlockError(f"configuration {configuration.index}: {error}") from error
    return Move(
        configuration.index,
        groups,
        frozenset(name for name in wanted if bench.description.axes[name].coordinate is ANGLE),
    )


def in_order(
    gaps: Sequence[Gap], now: Mapping[str, tuple[float, float] | None], wanted: Readings
) -> tuple[dict[str, float], ...]:
    """Readings in groups, one after the other, in which the gaps hold on the way: first, together,
    what keeps them wherever the others are, then the rest one by one.

    Args:
        gaps: the rules of the bench.
        now: between which readings every axis stands; None: not known. What is to move rests at
            one.
        wanted: where some are to go.

    Raises:
        InterlockError: there is no such order.
    """
    rests = {name: interval[0] for name in wanted if (interval := now[name]) is not None}
    free = {
        name: wanted[name] for name in rests if goes_any_time(gaps, name, rests[name], wanted[name])
    }
    bound = {name: reading for name, reading in wanted.items() if name not in free}
    then = {name: (reading, reading) for name, reading in free.items()}
    order = order_moves(gaps, {**now, **then}, bound)
    return tuple(group for group in (free, *({name: bound[name]} for name in order)) if group)


def _angles(configuration: Configuration | None, bench: Bench) -> dict[Turn, float]:
    """How the array is to be turned, rad: as the configuration says, else as the camera file has
    it.
    """
    array = bench.optics.array
    yaw, pitch = (math.atan(slope) for slope in array.tilt)
    described: dict[Turn, float] = {
        "array.pitch": pitch,
        "array.yaw": yaw,
        "array.roll": array.roll,
    }
    if configuration is None:
        return described
    asked: dict[Turn, float | None] = {
        "array.pitch": configuration.pitch, "array.yaw": configuration.yaw,
        "array.roll": configuration.roll,
    }  # fmt: skip
    return {
        turn: angle if (given := asked[turn]) is None else given
        for turn, angle in described.items()
    }


def _place(configuration: Configuration) -> tuple[float, ...]:
    """By what configurations are put in order: angles, which are slow to turn, first."""
    turned = (
        angle or 0.0 for angle in (configuration.roll, configuration.yaw, configuration.pitch)
    )
    return (
        *turned,
        configuration.main_lens,
        configuration.array,
        configuration.distance,
        configuration.sensor,
    )


def standing(bench: Bench) -> dict[Element, float]:
    """World z in mm of what no axis moves: as the bench file states it, else as the camera file
    has it, the main lens at 0; of the target nobody knows.
    """
    places: dict[str, float] = {
        "main_lens.z": 0.0,
        "array.z": bench.optics.array.distance,
        "sensor.z": bench.optics.sensor.distance,
        **{moved: place.at for moved, place in bench.description.fixed.stated().items()},
    }
    return {
        element: places[element]
        for element in get_args(Element)
        if element in places and bench.description.axis_of(element) is None
    }


def _require_standing_there(
    configuration: Configuration, element: Element, world: float, bench: Bench
) -> None:
    place = standing(bench).get(element)
    if place is None or not math.isclose(place, world, abs_tol=1e-6):
        where = "nobody knows where it stands" if place is None else f"it stands at {place:g} mm"
        raise InputError(
            f"configuration {configuration.index} needs {element} at {world:g} mm, but {where} and"
            f" no axis of {bench.file} moves it; give the axis or change the study"
        )


def _require_above_floor(study: Study, bench: Bench) -> None:
    wanted = study.description.mtf_standard_uncertainty
    floor = bench.description.measurement_floor.contrast
    if wanted is not None and wanted <= floor:
        raise InputError(
            f"the study asks for mtf_standard_uncertainty {wanted:g}, which no number of frames"
            f" reaches: {bench.where('measurement_floor', 'contrast')} is {floor:g}; ask for more"
            " than that"
        )


def _require_within(
    configuration: Configuration, name: str, axis: AxisDescription, reading: float
) -> None:
    low, high = axis.limits
    if not low <= reading <= high:
        show = axis.coordinate.show
        nearest, farthest = sorted(axis.world(limit) for limit in axis.limits)
        raise LimitError(
            f"configuration {configuration.index}: {name} would have to go to"
            f" {show(reading, '.4f')}, outside its limits, {show(low, 'g')} to {show(high, 'g')}:"
            f" {axis.moves} at {show(axis.world(reading), 'g')} is due, it reaches"
            f" {show(nearest, 'g')} to {show(farthest, 'g')}; nothing moved. Change the study, or"
            " the axis's zero and limits in the bench file where they are wrong"
        )

"""Which axes can be simulated: for each driver what stands behind one address, made from the bench
file; one line each.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from flflab.bench import AxisDescription, Bench
from flflab.errors import InputError
from flflab.plugins import WithPlugins
from flflab.units import parse_quantity
from sim import oriental, thorlabs
from sim.faults import Fault, Faults
from sim.server import Open
from sim.stage import Stage
from sim.world import World
from sim.zaber import Chain, Device

TRAVELS = (
    25.0,
    50.0,
    75.0,
    100.0,
    150.0,
    200.0,
    300.0,
    450.0,
    600.0,
    750.0,
    1000.0,
    1500.0,
    2000.0,
    3000.0,
)  # mm, as stages are sold
MICROSTEP = "0.49609375 um"  # 200 full steps of 64 a turn, lead 6.35 mm
ACCELERATION = 400.0  # mm/s^2 at start-up
TURNS = 43 * math.tau  # rad that a counter takes either way of a stage without ends
ANGULAR_ACCELERATION = math.radians(50)  # rad/s^2
LINE_FAULTS = (
    "double",
    "late",
    "unheard",
    "lost-byte",
    "doubled-byte",
    "stranger",
    "unplug",
    "limit-switch",
)
MOTOR_FAULTS = ("silence", "drop", "garbage", "cut", "hang-up", "reset", "stall")


class Remembers(Protocol):
    """An axis that can stand, in the next program, where it stood in this one."""

    def memory(self) -> dict[str, Any]:
        """``place`` (mm, rad), ``counter``, ``homed``."""
        ...

    def recall(self, place: float, counter: int, homed: bool) -> None:
        """Stand there."""
        ...


@dataclass(frozen=True)
class Line:
    """What answers at one address: how a client's conversation begins, what each axis's address
    says beside it, what goes wrong, and which axes remember where they stood.
    """

    open_session: Open
    places: Mapping[str, Mapping[str, int]]
    faults: Mapping[str, Faults]
    stages: Mapping[str, Remembers] = field(default_factory=dict[str, Remembers])


@dataclass(frozen=True)
class SimulatedAxes:
    """The axes of one driver: how those of one line are made, which faults they can have, and
    whether axes can share a line.
    """

    line: Callable[[Bench, World, Sequence[str]], Line]
    faults: tuple[str, ...]
    share_a_line: bool = True


def faults_of(bench: Bench, device: str) -> Faults:
    """The faults that the bench file plants on a device."""
    return Faults(
        Fault(fault.fault, fault.after)
        for fault in bench.description.simulated.faults
        if fault.device == device
    )


def own_number(bench: Bench, name: str, key: str, low: int, high: int) -> int:
    """A whole number that the bench file gives an axis's driver.

    Raises:
        InputError: it is no such number.
    """
    number = (bench.description.axes[name].model_extra or {}).get(key, 1)
    if not isinstance(number, int) or not low <= number <= high:
        raise InputError(
            f"{bench.where('axes', name, key)}: {number!r}; a whole number from {low} to {high}"
            " is due"
        )
    return number


def _place(bench: Bench, name: str) -> int:
    """Which axis of its driver it is in the bench file, from 0: serial numbers count up, no two are
    the same.
    """
    axes = bench.description.axes
    return [other for other, axis in axes.items() if axis.driver == axes[name].driver].index(name)


def _zaber(bench: Bench, world: World, names: Sequence[str]) -> Line:
    numbers = {name: own_number(bench, name, "device", 1, 99) for name in names}
    _require_numbers_of_their_own(bench, numbers, "device")
    devices = [
        Device(
            number,
            _linear_stage(bench, world, name),
            faults_of(bench, name),
            100_001 + _place(bench, name),
        )
        for name, number in numbers.items()
    ]
    places = {name: {"device": number, "axis": 1} for name, number in numbers.items()}
    return Line(
        Chain(devices, world.lock).open_session,
        places,
        {name: device.faults for name, device in zip(names, devices, strict=True)},
        {name: device.stage for name, device in zip(names, devices, strict=True)},
    )


def _thorlabs(bench: Bench, world: World, names: Sequence[str]) -> Line:
    (name,) = names
    axis, count = _turning(bench, name), thorlabs.COUNT
    stage = Stage(
        world.carriages[name],
        (-TURNS, TURNS),
        count,
        min(axis.speed, math.radians(10)) / count,
        ANGULAR_ACCELERATION / count,
        home=0.0,
    )
    controller = thorlabs.Controller(
        stage, faults_of(bench, name), 27_000_001 + _place(bench, name), world.lock
    )
    return Line(
        lambda: thorlabs.ControllerSession(controller),
        {name: {}},
        {name: controller.faults},
        {name: stage},
    )


def _oriental(bench: Bench, world: World, names: Sequence[str]) -> Line:
    numbers = {name: own_number(bench, name, "device", 1, 31) for name in names}
    _require_numbers_of_their_own(bench, numbers, "device")
    drives = {number: _drive(bench, world, name) for name, number in numbers.items()}
    line = oriental.Line(drives, world.lock)
    places = {name: {"device": number} for name, number in numbers.items()}
    return Line(
        lambda: oriental.LineSession(line),
        places,
        {name: drives[number].faults for name, number in numbers.items()},
        {name: drives[number] for name, number in numbers.items()},
    )


def _drive(bench: Bench, world: World, name: str) -> oriental.Drive:
    """A drive set up as the bench file says; without wrap its table has ends a little beyond the
    limits.
    """
    axis, start = _turning(bench, name), world.axes[name].start
    keys = dict(axis.model_extra or {})
    wiring = oriental.Wiring(
        **{
            key: own_number(bench, name, key, 0, 15)
            for key in keys
            if key.endswith(("_input", "_output"))
        }
    )
    steps = keys.get("steps_per_degree", 100)
    if not isinstance(steps, int | float) or not 0 < steps < 1e6:
        raise InputError(
            f"{bench.where('axes', name, 'steps_per_degree')}: {steps!r}; a number above 0 is due"
        )
    step, wrap = math.radians(1) / steps, keys.get("wrap", False) is True
    margin = math.radians(1)
    ends = (
        (-TURNS, TURNS)
        if wrap
        else (min(axis.limits[0], 0, start) - margin, max(axis.limits[1], 0, start) + margin)
    )
    stage = Stage(
        world.carriages[name], ends, step, axis.speed / step, ANGULAR_ACCELERATION / step, home=0.0
    )
    return oriental.Drive(stage, faults_of(bench, name), wiring, 360 * steps, wrap=wrap)


def _turning(bench: Bench, name: str) -> AxisDescription:
    axis = bench.description.axes[name]
    if axis.coordinate.unit != "rad":
        raise InputError(
            f"{bench.file}: axes.{name} moves {axis.moves}; the stage simulated here turns, so let"
            " it move array.pitch"
        )
    return axis


def _require_numbers_of_their_own(bench: Bench, numbers: Mapping[str, int], key: str) -> None:
    twice = [
        name
        for place, name in enumerate(numbers)
        if numbers[name] in list(numbers.values())[:place]
    ]
    if twice:
        raise InputError(
            f"{bench.where('axes', twice[0], key)}: axes {', '.join(numbers)} share an address, so"
            f" each needs a {key} number of its own, not {', '.join(map(str, numbers.values()))}"
        )


def _linear_stage(bench: Bench, world: World, name: str) -> Stage:
    """A stage long enough for an axis's limits, and for where it was left."""
    axis = bench.description.axes[name]
    if axis.coordinate.unit != "mm":
        raise InputError(
            f"{bench.file}: axes.{name} moves {axis.moves}; the stage simulated here shifts, so let"
            " it move array.z"
        )
    ends = _travel(axis, world.axes[name].start)
    microstep = parse_quantity((axis.model_extra or {}).get("microstep", MICROSTEP), "length")
    return Stage(
        world.carriages[name],
        ends,
        microstep,
        axis.speed / microstep,
        ACCELERATION / microstep,
        home=ends[1] if axis.homes_up else ends[0],
    )


def _travel(axis: AxisDescription, start: float) -> tuple[float, float]:
    reach = max(axis.limits[1], start)
    return min(axis.limits[0], 0.0), next((travel for travel in TRAVELS if travel >= reach), reach)


AXES: Mapping[str, SimulatedAxes] = WithPlugins(
    {
        "zaber": SimulatedAxes(_zaber, (*MOTOR_FAULTS, *LINE_FAULTS, "flip", "wrong-checksum")),
        "thorlabs": SimulatedAxes(_thorlabs, (*MOTOR_FAULTS, *LINE_FAULTS), share_a_line=False),
        "oriental": SimulatedAxes(
            _oriental, (*MOTOR_FAULTS, *LINE_FAULTS, "flip", "wrong-checksum", "deaf")
        ),
    },
    "flflab.simulators",
    SimulatedAxes,
)

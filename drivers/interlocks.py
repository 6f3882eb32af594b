"""The rule across axes: array and sensor never nearer than the minimum gap. Pure functions over readings and world z, in mm.

Each of the two may be anywhere between its readings (one reading at rest, start to end under way, its whole travel when unknown),
widened by three standard uncertainties of its world position, by the following error, and for a tilted array by its corners.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from flflab.bench import AxisDescription
from flflab.errors import InterlockError
from flflab.optics.camera import MicrolensArray

Interval = tuple[float, float]
Side = Literal["array", "sensor"]
COVERAGE = 3.0
FOLLOWING_MM = 0.01


@dataclass(frozen=True)
class Neighbour:
    """Array or sensor: the axis that moves it, the axis's whole travel (readings), and how far it reaches out of its plane."""

    name: str
    axis: AxisDescription
    travel: Interval
    reach_out: float = 0.0

    def place(self, readings: Interval | None) -> Interval:
        """Between which world z it may be when its axis is between two readings, or anywhere."""
        ends = readings or self.travel
        spread = COVERAGE * max(self.axis.uncertainty(reading) for reading in ends) + FOLLOWING_MM + self.reach_out
        world = sorted(self.axis.world(reading) for reading in ends)
        return world[0] - spread, world[1] + spread


@dataclass(frozen=True)
class GapRule:
    """The array rides before the sensor, at least ``minimum_gap`` away; a float stands for one that no axis moves, at this world z."""

    minimum_gap: float
    array: Neighbour | float
    sensor: Neighbour | float

    def concerns(self, name: str) -> Side | None:
        """Which of the two an axis moves."""
        if isinstance(self.array, Neighbour) and name == self.array.name:
            return "array"
        return "sensor" if isinstance(self.sensor, Neighbour) and name == self.sensor.name else None

    def other(self, side: Side) -> Neighbour | float:
        """The neighbour of one side."""
        return self.sensor if side == "array" else self.array


def corner_reach(array: MicrolensArray) -> float:
    """How far the corners of a tilted array reach out of the plane through its middle, mm."""
    halves = ((count * pitch + array.aperture) / 2 for count, pitch in zip(array.count, array.pitch, strict=True))
    return sum(abs(math.tan(tilt)) * half for tilt, half in zip(array.tilt, halves, strict=True))


def least_gap(rule: GapRule, array: Interval | None, sensor: Interval | None) -> float:
    """The smallest gap possible between array and sensor whose axes are between these readings (None: anywhere), mm."""
    return _place(rule.sensor, sensor)[0] - _place(rule.array, array)[1]


def retreats(rule: GapRule, side: Side, start: float | None, end: float | None) -> bool:
    """Whether a motion only leads away from the neighbour; ``end`` None: it looks for its reference."""
    mover = _mover(rule, side)
    away = -1 if side == "array" else 1
    if end is None:
        return mover.axis.home_towards == ("-z" if side == "array" else "+z")
    return start is not None and away * (mover.axis.world(end) - mover.axis.world(start)) >= 0


def swept(rule: GapRule, side: Side, start: float | None, end: float | None) -> Interval:
    """The readings a motion may pass; where start or end is not known (homing), up to the end of the travel on that side."""
    mover = _mover(rule, side)
    if start is None:
        return mover.travel
    if end is None:
        towards = mover.axis.sign if mover.axis.home_towards == "+z" else -mover.axis.sign
        end = mover.travel[1] if towards > 0 else mover.travel[0]
    return min(start, end), max(start, end)


def check_motion(rule: GapRule, name: str, start: float | None, end: float | None, neighbour: Interval | None) -> None:
    """Refuse a motion that could bring array and sensor too near to each other.

    A motion that only leads away is never refused: it is what makes a gap that is too small, or not known, safe again.

    Args:
        rule: the rule.
        name: the axis that is to move; others than the rule's two are never refused.
        start: its reading, None where it has no reference.
        end: where it is to go, None where it looks for its reference.
        neighbour: the readings the neighbour's axis may be between until it rests; None: anywhere in its travel.

    Raises:
        InterlockError: the gap could become smaller than the minimum.
    """
    side = rule.concerns(name)
    if side is None or retreats(rule, side, start, end):
        return
    readings = swept(rule, side, start, end)
    gap = least_gap(rule, readings, neighbour) if side == "array" else least_gap(rule, neighbour, readings)
    if gap < rule.minimum_gap:
        other = rule.other(side)
        task = "look for its reference" if end is None else f"move to {end:.6f} mm"
        where = f"the {'sensor' if side == 'array' else 'array'}, which nothing moves"
        if isinstance(other, Neighbour):
            place = f"between {neighbour[0]:.6f} and {neighbour[1]:.6f} mm" if neighbour else "without a reference: home it first"
            where = f"{other.name}, {place}"
        raise InterlockError(
            f"{name}: asked to {task}, which could leave {gap:.3f} mm between array and sensor ({where}); "
            f"at least {rule.minimum_gap:g} mm are kept, nothing moved"
        )


def order_moves(rule: GapRule | None, readings: Mapping[str, Interval | None], targets: Mapping[str, float]) -> tuple[str, ...]:
    """In which order axes can go to their targets, one after the other, so that the gap holds on the way.

    Args:
        rule: the rule, None where there is none.
        readings: where each axis may be now; None: not known.
        targets: where each is to go; kept in this order where it does not matter.

    Returns:
        The names in an order in which no move is refused.

    Raises:
        InterlockError: there is no such order.
    """
    now, waiting, order = dict(readings), list(targets), list[str]()
    while waiting:
        refusals: list[InterlockError] = []
        for name in waiting:
            here = now.get(name)
            try:
                if rule is not None and (side := rule.concerns(name)) is not None:
                    other = rule.other(side)
                    beside = now.get(other.name) if isinstance(other, Neighbour) else None
                    check_motion(rule, name, None if here is None else _start(rule, side, here), targets[name], beside)
            except InterlockError as refusal:
                refusals.append(refusal)
                continue
            now[name] = (targets[name], targets[name])
            order.append(name)
            waiting.remove(name)
            break
        else:
            raise refusals[0]
    return tuple(order)


def _start(rule: GapRule, side: Side, readings: Interval) -> float:
    """Of where an axis may be now, the reading nearest to its neighbour."""
    nearest = max if side == "array" else min
    return nearest(readings, key=_mover(rule, side).axis.world)


def _mover(rule: GapRule, side: Side) -> Neighbour:
    mover = rule.array if side == "array" else rule.sensor
    if isinstance(mover, Neighbour):
        return mover
    raise InterlockError(f"no axis moves the {side}")


def _place(neighbour: Neighbour | float, readings: Interval | None) -> Interval:
    return neighbour.place(readings) if isinstance(neighbour, Neighbour) else (neighbour, neighbour)

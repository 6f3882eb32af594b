"""The rule across axes: array and sensor never nearer than the minimum gap. Pure functions over
readings and world places.

Each axis may be anywhere between its readings (one reading at rest, start to end under way, its
whole travel when unknown), widened by three standard uncertainties of its place and by the
following error. A tilted array reaches out of its plane as far as the circle about the main axis
does that holds its corners, however it is rolled; its size and how it was set are doubted as the
bench file says.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from flflab.bench import AxisDescription, Bench
from flflab.bench_uncertainty import OpticsUncertaintyDescription
from flflab.errors import InterlockError
from flflab.optics.camera import MicrolensArray

Interval = tuple[float, float]
Readings = Mapping[str, Interval | None]
COVERAGE = 3.0
FOLLOWING = {"mm": 0.01, "rad": 2e-4}


@dataclass(frozen=True)
class Mover:
    """An axis of the rule: it shifts array or sensor, or tilts the array.

    Args:
        name: of the axis.
        axis: as the bench file has it.
        travel: all it can reach, readings.
        set_by: standard uncertainty of how the array was set on what tilts it, rad.
    """

    name: str
    axis: AxisDescription
    travel: Interval
    set_by: float = 0.0

    @property
    def tilts(self) -> bool:
        """Whether it turns, not shifts."""
        return self.axis.coordinate.unit == "rad"

    @property
    def homed(self) -> float:
        """Its reading at the end of its travel where it looks for its reference."""
        return self.travel[1 if self.axis.homes_up else 0]

    def spread(self, readings: Interval) -> float:
        """By how much its place may be off, mm or rad."""
        stated = max(
            math.hypot(self.axis.uncertainty(reading), self.set_by) for reading in readings
        )
        return COVERAGE * stated + FOLLOWING[self.axis.coordinate.unit]

    def place(self, readings: Interval | None) -> Interval:
        """Between which world places it may be when it is between two readings, or anywhere."""
        ends = readings or self.travel
        if not all(math.isfinite(end) for end in ends):
            return -math.inf, math.inf
        low, high = sorted(self.axis.world(reading) for reading in ends)
        return low - self.spread(ends), high + self.spread(ends)


@dataclass(frozen=True)
class Plate:
    """The array as a stiff plate that tilts about where the main axis meets it.

    Args:
        radius: of the circle about that point that holds its corners, mm.
        tilt: along (x, y) what tilts it (yaw, pitch), or the steepest slope that the camera file
            may mean where nothing does.
    """

    radius: float
    tilt: tuple[Mover | float, Mover | float]

    def reach(self, readings: Readings) -> float:
        """How far it may reach out of the plane through its middle, mm: radius * sine of the
        steepest tilt.
        """
        slope = math.hypot(*(_steepest(part, readings) for part in self.tilt))
        return self.radius * (slope / math.sqrt(1 + slope**2) if math.isfinite(slope) else 1.0)


@dataclass(frozen=True)
class GapRule:
    """The array rides before the sensor, at least ``minimum_gap`` away; a float stands for one that
    no axis moves, at this world z.
    """

    minimum_gap: float
    array: Mover | float
    sensor: Mover | float
    plate: Plate = Plate(0.0, (0.0, 0.0))

    @property
    def movers(self) -> dict[str, Mover]:
        """The axes it concerns by name."""
        return {
            part.name: part
            for part in (self.array, self.sensor, *self.plate.tilt)
            if isinstance(part, Mover)
        }


def gap_rule(bench: Bench, travels: Mapping[str, Interval]) -> GapRule | None:
    """The rule of a bench; what nothing moves stands where the camera file has it, the main lens at
    world z = 0.

    Args:
        bench: the bench file.
        travels: all that each axis can reach, readings.

    Returns:
        None where no axis moves or tilts either of the two.
    """
    description, array = bench.description, bench.optics.array
    doubt = description.optics_uncertainty

    def mover(element: str, otherwise: float, set_by: float = 0.0) -> Mover | float:
        found = next(
            ((name, axis) for name, axis in description.axes.items() if axis.moves == element), None
        )
        return Mover(*found, travels[found[0]], set_by) if found else otherwise

    def tilt(turn: str, slope: float) -> Mover | float:
        steepest = math.atan(abs(slope)) + COVERAGE * doubt.array_tilt
        return mover(
            turn, math.tan(steepest) if steepest < math.pi / 2 else math.inf, doubt.array_tilt
        )

    rule = GapRule(
        description.minimum_gap,
        mover("array.z", array.distance),
        mover("sensor.z", bench.optics.sensor.distance),
        Plate(
            corner_radius(array, doubt),
            (tilt("array.yaw", array.tilt[0]), tilt("array.pitch", array.tilt[1])),
        ),
    )
    return rule if rule.movers else None


def corner_radius(array: MicrolensArray, doubt: OpticsUncertaintyDescription) -> float:
    """Radius of the circle about the main axis that holds the array's corners, mm, were it as large
    as is doubted.
    """
    pitch, aperture = (1 + COVERAGE * share for share in (doubt.pitch, doubt.microlens_aperture))
    sides = (
        count * step * pitch + array.aperture * aperture
        for count, step in zip(array.count, array.pitch, strict=True)
    )
    return math.hypot(*sides) / 2 + math.hypot(*array.offset)


def least_gap(rule: GapRule, readings: Readings) -> float:
    """The smallest gap possible between array and sensor when axes are between these readings (None
    or missing: anywhere), mm.
    """
    return (
        _place(rule.sensor, readings)[0]
        - _place(rule.array, readings)[1]
        - rule.plate.reach(readings)
    )


def retreats(rule: GapRule, name: str, start: float | None, end: float | None) -> bool:
    """Whether a motion can only widen the gap, whatever the true zeros are; ``end`` None: it looks
    for its reference.
    """
    return _retreats(rule, rule.movers[name], None if start is None else (start, start), end)


def swept(mover: Mover, start: Interval | None, end: float | None) -> Interval:
    """The readings a motion may pass; one that looks for its reference may go to the end of the
    travel it homes towards.

    A tilt that looks for its reference may go anywhere.
    """
    if start is None or (end is None and mover.tilts):
        return mover.travel
    last = mover.homed if end is None else end
    return min(*start, last), max(*start, last)


def check_motion(
    rule: GapRule, name: str, start: float | None, end: float | None, readings: Readings
) -> None:
    """Refuse a motion that could bring array and sensor too near to each other.

    A motion that only leads away is never refused: it is what makes a gap that is too small, or not
    known, safe again.

    Args:
        rule: the rule.
        name: the axis that is to move; others than the rule's are never refused.
        start: its reading, None where it has no reference.
        end: where it is to go, None where it looks for its reference.
        readings: between which readings the other axes may be until they rest; None or missing:
            anywhere in their travel.

    Raises:
        InterlockError: the gap could become smaller than the minimum.
    """
    _check(rule, name, None if start is None else (start, start), end, readings)


def order_moves(
    rule: GapRule | None, readings: Readings, targets: Mapping[str, float]
) -> tuple[str, ...]:
    """In which order axes can go to their targets, one after the other, so that the gap holds on
    the way.

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
            try:
                if rule is not None:
                    _check(rule, name, now.get(name), targets[name], now)
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


def _check(
    rule: GapRule, name: str, start: Interval | None, end: float | None, readings: Readings
) -> None:
    mover = rule.movers.get(name)
    if mover is None or _retreats(rule, mover, start, end):
        return
    gap = least_gap(rule, {**readings, name: swept(mover, start, end)})
    if not gap >= rule.minimum_gap:
        task = (
            "look for its reference"
            if end is None
            else f"move to {mover.axis.coordinate.show(end)}"
        )
        raise InterlockError(
            f"{name}: asked to {task}, which could leave {gap:.3f} mm between array and sensor,"
            f" uncertainties counted {COVERAGE:g} times ({_others(rule, name, readings)}); at least"
            f" {rule.minimum_gap:g} mm are kept, nothing"
            f" moved{_farthest(rule, mover, start, end, readings)}"
        )


def _farthest(
    rule: GapRule, mover: Mover, start: Interval | None, end: float | None, readings: Readings
) -> str:
    """The nearest reading that is allowed on the way, for people, rounded towards the start; empty
    where none is.
    """
    if start is None or end is None or start[0] != start[1]:
        return ""

    def free(share: float) -> bool:
        way = swept(mover, start, start[0] + share * (end - start[0]))
        return least_gap(rule, {**readings, mover.name: way}) >= rule.minimum_gap

    near, far = 0.0, 1.0
    if not free(near):
        return ""
    for _ in range(50):
        middle = (near + far) / 2
        near, far = (middle, far) if free(middle) else (near, middle)
    coordinate = mover.axis.coordinate
    shown = (start[0] + near * (end - start[0])) * coordinate.per_unit
    rounded = (math.floor if end > start[0] else math.ceil)(shown * 1000) / 1000
    return f"; it may go as far as {rounded:.3f} {coordinate.shown}"


def _retreats(rule: GapRule, mover: Mover, start: Interval | None, end: float | None) -> bool:
    if mover.tilts:
        # Towards flat for every zero error that is possible: |end + error| <= |start + error|.
        if start is None or end is None or start[0] != start[1]:
            return False
        here, there = mover.axis.world(start[0]), mover.axis.world(end)
        return (here - there) * (here + there) >= 0 and abs(here + there) >= 2 * mover.spread(
            (start[0], end)
        )
    away = -1 if mover == rule.array else 1
    if end is None:
        return mover.axis.home_towards == ("-z" if away < 0 else "+z")
    return start is not None and all(
        away * (mover.axis.world(end) - mover.axis.world(reading)) >= 0 for reading in start
    )


def _others(rule: GapRule, name: str, readings: Readings) -> str:
    """Where the other parts are, for people."""
    parts = [
        f"the {side}, which nothing moves"
        for side in ("array", "sensor")
        if not isinstance(getattr(rule, side), Mover)
    ]
    for other in rule.movers.values():
        if other.name != name:
            low, high = readings.get(other.name) or (math.nan, math.nan)
            show = other.axis.coordinate.show
            known = f"at {show(low)}" if low == high else f"between {show(low)} and {show(high)}"
            parts.append(
                f"{other.name},"
                f" {known if readings.get(other.name) else 'without a reference: home it first'}"
            )
    return "; ".join(parts)


def _steepest(part: Mover | float, readings: Readings) -> float:
    """The largest slope, infinite from a right angle on."""
    if not isinstance(part, Mover):
        return abs(part)
    angle = max(abs(end) for end in part.place(readings.get(part.name)))
    return math.tan(angle) if angle < math.pi / 2 else math.inf


def _place(part: Mover | float, readings: Readings) -> Interval:
    return part.place(readings.get(part.name)) if isinstance(part, Mover) else (part, part)

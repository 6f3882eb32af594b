# longer than 450 lines because the rule of the gap is one subject read downwards
"""The rules across axes: two neighbours along the light never nearer than their minimum gap. Pure
functions over readings and world places.

Each axis may be anywhere between its readings (one reading at rest, start to end under way, its
whole travel when unknown), widened by three standard uncertainties of its place and by the
following error. What no axis moves stands where the bench file states it, or anywhere. A tilted
array reaches out of its plane as far as the circle about the main axis does that holds its corners,
however it is rolled; its size and how it was set are doubted as the bench file says.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.commands import FOLLOWING
from flflab.bench import AxisDescription, Bench, Moved
from flflab.bench_uncertainty import OpticsUncertaintyDescription
from flflab.errors import InterlockError

if TYPE_CHECKING:
    from flflab.optics.camera import MicrolensArray

Interval = tuple[float, float]
Readings = Mapping[str, Interval | None]
COVERAGE = 3.0


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
class Standing:
    """What no axis moves, or the array's tilt that no axis turns.

    Args:
        moved: what an axis would move.
        at: world z, mm, or angle, rad; None where nothing states it.
        uncertainty: standard uncertainty of it.
        remedy: why nobody knows where it stands, and what to do, where nothing states it.
    """

    moved: Moved
    at: float | None
    uncertainty: float = 0.0
    remedy: str = ""

    def place(self, readings: Interval | None = None) -> Interval:
        """Between which world places it stands; it has no readings."""
        if self.at is None:
            return -math.inf, math.inf
        return self.at - COVERAGE * self.uncertainty, self.at + COVERAGE * self.uncertainty


Part = Mover | Standing


@dataclass(frozen=True)
class Plate:
    """The array as a stiff plate that tilts about where the main axis meets it.

    Args:
        radius: of the circle about that point that holds its corners, mm.
        tilt: along (x, y) what tilts it (yaw, pitch).
    """

    radius: float = 0.0
    tilt: tuple[Part, ...] = ()

    def reach(self, readings: Readings) -> float:
        """How far it may reach out of the plane through its middle, mm: radius * sine of the
        steepest tilt.
        """
        slope = math.hypot(*(_steepest(part, readings) for part in self.tilt))
        return self.radius * (slope / math.sqrt(1 + slope**2) if math.isfinite(slope) else 1.0)


@dataclass(frozen=True)
class Gap:
    """Two neighbours along the light, at least ``least`` mm apart.

    Args:
        names: of the two, the one nearer to the target first.
        least: the minimum gap, mm.
        before: what places the first.
        behind: what places the second.
        metal: how far what they are made of stands out of their planes into the gap, mm.
        plate: the array where it is one of the two, which may tilt.
    """

    names: tuple[str, str]
    least: float
    before: Part
    behind: Part
    metal: float = 0.0
    plate: Plate = Plate()

    @property
    def parts(self) -> tuple[Part, ...]:
        """All that decides the gap."""
        return (self.before, self.behind, *self.plate.tilt)

    @property
    def movers(self) -> dict[str, Mover]:
        """The axes it concerns by name."""
        return {part.name: part for part in self.parts if isinstance(part, Mover)}

    def smallest(self, readings: Readings) -> float:
        """The smallest gap possible when axes are between these readings (None or missing:
        anywhere), mm.
        """
        before, behind = (part.place(_of(part, readings)) for part in (self.before, self.behind))
        return behind[0] - before[1] - self.metal - self.plate.reach(readings)

    def __str__(self) -> str:
        return " and ".join(self.names)


def gap_rules(bench: Bench, travels: Mapping[str, Interval]) -> tuple[Gap, ...]:
    """The gaps that the axes of a bench could close.

    Beside real axes a simulated one moves nothing that is real: what a real one could meet is
    looked at without it, too.

    Args:
        bench: the bench file.
        travels: all that each axis can reach, readings.
    """
    simulated = bench.description.simulated_beside_real()
    gaps = _gaps(bench, travels, frozenset())
    if simulated:
        gaps += [gap for gap in _gaps(bench, travels, simulated) if gap not in gaps]
    return tuple(gaps)


def _gaps(bench: Bench, travels: Mapping[str, Interval], apart: frozenset[str]) -> list[Gap]:
    """The gaps that axes could close, those of the names ``apart`` left out."""
    description, array = bench.description, bench.optics.array
    doubt, stated = description.optics_uncertainty, description.fixed.stated()

    def part(moved: Moved, otherwise: Standing, set_by: float = 0.0) -> Part:
        found = description.axis_of(moved)
        if found and found[0] not in apart:
            return Mover(*found, travels[found[0]], set_by)
        if moved in stated:
            return Standing(moved, stated[moved].at, stated[moved].uncertainty)
        return otherwise

    def unknown(moved: Moved, place: str) -> Standing:
        state = f"state where it stands in {bench.file}, `fixed: {{{moved}: {{at: {place}}}}}`"
        if found := description.axis_of(moved):
            remedy = (
                f"{found[0]} is simulated, and nothing says where {moved} really stands; {state},"
                " or give the axis its address"
            )
        else:
            remedy = (
                f"no axis moves {moved}, and nothing says where it stands; {state}, or give its"
                " axis"
            )
        return Standing(moved, None, remedy=remedy)

    def element(moved: Moved, example: float) -> Part:
        return part(moved, unknown(moved, f"{example:g} mm, uncertainty: 0.1 mm"))

    def tilt(turn: Moved, slope: float) -> Part:
        angle = math.atan(slope)
        if description.turns_the_array():
            # another axis turns it, so the camera file does not say how it stands
            place = f"{math.degrees(angle):g} deg, uncertainty: 0.03 deg"
            return part(turn, unknown(turn, place), doubt.array_tilt)
        return part(turn, Standing(turn, angle, doubt.array_tilt))

    envelopes, least = description.envelopes, description.gaps
    plate = Plate(
        max(corner_radius(array, doubt), envelopes.array.radius),
        (tilt("array.yaw", array.tilt[0]), tilt("array.pitch", array.tilt[1])),
    )
    target = element("target.z", -500.0)
    lens = element("main_lens.z", 0.0)
    lenses = element("array.z", array.distance)
    pixels = element("sensor.z", bench.optics.sensor.distance)
    gaps = [
        Gap(
            ("array", "sensor"), least.array_sensor, lenses, pixels,
            envelopes.array.rear + envelopes.sensor.front, plate,
        ),
        Gap(
            ("main lens", "array"), least.lens_array or least.array_sensor, lens, lenses,
            envelopes.main_lens.rear + envelopes.array.front, plate,
        ),
    ]  # fmt: skip
    if least.target_lens is not None:
        metal = envelopes.target.rear + envelopes.main_lens.front
        gaps.append(Gap(("target", "main lens"), least.target_lens, target, lens, metal))
    return [gap for gap in gaps if gap.movers]


def corner_radius(array: "MicrolensArray", doubt: OpticsUncertaintyDescription) -> float:
    """Radius of the circle about the main axis that holds the array's corners, mm, were it as large
    as is doubted.
    """
    pitch, aperture = (1 + COVERAGE * share for share in (doubt.pitch, doubt.microlens_aperture))
    sides = (
        count * step * pitch + array.aperture * aperture
        for count, step in zip(array.count, array.pitch, strict=True)
    )
    return math.hypot(*sides) / 2 + math.hypot(*array.offset)


def retreats(gaps: Sequence[Gap], name: str, start: float | None, end: float | None) -> bool:
    """Whether a motion can only widen every gap, whatever the true zeros are; ``end`` None: it
    looks for its reference.
    """
    readings = None if start is None else (start, start)
    return all(
        _retreats(gap, gap.movers[name], readings, end) for gap in gaps if name in gap.movers
    )


def homing_order(gaps: Sequence[Gap]) -> tuple[tuple[str, ...], ...]:
    """Which axes that shift something look for their reference together, group after group: first
    those that only lead away from their neighbours, then one by one what these leave free.

    Whatever has no reference yet may be anywhere, farther out than its limits too.
    """
    movers = {name: mover for gap in gaps for name, mover in gap.movers.items() if not mover.tilts}
    first = tuple(name for name in movers if retreats(gaps, name, None, None))
    known: dict[str, Interval] = dict.fromkeys(movers, (-math.inf, math.inf))
    known |= {name: (movers[name].homed, movers[name].homed) for name in first}
    waiting = [name for name in movers if name not in first]
    order = [first] if first else []
    while waiting:
        # where none is free the first is tried, and refused with what is in its way
        free = (name for name in waiting if _allows(gaps, name, None, None, known))
        name = next(free, waiting[0])
        waiting.remove(name)
        known[name] = (movers[name].homed, movers[name].homed)
        order.append((name,))
    return tuple(order)


def homing_groups(bench: Bench) -> tuple[tuple[str, ...], ...]:
    """Which axes of a bench look for their reference together, group after group: what shifts main
    lens, array and sensor first, each while its neighbours are out of its way; the others then.
    """
    axes = bench.description.axes
    order = homing_order(gap_rules(bench, {name: axis.limits for name, axis in axes.items()}))
    others = tuple(name for name in axes if not any(name in group for group in order))
    return tuple(group for group in (*order, others) if group)


def half_way(
    gaps: Sequence[Gap], name: str, start: float, end: float | None, readings: Readings
) -> float | None:
    """The reading at which an axis has used up half of what it may take from a gap; None where it
    stays before it, or its way is not known.

    Whoever else drives the neighbour may take the other half meanwhile.
    """
    share = 1.0
    for gap in gaps:
        mover = gap.movers.get(name)
        if mover is None or _retreats(gap, mover, (start, start), end):
            continue
        if end is None and mover.tilts:
            return None
        last = mover.homed if end is None else end
        present = gap.smallest({**readings, name: (start, start)})
        half = gap.least + (present - gap.least) / 2
        share = min(share, free_share(gap, mover, start, last, readings, half) or 0.0)
        end = last
    return None if end is None or share == 1.0 else start + share * (end - start)


def goes_any_time(gaps: Sequence[Gap], name: str, start: float, end: float) -> bool:
    """Whether a motion keeps every gap wherever the other axes are or go meanwhile."""
    return _allows(gaps, name, (start, start), end, {})


def _allows(
    gaps: Sequence[Gap], name: str, start: Interval | None, end: float | None, readings: Readings
) -> bool:
    try:
        _check(gaps, name, start, end, readings)
    except InterlockError:
        return False
    return True


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
    gaps: Sequence[Gap], name: str, start: float | None, end: float | None, readings: Readings
) -> None:
    """Refuse a motion that could bring two neighbours too near to each other.

    A motion that only leads away is never refused: it is what makes a gap that is too small, or not
    known, safe again.

    Args:
        gaps: the rules.
        name: the axis that is to move; others than the rules' are never refused.
        start: its reading, None where it has no reference.
        end: where it is to go, None where it looks for its reference.
        readings: between which readings the other axes may be until they rest; None or missing:
            anywhere in their travel.

    Raises:
        InterlockError: a gap could become smaller than the minimum.
    """
    _check(gaps, name, None if start is None else (start, start), end, readings)


def order_moves(
    gaps: Sequence[Gap], readings: Readings, targets: Mapping[str, float]
) -> tuple[str, ...]:
    """In which order axes can go to their targets, one after the other, so that the gaps hold on
    the way.

    Args:
        gaps: the rules.
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
                _check(gaps, name, now.get(name), targets[name], now)
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
    gaps: Sequence[Gap], name: str, start: Interval | None, end: float | None, readings: Readings
) -> None:
    for gap in gaps:
        mover = gap.movers.get(name)
        if mover is None or _retreats(gap, mover, start, end):
            continue
        smallest = gap.smallest({**readings, name: swept(mover, start, end)})
        if smallest >= gap.least:
            continue
        task = (
            "look for its reference"
            if end is None
            else f"move to {mover.axis.coordinate.show(end)}"
        )
        unstated = [part for part in gap.parts if isinstance(part, Standing) and part.at is None]
        if unstated:
            raise InterlockError(f"{name}: asked to {task}, nothing moved: {unstated[0].remedy}")
        raise InterlockError(
            f"{name}: asked to {task}, but the gap between {gap} could be {smallest:.3f} mm in the"
            f" worst case, at least {gap.least:g} mm are required"
            f" ({_others(gap, name, readings)}; {COVERAGE:g} standard uncertainties); nothing"
            f" moved{_farthest(gap, mover, start, end, readings)}"
        )


def _farthest(
    gap: Gap, mover: Mover, start: Interval | None, end: float | None, readings: Readings
) -> str:
    """The nearest reading that is allowed on the way, for people, rounded towards the start; empty
    where none is.
    """
    if start is None or end is None or start[0] != start[1]:
        return ""
    share = free_share(gap, mover, start[0], end, readings, gap.least)
    if share is None:
        return ""
    coordinate = mover.axis.coordinate
    shown = (start[0] + share * (end - start[0])) * coordinate.per_unit
    rounded = (math.floor if end > start[0] else math.ceil)(shown * 1000) / 1000
    return f". Farthest allowed: {rounded:.3f} {coordinate.shown}"


def free_share(
    gap: Gap, mover: Mover, start: float, end: float, readings: Readings, least: float
) -> float | None:
    """Which share of a way keeps a gap of ``least`` mm; None where its start does not."""

    def free(share: float) -> bool:
        way = swept(mover, (start, start), start + share * (end - start))
        return gap.smallest({**readings, mover.name: way}) >= least

    near, far = 0.0, 1.0
    if free(far):
        return far
    if not free(near):
        return None
    for _ in range(50):
        middle = (near + far) / 2
        near, far = (middle, far) if free(middle) else (near, middle)
    return near


def _retreats(gap: Gap, mover: Mover, start: Interval | None, end: float | None) -> bool:
    if mover.tilts:
        # Towards flat for every zero error that is possible: |end + error| <= |start + error|.
        if start is None or end is None or start[0] != start[1]:
            return False
        here, there = mover.axis.world(start[0]), mover.axis.world(end)
        return (here - there) * (here + there) >= 0 and abs(here + there) >= 2 * mover.spread(
            (start[0], end)
        )
    away = -1 if mover == gap.before else 1
    if end is None:
        return mover.axis.home_towards == ("-z" if away < 0 else "+z")
    return start is not None and all(
        away * (mover.axis.world(end) - mover.axis.world(reading)) >= 0 for reading in start
    )


def _others(gap: Gap, name: str, readings: Readings) -> str:
    """Where the other parts are, for people."""
    sides = zip(gap.names, (gap.before, gap.behind), strict=True)
    parts = [
        f"the {side}, which nothing moves" for side, part in sides if isinstance(part, Standing)
    ]
    for other in gap.movers.values():
        if other.name != name:
            low, high = readings.get(other.name) or (math.nan, math.nan)
            show = other.axis.coordinate.show
            known = f"at {show(low)}" if low == high else f"between {show(low)} and {show(high)}"
            parts.append(
                f"{other.name},"
                f" {known if readings.get(other.name) else 'without a reference: home it first'}"
            )
    return "; ".join(parts)


def _of(part: Part, readings: Readings) -> Interval | None:
    return readings.get(part.name) if isinstance(part, Mover) else None


def _steepest(part: Part, readings: Readings) -> float:
    """The largest slope, infinite from a right angle on."""
    angle = max(abs(end) for end in part.place(_of(part, readings)))
    return math.tan(angle) if angle < math.pi / 2 else math.inf

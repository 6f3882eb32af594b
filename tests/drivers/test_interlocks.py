# longer than 450 lines because one subject's sentences of behaviour stand together
"""The gap rule against a world that steps both elements and measures the gap between them, hidden
errors included.
"""

import itertools
import math
import re
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.interlocks import (
    FOLLOWING,
    Gap,
    Interval,
    Mover,
    Plate,
    Standing,
    check_motion,
    corner_radius,
    order_moves,
    retreats,
)
from flflab.bench import AxisDescription
from flflab.bench_uncertainty import OpticsUncertaintyDescription
from flflab.errors import InterlockError
from flflab.optics.camera import MicrolensArray

LEAST_MM = 0.3
SIDES = ("array", "sensor")
TRAVEL = (0.0, 50.0)
STEP_MM = 0.05


def axis(element: str, home_towards: str, sign: int, zero: str) -> AxisDescription:
    return AxisDescription.model_validate(
        {
            "driver": "zaber", "moves": element, "sign": sign, "zero": zero,
            "zero_uncertainty": "20 um", "scale_uncertainty": 1e-4,
            "limits": ["0 mm", "50 mm"], "speed": "10 mm/s", "home_towards": home_towards,
        }
    )  # fmt: skip


def rule(array_home: str = "-z", sensor_home: str = "+z", sensor_sign: int = -1) -> Gap:
    """Array from z = 40 to 90 mm; sensor over the same stretch, mounted either way round."""
    sensor = axis("sensor.z", sensor_home, sensor_sign, "92 mm" if sensor_sign < 0 else "42 mm")
    return Gap(
        SIDES,
        LEAST_MM,
        Mover("array", axis("array.z", array_home, 1, "40 mm"), TRAVEL),
        Mover("sensor", sensor, TRAVEL),
    )


@dataclass
class Stage:
    """The truth of one stage: where its element is, what it believes, where it goes."""

    neighbour: Mover
    zero_error: float
    scale_error: float
    reading: float
    homed: bool
    start: float = 0.0
    goal: float | None = None
    homing: bool = False

    @property
    def z(self) -> float:
        axis = self.neighbour.axis
        return axis.zero + self.zero_error + axis.sign * self.reading * (1 + self.scale_error)

    def reach(self) -> Interval | None:
        """What the stage's driver would say of where it is and will be."""
        if not self.homed or self.homing:
            return None
        return (
            (self.reading, self.reading)
            if self.goal is None
            else (min(self.start, self.goal), max(self.start, self.goal))
        )

    def home_end(self) -> float:
        towards = 1 if self.neighbour.axis.home_towards == "+z" else -1
        return TRAVEL[1] if towards * self.neighbour.axis.sign > 0 else TRAVEL[0]

    def go(self, goal: float, homing: bool) -> None:
        self.start, self.goal, self.homing = self.reading, goal, homing

    def step(self) -> None:
        if self.goal is not None:
            way = self.goal - self.reading
            self.reading += math.copysign(min(STEP_MM, abs(way)), way)
            if self.reading == self.goal:
                self.goal, self.homed, self.homing = None, self.homed or self.homing, False


@dataclass
class World:
    rule: Gap
    stages: dict[str, Stage]
    least_seen: float = field(default=math.inf)

    @property
    def gap(self) -> float:
        return self.stages["sensor"].z - self.stages["array"].z

    def ask(self, name: str, goal: float | None) -> bool:
        """Ask for a motion as an axis would; whether it started."""
        stage, other = self.stages[name], self.stages["sensor" if name == "array" else "array"]
        if stage.goal is not None or (goal is not None and not stage.homed):
            return False
        try:
            check_motion(
                (self.rule,),
                name,
                stage.reading if stage.homed else None,
                goal,
                {other.neighbour.name: other.reach()},
            )
        except InterlockError:
            return False
        stage.go(stage.home_end() if goal is None else goal, goal is None)
        return True

    def beside(self, name: str, gap: float) -> float:
        """The reading that by the nominal geometry leaves a gap to where the neighbour is or
        goes.
        """
        stage, other = self.stages[name], self.stages["sensor" if name == "array" else "array"]
        there = other.neighbour.axis.world(other.reading if other.goal is None else other.goal)
        return min(
            max(
                stage.neighbour.axis.reading(there - gap if name == "array" else there + gap),
                TRAVEL[0],
            ),
            TRAVEL[1],
        )

    def run(self, steps: int) -> None:
        for _ in range(steps):
            for stage in self.stages.values():
                stage.step()
            self.least_seen = min(self.least_seen, self.gap)


unit = st.sampled_from([-1.0, 1.0, 0.5, -0.5])
readings = st.floats(0, 50)
rarely = st.sampled_from([False] * 9 + [True])
near = st.floats(0.3, 0.5).map(lambda gap: ("near", gap))  # a goal that leaves about the least gap
commands = st.tuples(
    st.sampled_from(["array", "sensor"]),
    st.one_of(near, st.none(), readings),
    st.integers(0, 1500),
    rarely,
)


def world(
    rule_: Gap, errors: tuple[float, ...], begin: tuple[float, float], homed: tuple[bool, bool]
) -> World:
    stages = {
        name: Stage(part, 0.06 * errors[2 * k], 3e-4 * errors[2 * k + 1], begin[k], homed[k])
        for k, (name, part) in enumerate((("array", rule_.before), ("sensor", rule_.behind)))
        if isinstance(part, Mover)
    }
    return World(rule_, stages)


@settings(max_examples=250)
@given(
    homes=st.sampled_from([("-z", "+z"), ("+z", "+z"), ("-z", "-z")]),
    sensor_sign=st.sampled_from([1, -1]),
    errors=st.tuples(unit, unit, unit, unit),
    begin=st.tuples(st.floats(0, 25), st.floats(0, 25)),
    homed=st.sampled_from([(True, True)] * 6 + [(True, False), (False, True), (False, False)]),
    program=st.lists(commands, min_size=3, max_size=8),
)
def test_whatever_is_asked_for_the_true_gap_never_falls_below_the_minimum(
    homes: tuple[str, str],
    sensor_sign: int,
    errors: tuple[float, ...],
    begin: tuple[float, float],
    homed: tuple[bool, bool],
    program: list[tuple[str, float | tuple[str, float] | None, int, bool]],
) -> None:
    begin = begin if sensor_sign < 0 else (begin[0], 50 - begin[1])
    bench = world(rule(*homes, sensor_sign), errors, begin, homed)
    assume(bench.gap >= LEAST_MM)
    for name, goal, steps, switched_off in program:
        bench.ask(name, bench.beside(name, goal[1]) if isinstance(goal, tuple) else goal)
        bench.run(steps)
        if switched_off and bench.stages[name].goal is None:
            bench.stages[name].homed = False
    bench.run(2500)
    assert bench.least_seen >= LEAST_MM


@settings(max_examples=150)
@given(
    begin=st.tuples(readings, readings), targets=st.tuples(readings, readings), swap=st.booleans()
)
def test_an_order_is_found_exactly_where_one_keeps_the_gap_in_the_worst_case(
    begin: tuple[float, float], targets: tuple[float, float], swap: bool
) -> None:
    rule_ = rule()
    array, sensor = (
        _without_scale_uncertainty(part)
        for part in (rule_.before, rule_.behind)
        if isinstance(part, Mover)
    )
    exact = Gap(SIDES, LEAST_MM, array, sensor)
    nearest = 2 * (0.06 + FOLLOWING["mm"])
    wanted: dict[str, float] = dict(zip(("array", "sensor"), targets, strict=True))
    asked = dict(reversed(wanted.items())) if swap else wanted

    def keeps(order: tuple[str, ...]) -> bool:
        now: dict[str, float] = dict(zip(("array", "sensor"), begin, strict=True))
        for name in order:
            for reading in np.linspace(now[name], wanted[name], 50):
                now[name] = float(reading)
                gap = (92 - now["sensor"]) - (40 + now["array"]) - nearest
                retreat = (wanted[name] - begin[name == "sensor"]) <= 0
                if gap < LEAST_MM and not retreat:
                    return False
        return True

    kept = [order for order in itertools.permutations(wanted) if keeps(order)]
    places = {
        name: (reading, reading) for name, reading in zip(("array", "sensor"), begin, strict=True)
    }
    if kept:
        assert order_moves((exact,), places, asked) in kept
    else:
        with pytest.raises(InterlockError, match="between array and sensor"):
            order_moves((exact,), places, asked)


def _without_scale_uncertainty(part: Mover) -> Mover:
    return Mover(part.name, part.axis.model_copy(update={"scale_uncertainty": 0.0}), part.travel)


def test_going_up_together_the_sensor_goes_first_and_back_the_array() -> None:
    low, high = {"array": 20.0, "sensor": 31.0}, {"array": 22.0, "sensor": 29.0}
    at = {
        name: {axis: (value, value) for axis, value in place.items()}
        for name, place in (("low", low), ("high", high))
    }
    assert order_moves((rule(),), at["low"], high) == ("sensor", "array")
    assert order_moves((rule(),), at["high"], low) == ("array", "sensor")


def test_axes_the_rule_does_not_concern_keep_their_turn() -> None:
    assert order_moves((rule(),), {"target": None}, {"target": 3.0}) == ("target",)
    assert order_moves((), {}, {"b": 1.0, "a": 2.0}) == ("b", "a")


def test_an_approach_beside_an_unknown_neighbour_is_refused_and_says_what_to_do() -> None:
    with pytest.raises(
        InterlockError, match="sensor, without a reference: home it first"
    ) as caught:
        check_motion((rule(),), "array", 10.0, 11.0, {"sensor": None})
    assert "at least 0.3 mm are required" in str(caught.value)
    check_motion((rule(),), "array", 10.0, 9.0, {})


def test_homing_away_is_free_and_homing_towards_needs_a_neighbour_known_and_clear() -> None:
    check_motion((rule(),), "array", None, None, {})
    check_motion((rule(),), "sensor", None, None, {})
    for neighbour in (None, (30.0, 30.0), (0.0, 2.0)):
        with pytest.raises(InterlockError, match="asked to look for its reference"):
            check_motion((rule(array_home="+z"),), "array", None, None, {"sensor": neighbour})
    check_motion((rule(array_home="+z"),), "array", None, None, {"sensor": (0.0, 1.0)})


def turn(element: str, zero_uncertainty: str = "0.02 deg") -> AxisDescription:
    return AxisDescription.model_validate(
        {
            "driver": "thorlabs", "moves": element, "zero_uncertainty": zero_uncertainty,
            "limits": ["-10 deg", "10 deg"],
            "speed": "10 deg/s", "home_towards": f"-{element.partition('.')[2]}",
        }
    )  # fmt: skip


ARRAY = MicrolensArray("square", (25, 25), (0.12, 0.12), 0.1, (0.9,), 60.0)
KNOWN = OpticsUncertaintyDescription()  # of its size nothing is doubted
TILTS = (-math.radians(10), math.radians(10))


FLAT = Standing("array.pitch", 0.0)


def tilted_rule() -> Gap:
    yaw, pitch = (Mover(name, turn(f"array.{name}"), TILTS) for name in ("yaw", "pitch"))
    return Gap(
        SIDES,
        LEAST_MM,
        rule().before,
        rule().behind,
        0.0,
        Plate(corner_radius(ARRAY, KNOWN), (yaw, pitch)),
    )


def test_the_circle_round_the_corners_of_a_tilted_array_reaches_out() -> None:
    radius = 1.55 * math.sqrt(2)
    assert corner_radius(ARRAY, KNOWN) == pytest.approx(radius)
    fixed = Plate(radius, (Standing("array.yaw", math.radians(1)), FLAT))
    assert fixed.reach({}) == pytest.approx(radius * math.sin(math.radians(1)))
    rule_, flat = tilted_rule(), rule()
    at = {
        "array": (20.0, 20.0),
        "sensor": (30.0, 30.0),
        "yaw": (math.radians(1), math.radians(2)),
        "pitch": (0.0, 0.0),
    }
    steepest = math.hypot(math.tan(math.radians(2.06) + 2e-4), math.tan(math.radians(0.06) + 2e-4))
    assert flat.smallest(at) - rule_.smallest(at) == pytest.approx(
        radius * math.sin(math.atan(steepest))
    )


def test_a_tilt_that_nobody_knows_may_be_anything_even_of_a_stage_that_turns_for_ever() -> None:
    endless = Mover("yaw", turn("array.yaw"), (-math.inf, math.inf))
    assert Plate(2.0, (endless, FLAT)).reach({}) == 2.0
    rule_ = Gap(SIDES, LEAST_MM, rule().before, rule().behind, 0.0, Plate(2.0, (endless, FLAT)))
    near = {"array": (20.0, 20.0), "sensor": (30.0, 30.0)}
    with pytest.raises(InterlockError, match="yaw: asked to look for its reference"):
        check_motion((rule_,), "yaw", None, None, near)
    check_motion((rule_,), "yaw", None, None, {"array": (20.0, 20.0), "sensor": (29.0, 29.0)})
    with pytest.raises(InterlockError, match=r"array: .*yaw, without a reference: home it first"):
        check_motion((rule_,), "array", 20.0, 20.5, near)


def test_a_tilt_is_refused_where_its_corners_would_come_too_near_and_the_way_back_is_free() -> None:
    rule_ = tilted_rule()
    at = {"array": (20.0, 20.0), "sensor": (31.4, 31.4), "pitch": (0.0, 0.0), "yaw": (0.0, 0.0)}
    check_motion((rule_,), "pitch", 0.0, math.radians(2), at)
    with pytest.raises(
        InterlockError,
        match=(
            r"pitch: asked to move to -9\.000000 deg, but the gap between array and sensor could be"
            r" 0\.\d+ mm in the worst case"
        ),
    ) as refused:
        check_motion((rule_,), "pitch", 0.0, math.radians(-9), at)
    told = re.search(r"nothing moved\. Farthest allowed: (-\d\.\d{3}) deg$", str(refused.value))
    assert told is not None
    check_motion((rule_,), "pitch", 0.0, math.radians(float(told[1])), at)
    with pytest.raises(InterlockError):
        check_motion((rule_,), "pitch", 0.0, math.radians(float(told[1]) - 0.002), at)
    too_near = at | {"sensor": (31.8, 31.8)}
    check_motion((rule_,), "pitch", math.radians(-9), math.radians(-1), too_near)
    with pytest.raises(InterlockError):
        check_motion((rule_,), "pitch", math.radians(-9), math.radians(9), too_near)


def test_levelling_counts_as_a_way_back_only_where_the_true_tilt_shrinks_whatever_its_zero() -> (
    None
):
    rule_ = tilted_rule()
    assert retreats((rule_,), "pitch", math.radians(-9), math.radians(-1))
    assert retreats((rule_,), "pitch", math.radians(9), 0.0)
    assert not retreats(
        (rule_,), "pitch", math.radians(0.05), 0.0
    )  # its zero may be off by 0.06 degrees
    assert not retreats((rule_,), "pitch", math.radians(1), math.radians(-0.99))
    assert not retreats((rule_,), "pitch", math.radians(1), math.radians(2))


@settings(max_examples=150)
@given(
    errors=st.tuples(unit, unit, unit, unit),
    begin=st.tuples(st.floats(15, 20), st.floats(25, 32), st.floats(-10, 10), st.floats(-10, 10)),
    program=st.lists(
        st.tuples(st.integers(0, 3), st.floats(-1, 1), st.integers(0, 60)), min_size=4, max_size=12
    ),
    roll=st.floats(0, math.tau),
)
def test_no_corner_of_a_tilting_array_ever_comes_nearer_than_the_minimum(
    errors: tuple[float, ...],
    begin: tuple[float, ...],
    program: list[tuple[int, float, int]],
    roll: float,
) -> None:
    """All four axes step at once; the truth is the height of each corner of a stiff plate."""
    rule_ = tilted_rule()
    names: tuple[str, ...] = ("array", "sensor", "yaw", "pitch")
    spans: dict[str, Interval] = {
        "array": (18.0, 22.0),
        "sensor": (28.0, 32.0),
        "yaw": TILTS,
        "pitch": TILTS,
    }
    steps = {"array": 0.25, "sensor": 0.25, "yaw": math.radians(0.5), "pitch": math.radians(0.5)}
    off = dict(
        zip(
            names,
            (
                0.06 * errors[0],
                0.06 * errors[1],
                math.radians(0.06) * errors[2],
                math.radians(0.06) * errors[3],
            ),
            strict=True,
        )
    )
    now: dict[str, float] = dict(
        zip(names, (*begin[:2], math.radians(begin[2]), math.radians(begin[3])), strict=True)
    )
    ways: dict[str, tuple[float, float]] = {}

    def true_gap() -> float:
        world = {name: rule_.movers[name].axis.world(now[name]) + off[name] for name in names}
        along_x, along_y = math.tan(world["yaw"]), math.tan(world["pitch"])
        # In the plate's plane: a unit vector across y, and the one square to it; the corners are
        # rolled in that plane.
        length, steep = math.hypot(1, along_x), math.hypot(1, along_x, along_y)
        rise_first, rise_second = along_x / length, along_y / (length * steep)
        cos, sin = math.cos(roll), math.sin(roll)
        heights = [
            (cos * x - sin * y) * rise_first + (sin * x + cos * y) * rise_second
            for x in (-1.55, 1.55)
            for y in (-1.55, 1.55)
        ]
        return world["sensor"] - world["array"] - max(heights)

    assume(true_gap() >= LEAST_MM)
    least = true_gap()
    for which, share, steps_taken in program:
        name = names[which]
        low, high = spans[name]
        goal = (low + high) / 2 + share * (high - low) / 2
        others = {
            other: ways.get(other, (now[other], now[other])) for other in names if other != name
        }
        if name not in ways:
            try:
                check_motion((rule_,), name, now[name], goal, others)
                ways[name] = (now[name], goal)
            except InterlockError:
                pass
        for _ in range(steps_taken):
            for moving, (_, end) in list(ways.items()):
                way = end - now[moving]
                now[moving] += math.copysign(min(steps[moving], abs(way)), way)
                if now[moving] == end:
                    del ways[moving]
            if not ways:
                break
            least = min(least, true_gap())
    assert least >= LEAST_MM - 1e-12


def test_an_element_that_nothing_moves_stands_where_the_bench_file_states_it_or_anywhere() -> None:
    standing = Standing("array.z", 60.0, 0.1)
    fixed = Gap(SIDES, LEAST_MM, standing, rule().behind)
    check_motion((fixed,), "sensor", 20.0, 31.0, {})
    with pytest.raises(InterlockError, match="the array, which nothing moves"):
        check_motion((fixed,), "sensor", 20.0, 31.4, {})
    exact = Gap(SIDES, LEAST_MM, Standing("array.z", 60.0), rule().behind)
    check_motion((exact,), "sensor", 20.0, 31.4, {})
    unstated = Gap(
        SIDES,
        LEAST_MM,
        Standing("array.z", None, remedy="nothing says where; state it"),
        rule().behind,
    )
    check_motion((unstated,), "sensor", 20.0, 19.0, {})
    with pytest.raises(InterlockError, match="nothing moved: nothing says where; state it"):
        check_motion((unstated,), "sensor", 20.0, 20.1, {})

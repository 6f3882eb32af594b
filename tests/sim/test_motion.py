"""Motion against closed-form trapezoids and against small steps of time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.motion import Motion, move, rest, stop

POSITIONS = st.floats(-100, 100)
SPEEDS = st.floats(0.1, 50)
ACCELERATIONS = st.floats(1, 500)


def test_a_long_move_is_a_trapezoid() -> None:
    motion = move(rest(5.0), 2.0, 25.0, speed=4.0, acceleration=8.0)
    # 0.5 s and 1 mm for each ramp, 18 mm at 4 mm/s between them.
    assert motion.end == pytest.approx(2.0 + 0.5 + 4.5 + 0.5)
    for elapsed, position, velocity in [
        (0.25, 5.25, 2),
        (0.5, 6, 4),
        (2.5, 14, 4),
        (5.0, 24, 4),
        (5.25, 24.75, 2),
        (5.5, 25, 0),
        (9, 25, 0),
    ]:
        assert motion.at(2.0 + elapsed) == pytest.approx((position, velocity))


def test_a_short_move_is_a_triangle() -> None:
    motion = move(rest(0.0), 0.0, -0.5, speed=10.0, acceleration=2.0)
    assert motion.end == pytest.approx(1.0)
    assert motion.at(0.5) == pytest.approx((-0.25, -1.0))


def test_infinite_acceleration_steps_in_velocity() -> None:
    motion = move(rest(0.0), 0.0, 10.0, speed=5.0, acceleration=math.inf)
    assert motion.end == 2.0
    assert motion.at(1.0) == (5.0, 5.0)
    assert stop(motion, 1.0, math.inf).at(1.0) == (5.0, 0.0)


def test_stopping_takes_v_squared_over_2a() -> None:
    motion = stop(move(rest(0.0), 0.0, 100.0, speed=10.0, acceleration=20.0), 3.0, 20.0)
    # 2.5 mm on the ramp, 2.5 s at speed, 2.5 mm to stop.
    assert motion.target == pytest.approx(2.5 + 25 + 2.5)
    assert motion.end == pytest.approx(3.5)


def test_a_new_target_behind_turns_the_carriage_round() -> None:
    outward = move(rest(0.0), 0.0, 100.0, speed=10.0, acceleration=20.0)
    back = move(outward, 3.0, 0.0, speed=10.0, acceleration=20.0)
    assert back.at(3.5) == pytest.approx((30.0, 0.0))
    # The turning point at 30 mm after 0.5 s, then 30 mm back in (30 - 5)/10 + 1 s.
    assert back.end == pytest.approx(3.0 + 0.5 + 3.5)


def _never_breaks_its_limits(motion: Motion, start: float, top: float, acceleration: float) -> None:
    instants = np.linspace(start, motion.end, 2001)
    states = np.array([motion.at(float(instant)) for instant in instants])
    step = instants[1] - instants[0]
    assert np.all(np.abs(states[:, 1]) <= top * (1 + 1e-9) + 1e-9)
    # Speed changes no faster than the acceleration allows, and position is the integral of speed.
    assert np.all(np.abs(np.diff(states[:, 1])) <= acceleration * step * (1 + 1e-6) + 1e-9)
    travelled = np.sum((states[1:, 1] + states[:-1, 1]) / 2 * step)
    assert travelled == pytest.approx(
        motion.target - states[0, 0], abs=acceleration * step**2 * 4 + 1e-9
    )


@given(POSITIONS, POSITIONS, POSITIONS, SPEEDS, SPEEDS, ACCELERATIONS, st.floats(0, 1))
def test_any_pre_empted_move_keeps_its_limits(
    a: float, b: float, c: float, first: float, second: float, ramp: float, share: float
) -> None:
    outward = move(rest(a), 0.0, b, first, ramp)
    now = share * max(outward.end, 0.0)
    motion = move(outward, now, c, second, ramp)
    assert motion.at(now) == pytest.approx(outward.at(now), abs=1e-6)
    if motion.segments:
        _never_breaks_its_limits(motion, now, max(first, second), ramp)
        assert motion.at(math.nextafter(motion.end, -math.inf))[0] == pytest.approx(c, abs=1e-6)


@given(POSITIONS, POSITIONS, SPEEDS, ACCELERATIONS, st.floats(0, 1))
def test_any_stop_keeps_its_limits(
    a: float, b: float, speed: float, ramp: float, share: float
) -> None:
    outward = move(rest(a), 0.0, b, speed, ramp)
    now = share * max(outward.end, 0.0)
    motion = stop(outward, now, ramp)
    if motion.segments:
        _never_breaks_its_limits(motion, now, speed, ramp)

"""Other people's clients of the APT protocol drive the simulated controller: one unmodified over a
pseudo terminal, one by bytes.
"""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import thorlabs_apt_protocol as apt
from thorlabs_apt_device.devices.kdc101 import KDC101

from sim.clock import RunningClock, SteppedClock
from sim.faults import Fault, Faults
from sim.server import PtyLine
from sim.stage import Stage
from sim.thorlabs import COUNT, COUNTS_PER_DEGREE, Controller, ControllerSession
from sim.world import Carriage

DEGREE = COUNTS_PER_DEGREE


def controller(clock: RunningClock | SteppedClock, *faults: Fault) -> Controller:
    """A stage left at 20 degrees, 10 degrees/s."""
    stage = Stage(
        Carriage(clock, 20 * DEGREE * COUNT),
        (-250.0, 250.0),
        COUNT,
        10 * DEGREE,
        50 * DEGREE,
        home=0.0,
    )
    return Controller(stage, Faults(faults), 27_000_001, threading.RLock())


def until(true: Callable[[], bool], patience: float = 10.0) -> None:
    deadline = time.monotonic() + patience
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


no_pty = pytest.mark.skipif(
    sys.platform == "win32",
    reason="this client opens serial ports only, and Windows has no pseudo terminals",
)


@pytest.fixture
def client() -> Iterator[Any]:
    simulated = controller(RunningClock(50))
    line = PtyLine(lambda: ControllerSession(simulated))
    device = KDC101(serial_port=line.address, home=False)
    yield device
    device.close()
    device._thread.join()  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    line.stop()


@no_pty
def test_the_makers_friends_client_homes_moves_and_reads(client: Any) -> None:
    until(lambda: client.status["motor_connected"])
    assert not client.status["homed"]
    client.home()
    until(lambda: client.status["homed"])
    assert client.status["position"] == 0
    client.move_absolute(round(12.5 * DEGREE))
    until(lambda: client.status["position"] == round(12.5 * DEGREE))
    client.move_relative(-1000)
    until(lambda: client.status["position"] == round(12.5 * DEGREE) - 1000)
    until(lambda: not client.status["moving_forward"] and not client.status["moving_reverse"])


@no_pty
def test_the_client_sets_a_speed_and_stops_a_motion(client: Any) -> None:
    until(lambda: client.velparams["max_velocity"] > 0)
    client.set_velocity_params(
        acceleration=732, max_velocity=42942
    )  # 50 degrees/s^2 and 1 degree/s
    client.home()
    until(lambda: client.status["homed"], 30)
    client.move_absolute(round(300 * DEGREE))
    until(lambda: client.status["position"] > DEGREE)
    assert (client.status["moving_forward"], client.status["moving_reverse"]) == (True, False)
    client.stop()
    until(lambda: not client.status["moving_forward"] and not client.status["moving_reverse"])
    assert DEGREE < client.status["position"] < 300 * DEGREE


@no_pty
def test_the_start_up_values_are_those_of_a_prm1_z8(client: Any) -> None:
    until(
        lambda: (
            client.homeparams["home_velocity"] > 0 and client.genmoveparams["backlash_distance"] > 0
        )
    )
    assert client.homeparams["home_velocity"] == pytest.approx(
        0x068D5F, rel=1e-4
    )  # 10 degrees/s as the maker's software sends it
    assert client.homeparams["offset_distance"] == pytest.approx(7679, abs=1)
    assert client.genmoveparams["backlash_distance"] == 1920
    assert client.velparams["max_velocity"] == pytest.approx(0x068D5F, rel=1e-4)


def read(answer: bytes) -> list[Any]:
    unpacker = apt.Unpacker(on_error="raise")
    unpacker.feed(answer)
    return list(unpacker)


def test_every_answer_is_what_the_independent_decoder_expects() -> None:
    clock = SteppedClock()
    session = ControllerSession(controller(clock))
    (info,) = read(session.receive(apt.hw_req_info(dest=0x50, source=1)))
    assert (info.serial_number, info.model_number.rstrip(b"\0"), info.nchs) == (
        27_000_001,
        b"KDC101",
        1,
    )
    (speed,) = read(session.receive(apt.mot_req_velparams(dest=0x50, source=1, chan_ident=1)))
    assert (speed.max_velocity, speed.acceleration) == (
        pytest.approx(10 * 42941.66, abs=1),
        pytest.approx(50 * 14.6574, abs=1),
    )
    assert session.receive(apt.mot_move_home(dest=0x50, source=1, chan_ident=1)) == b""
    (state,) = read(session.receive(apt.mot_req_dcstatusupdate(dest=0x50, source=1, chan_ident=1)))
    assert state.homing
    assert not state.homed
    clock.step(60)
    assert [message.msg for message in read(session.unasked())] == ["mot_move_homed"]
    session.receive(apt.mot_move_absolute(dest=0x50, source=1, chan_ident=1, position=-38393))
    clock.step(1)
    (state,) = read(session.receive(apt.mot_req_dcstatusupdate(dest=0x50, source=1, chan_ident=1)))
    assert (state.moving_forward, state.moving_reverse) == (True, False)  # as on the real cubes
    assert state.velocity < 0
    clock.step(60)
    (ended,) = read(session.unasked())
    assert (ended.msg, ended.position, ended.settled, ended.channel_enabled) == (
        "mot_move_completed",
        -38393,
        True,
        True,
    )
    (counter,) = read(session.receive(apt.mot_req_poscounter(dest=0x50, source=1, chan_ident=1)))
    assert counter.position == -38393


def test_a_motor_that_is_off_does_not_move() -> None:
    clock = SteppedClock()
    session = ControllerSession(controller(clock))
    session.receive(apt.mod_set_chanenablestate(dest=0x50, source=1, chan_ident=1, enable_state=2))
    (enabled,) = read(
        session.receive(apt.mod_req_chanenablestate(dest=0x50, source=1, chan_ident=1))
    )
    assert not enabled.enabled
    session.receive(apt.mot_move_absolute(dest=0x50, source=1, chan_ident=1, position=5000))
    clock.step(10)
    (state,) = read(session.receive(apt.mot_req_dcstatusupdate(dest=0x50, source=1, chan_ident=1)))
    assert (state.position, state.channel_enabled) == (0, False)


def test_bytes_that_begin_no_message_are_passed_over() -> None:
    session = ControllerSession(controller(SteppedClock()))
    request = apt.hw_req_info(dest=0x50, source=1)
    assert session.receive(b"\xff\x00\x13garbage" + request[:4]) == b""
    (info,) = read(session.receive(request[4:]))
    assert info.serial_number == 27_000_001


def test_a_jammed_stage_says_so_and_loses_its_reference() -> None:
    clock = SteppedClock()
    session = ControllerSession(controller(clock, Fault("stall", after=1)))
    session.receive(apt.mot_move_home(dest=0x50, source=1, chan_ident=1))
    clock.step(60)
    session.receive(
        apt.mot_move_absolute(dest=0x50, source=1, chan_ident=1, position=round(20 * DEGREE))
    )
    clock.step(60)
    (state,) = read(session.receive(apt.mot_req_dcstatusupdate(dest=0x50, source=1, chan_ident=1)))
    assert state.motion_error
    assert not state.homed
    assert state.position == pytest.approx(0.5 * DEGREE, abs=1)


@no_pty
@pytest.mark.parametrize(("direction", "sign"), [("forward", 1), ("reverse", -1)])
def test_the_client_knows_which_way_a_stage_turns(client: Any, direction: str, sign: int) -> None:
    client.home()
    until(lambda: client.status["homed"])
    client.move_velocity(direction)
    until(lambda: sign * client.status["position"] > 0.1 * DEGREE)
    moving = {1: "moving_forward", -1: "moving_reverse"}
    assert (client.status[moving[sign]], client.status[moving[-sign]]) == (True, False)
    client.stop()


def test_jog_parameters_come_in_the_order_of_the_makers_friends_clients() -> None:
    session = ControllerSession(controller(SteppedClock()))
    (jog,) = read(session.receive(apt.mot_req_jogparams(dest=0x50, source=1, chan_ident=1)))
    assert (jog.step_size, jog.min_velocity) == (pytest.approx(5 * DEGREE, abs=1), 0)
    assert jog.acceleration == pytest.approx(15 * 14.6574, abs=1)
    assert jog.max_velocity == pytest.approx(15 * 42941.66, abs=1)


def test_what_a_client_asks_a_k_cube_at_its_start_is_answered_and_kept() -> None:
    session = ControllerSession(controller(SteppedClock()))
    to = {"dest": 0x50, "source": 1, "chan_ident": 1}
    (panel,) = read(session.receive(apt.mot_req_kcubemmiparams(**to)))
    (triggers,) = read(session.receive(apt.mot_req_kcubetrigconfig(**to)))
    (pulses,) = read(session.receive(apt.mot_req_kcubeposttrigparams(**to)))
    assert (panel.msg, triggers.msg, pulses.msg) == (
        "mot_get_kcubemmiparams",
        "mot_get_kcubetrigconfig",
        "mot_get_kcubeposttrigparams",
    )
    assert panel.max_vel == pytest.approx(10 * 42941.66, abs=1)
    told = {
        "trig1_mode": 3, "trig1_polarity": 1, "trig2_mode": 4, "trig2_polarity": 2,
    }  # fmt: skip
    assert session.receive(apt.mot_set_kcubetrigioconfig(**to, **told)) == b""
    (triggers,) = read(session.receive(apt.mot_req_kcubetrigconfig(**to)))
    assert {name: getattr(triggers, name) for name in told} == told

"""An axis on the wire of a toy stage: what it refuses, how its motions end, and that a stop always
works.
"""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from bluesky import protocols

from drivers.axis import Axis
from drivers.base import wait_all
from drivers.transport import open_serial
from drivers.zaber import ZaberAxis, ZaberChain, ZaberKeys
from flflab.errors import (
    CommunicationError,
    DeviceError,
    InterlockError,
    LimitError,
    MotionError,
    NotHomedError,
)

MICROSTEP_MM = 0.5e-3
Build = Callable[..., tuple[Axis, Any]]


@pytest.fixture
def axis(toy_chain: Callable[..., str], toy_stage: type[Any]) -> Iterator[Build]:
    """Build an axis of 0 to 40 mm on a toy stage of 0 to 50 mm that runs at 50 mm/s."""
    built: list[tuple[Axis, ZaberChain]] = []

    def build(
        *,
        patience: float = 0.3,
        guard: Any = None,
        driver: type[ZaberAxis] = ZaberAxis,
        **stage_is: Any,
    ) -> tuple[Axis, Any]:
        stage = toy_stage(**stage_is)
        address = toy_chain(stage)
        chain = ZaberChain(lambda: open_serial(address, 115200), timeout=0.15)
        keys = ZaberKeys.model_validate({"device": 1, "microstep": "0.5 um"})
        axis = Axis(
            "array_stage",
            driver("array_stage", chain, keys, 10.0, homes_up=False),
            (0.0, 40.0),
            10.0,
            patience=patience,
        )
        if guard:
            axis.guard = guard
        built.append((axis, chain))
        return axis, stage

    yield build
    for axis, chain in built:
        axis.close()
        chain.close()


def motions(stage: Any) -> list[str]:
    return [text for text in stage.heard if text.startswith(("move", "home"))]


def test_connecting_moves_nothing_and_sets_the_speed_in_the_devices_unit(axis: Build) -> None:
    _, stage = axis()
    assert motions(stage) == []
    assert stage.settings["maxspeed"] == round(10 / MICROSTEP_MM * 1.6384)


def test_the_step_follows_the_devices_own_resolution(axis: Build) -> None:
    device, stage = axis(resolution=32)
    assert device.travel == (0.0, 100.0)
    device.move_to(10.0).wait(5)
    assert stage.position == 10000


def test_it_is_what_bluesky_calls_a_motor(axis: Build) -> None:
    device, _ = axis()
    for promise in (
        "Movable",
        "Readable",
        "Locatable",
        "Stoppable",
        "Checkable",
        "Configurable",
        "HasHints",
    ):
        assert isinstance(device, getattr(protocols, promise)), promise
    status = device.move_to(0.1)
    assert isinstance(status, protocols.Status)
    status.wait(2)


def test_a_move_ends_on_the_microstep_nearest_to_the_position_asked_for(axis: Build) -> None:
    device, stage = axis()
    device.move_to(12.3456789).wait(5)
    assert stage.position == 24691
    assert device.position() == 24691 * MICROSTEP_MM
    assert device.read()["array_stage"]["value"] == device.position()
    device.move_by(-1.0).wait(5)
    assert stage.position == 22691


NO_POSITIONS = [
    -1e-9,
    40.000001,
    1e300,
    float("nan"),
    float("inf"),
    -float("inf"),
    "12",
    None,
    np.float32("nan"),
]


@pytest.mark.parametrize("position", NO_POSITIONS)
def test_a_position_outside_the_limits_is_refused_and_nothing_is_sent(
    position: Any, axis: Build
) -> None:
    device, stage = axis()
    with pytest.raises(LimitError, match="array_stage"):
        device.move_to(position)
    assert motions(stage) == []


def test_the_devices_own_limits_count_beside_the_soft_ones(axis: Build) -> None:
    device, stage = axis()
    device.limits = (0.0, 60.0)
    with pytest.raises(LimitError, match="the device's own limits, 0 mm to 50 mm"):
        device.move_to(55.0)
    assert motions(stage) == []


def test_a_position_just_outside_is_told_the_limit_to_the_digit_that_refuses_it(
    axis: Build,
) -> None:
    device, _ = axis(resolution=63)
    device.limits = (0.0, 60.0)
    with pytest.raises(
        LimitError,
        match=r"go to 50\.793660 mm, outside the device's own limits, 0 mm to 50\.7936508 mm",
    ):
        device.move_to(50.79366)


def test_a_device_that_refuses_the_position_itself_is_a_refusal_too(axis: Build) -> None:
    device, stage = axis()
    stage.limit = 10
    with pytest.raises(LimitError, match="BADDATA"):
        device.move_to(30.0)
    stage.limit = 100000
    device.move_to(1.0).wait(2)


def test_without_a_reference_only_homing_is_possible(axis: Build) -> None:
    device, stage = axis(homed=False)
    with pytest.raises(NotHomedError, match="home it first"):
        device.move_to(1.0)
    assert motions(stage) == []
    assert device.reach() is None
    device.home().wait(2)
    assert device.reach() == (0.0, 0.0)
    device.move_to(1.0).wait(2)


def test_the_guard_is_asked_before_anything_moves(axis: Build) -> None:
    asked: list[tuple[str, float | None, float | None]] = []

    def guard(name: str, start: float | None, end: float | None) -> None:
        asked.append((name, start, end))
        raise InterlockError("too near")

    device, stage = axis(guard=guard)
    for move in (lambda: device.move_to(2.0), device.home):
        with pytest.raises(InterlockError):
            move()
    assert asked == [("array_stage", 0.0, 2.0), ("array_stage", 0.0, None)]
    assert motions(stage) == []
    assert not device.is_moving()


def test_a_second_move_while_it_moves_is_refused(axis: Build) -> None:
    device, _ = axis()
    status = device.move_to(10.0)
    assert device.reach() == (0.0, 10.0)
    with pytest.raises(DeviceError, match="while it moves"):
        device.move_to(5.0)
    status.wait(5)
    assert device.reach() == (10.0, 10.0)


def test_a_stop_ends_the_motion_where_it_is_and_says_so(axis: Build) -> None:
    device, _ = axis()
    status = device.move_to(30.0)
    time.sleep(0.1)
    device.stop()
    with pytest.raises(MotionError, match="stopped on the way"):
        status.wait(2)
    assert 0.5 < device.position() < 29
    device.move_to(0.0).wait(5)


def test_a_stop_as_planned_ends_the_motion_well(axis: Build) -> None:
    device, _ = axis()
    status = device.move_to(30.0)
    device.stop(success=True)
    status.wait(2)
    assert status.success


def test_stops_from_many_threads_all_arrive_while_it_is_watched(axis: Build) -> None:
    device, stage = axis()
    status = device.move_to(30.0)
    threads = [threading.Thread(target=device.stop) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(5)
    assert isinstance(status.exception(2), MotionError)
    assert stage.heard.count("stop") == 8


def stick(stage: Any) -> None:
    stage.stuck_at, stage.speed = 1000.0, 10.0


def stall(stage: Any) -> None:
    stage.stuck_at = 1000.0
    stage.flags.add("FS")


def interrupt(stage: Any) -> None:
    stage.go(2000.0)
    stage.flags.add("NI")


def slip(stage: Any) -> None:
    stage.go(2000.0)


def reset(stage: Any) -> None:
    stage.go(stage.position)
    stage.homed = False


MISHAPS: dict[str, tuple[Callable[[Any], None], str]] = {
    "it is stuck": (stick, "no progress for 0.3 s"),
    "it stalls": (stall, "FS: stalled and stopped"),
    "another program moves it": (interrupt, "NI: movement interrupted"),
    "it ends elsewhere": (slip, "ended at 1.000000 mm instead"),
    "it is switched off and on": (reset, "lost its reference on the way"),
}


@pytest.mark.parametrize("mishap", MISHAPS)
def test_a_motion_that_ends_elsewhere_fails(mishap: str, axis: Build) -> None:
    happen, says = MISHAPS[mishap]
    device, stage = axis()
    status = device.move_to(10.0)
    time.sleep(0.05)
    happen(stage)
    with pytest.raises(MotionError, match=says) as caught:
        status.wait(5)
    assert "array_stage: move to 10.000000 mm" in str(caught.value)
    assert len(motions(stage)) == 1


def test_a_stage_that_falls_silent_on_the_way_is_an_error_and_is_sent_a_stop(axis: Build) -> None:
    device, stage = axis()
    status = device.move_to(30.0)
    time.sleep(0.05)
    stage.fault = lambda _text, _reply: b""
    with pytest.raises(CommunicationError, match="no answer within"):
        status.wait(5)
    assert "stop" in stage.heard
    assert len(motions(stage)) == 1
    stage.fault = None
    assert device.reach() is not None
    device.move_to(0.0).wait(5)


def test_a_move_whose_reply_is_lost_is_stopped_and_not_repeated(axis: Build) -> None:
    device, stage = axis()
    stage.fault = lambda text, reply: b"" if text.startswith("move") else reply
    with pytest.raises(CommunicationError, match="asked 'move rel 60000'"):
        device.move_to(30.0)
    assert motions(stage) == ["move rel 60000"]
    assert stage.heard[-2:] == ["stop", ""]
    assert not stage.busy
    stage.fault = None
    device.move_to(1.0).wait(5)


class CarelessOnTheWay(ZaberAxis):
    """A driver that fails as nobody foresaw when it is asked where it is, and when it has told a
    stop.
    """

    def position(self) -> float:
        raise ZeroDivisionError("on the way")

    def stop(self) -> None:
        super().stop()
        raise ZeroDivisionError("as it was stopped")


class CarelessAtStart(CarelessOnTheWay):
    """The same, when it has told a motion."""

    def start_move(self, position: float) -> None:
        super().start_move(position)
        raise ZeroDivisionError("as it started")


@pytest.mark.parametrize(
    ("driver", "says"), [(CarelessAtStart, "as it started"), (CarelessOnTheWay, "on the way")]
)
def test_a_driver_that_fails_as_nobody_foresaw_is_told_to_stop_and_who_waits_is_told_why(
    driver: type[ZaberAxis], says: str, axis: Build
) -> None:
    device, stage = axis(driver=driver)
    with pytest.raises(ZeroDivisionError, match=says):
        device.move_to(30.0).wait(5)
    assert "stop" in stage.heard
    assert not stage.busy


def test_a_line_that_is_lost_on_the_way_is_opened_anew_for_the_stop(axis: Build) -> None:
    device, stage = axis()
    status = device.move_to(30.0)
    time.sleep(0.05)
    stage.hang_ups = 2
    with pytest.raises(CommunicationError, match="the connection is gone"):
        status.wait(5)
    assert "stop" in stage.heard
    assert not stage.busy


def test_a_single_torn_answer_does_not_end_a_motion(axis: Build) -> None:
    device, stage = axis()
    torn = iter([True])
    status = device.move_to(5.0)
    stage.fault = lambda _text, reply: reply[:7] + b"\r\n" if next(torn, False) else reply
    status.wait(5)
    assert stage.position == 10000


def test_closing_in_the_middle_of_a_motion_stops_it_and_leaves_no_thread(axis: Build) -> None:
    device, stage = axis()
    status = device.move_to(30.0)
    device.close()
    assert isinstance(status.exception(), MotionError)
    assert not stage.busy
    with pytest.raises(DeviceError, match="after the bench was closed"):
        device.move_to(1.0)


def test_waiting_for_several_tells_of_every_failure(axis: Build) -> None:
    one, first = axis()
    two, second = axis()
    statuses = one.move_to(10.0), two.move_to(10.0)
    time.sleep(0.05)
    slip(first)
    slip(second)
    with pytest.raises(DeviceError) as caught:
        wait_all(*statuses, timeout=5)
    assert str(caught.value).count("ended at") == 2

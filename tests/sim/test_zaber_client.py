"""The vendor's client drives the simulated chain over TCP and over a pseudo terminal."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from zaber_motion import CommandFailedException, MovementInterruptedException
from zaber_motion.ascii import Axis, Connection, WarningFlags
from zaber_motion.exceptions import BadCommandException, BadDataException

from sim.server import PtyLine, TcpLine

MICROSTEP = 0.00049609375  # mm
END = 302362  # 150 mm / microstep


@pytest.fixture(params=["tcp", "pty"] if os.name == "posix" else ["tcp"])
def connection(request: pytest.FixtureRequest) -> Iterator[Connection]:
    if request.param == "tcp":
        line: TcpLine | PtyLine = request.getfixturevalue("tcp_chain")
        host, port = line.address.split(":")
        opened = Connection.open_tcp(host, int(port))
    else:
        line = request.getfixturevalue("pty_chain")
        opened = Connection.open_serial_port(line.address)
    with opened:
        yield opened


@pytest.fixture
def axis(connection: Connection) -> Axis:
    return connection.get_device(1).get_axis(1)


def test_detects_both_devices(connection: Connection) -> None:
    assert [
        device.device_address for device in connection.detect_devices(identify_devices=False)
    ] == [1, 2]


def test_identifying_settings_are_there(connection: Connection) -> None:
    device = connection.get_device(2)
    for name in (
        "deviceid",
        "version",
        "version.build",
        "system.serial",
        "device.hw.modified",
        "system.axiscount",
    ):
        assert device.settings.get(name) >= 0
    assert device.settings.get("system.axiscount") == 1
    assert device.get_axis(1).settings.get("resolution") == 64
    assert device.get_axis(1).settings.get("peripheralid") == 0


def test_homing_gives_the_reference_it_lacks_at_power_up(axis: Axis) -> None:
    assert not axis.is_homed()
    assert axis.warnings.get_flags() == {WarningFlags.NO_REFERENCE_POSITION}
    axis.home()
    assert axis.is_homed()
    assert axis.warnings.get_flags() == set()
    assert axis.get_position() == 0


def test_moves_and_reads_where_it_is(axis: Axis) -> None:
    axis.home()
    axis.move_absolute(100_000)
    assert axis.get_position() == 100_000
    axis.move_relative(-2_500)
    assert axis.get_position() == 97_500
    axis.move_max()
    assert axis.get_position() == END
    axis.move_min()
    assert axis.get_position() == 0


def test_runs_and_stops(axis: Axis) -> None:
    axis.home()
    axis.settings.set("maxspeed", 500)
    axis.move_velocity(400)
    assert axis.is_busy()
    axis.stop()
    assert not axis.is_busy()
    assert 0 < axis.get_position() < END


def test_refuses_a_target_out_of_range_and_does_not_move(axis: Axis) -> None:
    axis.home()
    with pytest.raises(BadDataException):
        axis.move_absolute(END + 1)
    with pytest.raises(BadDataException):
        axis.move_relative(-1)
    assert axis.get_position() == 0


def test_refuses_what_it_does_not_know(connection: Connection) -> None:
    with pytest.raises(BadCommandException):
        connection.get_device(1).generic_command("dance")
    with pytest.raises(BadCommandException):
        connection.get_device(1).get_axis(1).settings.get("encoder.pos")


def test_a_parked_axis_refuses_to_move(axis: Axis) -> None:
    axis.home()
    axis.park()
    assert axis.is_parked()
    with pytest.raises(CommandFailedException, match=r"(?i)parked"):
        axis.move_absolute(1000)
    axis.unpark()
    axis.move_absolute(1000)
    assert axis.get_position() == 1000


def test_a_new_command_interrupts_the_one_under_way(connection: Connection, axis: Axis) -> None:
    axis.home()
    with ThreadPoolExecutor(1) as elsewhere:
        moving = elsewhere.submit(axis.move_absolute, END, velocity=300)
        while not axis.is_busy():
            pass
        axis.generic_command("move abs 1000")
        with pytest.raises(MovementInterruptedException):
            moving.result(10)
    axis.wait_until_idle()
    assert axis.get_position() == 1000


def test_settings_are_kept_and_refused_outside_their_range(axis: Axis) -> None:
    axis.settings.set("maxspeed", 104_858)
    assert axis.settings.get("maxspeed") == 104_858
    with pytest.raises(BadDataException):
        axis.settings.set("maxspeed", 64 * 16384 + 1)


def test_broadcast_homes_every_axis(connection: Connection) -> None:
    replies = connection.generic_command_multi_response("home")
    assert [reply.device_address for reply in replies] == [1, 2]
    for number in (1, 2):
        connection.get_device(number).get_axis(1).wait_until_idle()
        assert connection.get_device(number).get_axis(1).is_homed()

"""An independent Modbus client drives the simulated drives over a pseudo terminal; published
messages byte for byte.
"""

import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import minimalmodbus
import pytest
import serial

from sim.clock import Clock, RunningClock, SteppedClock
from sim.faults import Fault, Faults
from sim.oriental import Drive, Line, LineSession, Wiring, crc
from sim.server import PtyLine, TcpLine
from sim.stage import Stage
from sim.world import Carriage

STEP = 3.5e-5  # rad, 500 steps a degree
TURN = 180_000  # steps
READY, ALARM, MOVE = 1 << 5, 1 << 7, 1 << 13


def drive(clock: Clock, *faults: Fault, wrap: bool = False) -> Drive:
    """A table that stands 4000 steps from its home sensor and turns 20,000 steps either way."""
    ends = (-400.0, 400.0) if wrap else (-20_000 * STEP, 20_000 * STEP)
    stage = Stage(Carriage(clock, 4000 * STEP), ends, STEP, 5000, 25_000, home=0.0)
    return Drive(stage, Faults(faults), Wiring(), TURN, wrap=wrap)


def line_of(clock: Clock, *faults: Fault) -> Line:
    return Line({1: drive(clock, *faults), 2: drive(clock, wrap=True)}, threading.RLock())


def lines() -> list[Any]:
    no_pty = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo terminals")
    return [
        pytest.param(PtyLine, id="pty", marks=no_pty),
        pytest.param(TcpLine, id="tcp", marks=pytest.mark.ci),
    ]


@pytest.fixture(params=lines())
def slaves(request: pytest.FixtureRequest) -> Iterator[list[Any]]:
    line = line_of(RunningClock(50))
    server: PtyLine | TcpLine = request.param(lambda: LineSession(line))
    port = serial.serial_for_url(
        server.address if isinstance(server, PtyLine) else f"socket://{server.address}", timeout=0.3
    )
    clients: list[Any] = [minimalmodbus.Instrument(port, number) for number in (1, 2)]
    yield clients
    port.close()
    server.stop()


def home(slave: Any) -> None:
    slave.write_register(0x007D, 1 << 4, functioncode=6)
    slave.write_register(0x007D, 0, functioncode=6)
    while slave.read_register(0x007F) & MOVE:
        time.sleep(0.01)


def operate(slave: Any, kind: int, position: int, speed: int = 5000) -> None:
    values = (0, kind, position, speed, 25_000, 25_000, 1000, 1)
    slave.write_registers(
        0x0058, [word for value in values for word in ((value >> 16) & 0xFFFF, value & 0xFFFF)]
    )


def arrive(slave: Any) -> int:
    while slave.read_register(0x007F) & MOVE:
        time.sleep(0.01)
    return slave.read_long(0x00CC, signed=True)


def test_two_slaves_of_one_line_home_and_move(slaves: list[Any]) -> None:
    for slave in slaves:
        assert not slave.read_register(0x0178) & 2
        home(slave)
        assert slave.read_register(0x0178) & 2
        assert slave.read_register(0x007F) & (READY | ALARM) == READY
    operate(slaves[0], 1, -8333)
    operate(slaves[1], 8, 12_345)
    assert arrive(slaves[0]) == -8333
    assert arrive(slaves[1]) == 12_345
    assert slaves[0].read_long(0x00C6, signed=True) == -8333


def test_wrapped_positions_stay_within_half_a_turn_and_the_shortest_way_is_taken(
    slaves: list[Any],
) -> None:
    table = slaves[1]
    home(table)
    operate(table, 8, 85_000, speed=100_000)
    assert arrive(table) == 85_000
    operate(table, 9, -85_000, speed=100_000)  # 10,000 steps on, over the end of the range
    assert arrive(table) == -85_000
    assert table.read_long(0x0120, signed=True) == 95_000


def test_a_stop_ends_a_move_on_the_way(slaves: list[Any]) -> None:
    slave = slaves[0]
    home(slave)
    operate(slave, 1, 15_000, speed=500)
    assert slave.read_register(0x007F) & MOVE
    operate(slave, 1, -15_000)  # acknowledged, and let be
    slave.write_register(0x007D, 1 << 5, functioncode=6)
    assert 0 <= arrive(slave) < 15_000
    assert not slave.read_register(0x007F) & READY  # as long as the stop input is on
    slave.write_register(0x007D, 0, functioncode=6)
    assert slave.read_register(0x007F) & READY


@pytest.mark.parametrize(
    ("kind", "position", "speed", "homed", "alarm"),
    [
        (1, 100, 5000, False, 0x4A),
        (1, 100, 0, True, 0x70),
        (8, 100, 5000, True, 0x70),
        (1, 25_000, 5000, True, 0x67),
    ],
    ids=["without reference", "speed zero", "wrap type without wrap", "beyond its limit"],
)
def test_what_a_drive_cannot_carry_out_raises_the_manuals_alarm(
    kind: int, position: int, speed: int, homed: bool, alarm: int, slaves: list[Any]
) -> None:
    slave = slaves[0]
    if homed:
        home(slave)
    operate(slave, kind, position, speed)
    assert slave.read_long(0x0080) == alarm
    assert slave.read_register(0x007F) & (READY | ALARM) == ALARM
    operate(slave, 2, 10)
    assert not slave.read_register(0x007F) & MOVE
    slave.write_register(0x007D, 1 << 7, functioncode=6)
    assert slave.read_long(0x0080) == 0


def test_an_unknown_register_is_an_exception_and_an_absent_slave_is_silent(
    slaves: list[Any],
) -> None:
    with pytest.raises(minimalmodbus.IllegalRequestError, match="address"):
        slaves[0].read_register(0x7000)
    with pytest.raises(minimalmodbus.NoResponseError):
        minimalmodbus.Instrument(slaves[0].serial, 3).read_register(0x007F)


@pytest.mark.parametrize(("first", "count"), [(0x00C6, 12), (0x00F8, 8), (0x0080, 22)])
def test_blocks_of_monitors_that_public_programs_read_are_answered(
    first: int, count: int, slaves: list[Any]
) -> None:
    home(slaves[0])
    operate(slaves[0], 1, 5000, speed=50_000)
    words = slaves[0].read_registers(first, count)
    assert len(words) == count
    arrive(slaves[0])
    if first == 0x00C6:
        position = slaves[0].read_registers(first, count)
        assert position[1] == position[7] == 5000
        assert position[4:6] == position[10:12] == [0, 0]  # at rest


def test_a_speed_that_no_drive_does_is_taken_and_raises_the_manuals_alarm(
    slaves: list[Any],
) -> None:
    slave = slaves[0]
    home(slave)
    operate(slave, 1, 100, speed=4_000_001)
    assert slave.read_long(0x0080) == 0x70


def test_published_messages_get_the_published_answers() -> None:
    """An absolute move and a read as public drivers of these drives send them."""
    move = bytes.fromhex(
        "01100058001020 00000000 00000001 FFFEBA7B 0000B64B 000F4240 000F4240 000003E8 00000001"
        " 4803"
    )
    session = LineSession(line_of(SteppedClock()))
    assert session.receive(move[:9]) == b""
    assert session.receive(move[9:]).hex() == "0110005800104016"
    answer = session.receive(bytes.fromhex("010300CC00020434"))
    assert (answer[:3].hex(), answer[-2:]) == ("010304", crc(answer[:-2]))


def test_a_message_with_a_wrong_crc_is_not_heard() -> None:
    session = LineSession(line_of(SteppedClock()))
    assert session.receive(bytes.fromhex("010300CC00020435")) == b""
    assert session.receive(bytes.fromhex("010300CC00020434")) != b""


def test_a_pause_ends_an_incomplete_message() -> None:
    session = LineSession(line_of(SteppedClock()))
    assert session.receive(bytes.fromhex("010300CC")) == b""
    time.sleep(0.06)
    assert session.receive(bytes.fromhex("010300CC00020434")) != b""


def test_everyone_does_a_broadcast_and_nobody_answers() -> None:
    clock = SteppedClock()
    line = line_of(clock)
    body = bytes.fromhex("0006007D0010")
    assert LineSession(line).receive(body + crc(body)) == b""
    assert all(one.stage.busy() for one in line.drives.values())
    clock.step(10)
    assert [one.stage.position() for one in line.drives.values()] == [0, 0]


def test_an_absolute_encoder_knows_its_position_after_a_loss_of_power() -> None:
    clock = SteppedClock()
    line = line_of(clock, Fault("reset", after=3))
    session = LineSession(line)
    for body in ("0106007D0010", "0106007D0000"):
        session.receive(bytes.fromhex(body) + crc(bytes.fromhex(body)))
    clock.step(10)
    answers = [
        session.receive(bytes.fromhex("010301780002") + crc(bytes.fromhex("010301780002")))
        for _ in range(2)
    ]
    assert [answer[4] & 2 for answer in answers] == [2, 2]

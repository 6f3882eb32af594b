# longer than 450 lines because one driver's sentences of behaviour stand together
"""The Oriental Motor driver on an independent Modbus server whose registers are written here, from
the manual's numbers.
"""

import asyncio
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pymodbus import FramerType, ModbusException
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.modbus import ModbusLine, from_words, make_client, to_words
from drivers.oriental import OrientalAxis, OrientalKeys
from flflab.errors import CommunicationError, DeviceError, LimitError

DEGREE = math.pi / 180
STEPS = 100  # a degree


class Motor:
    """One slave: a motor that turns at constant speed in real time, and can be deaf, alarmed or not
    ready.
    """

    def __init__(self) -> None:
        self.start = self.end = 700
        self.since, self.speed = 0.0, 1.0
        self.homed = self.alarm = 0
        self.deaf = self.not_ready = False
        self.operations: list[tuple[int, ...]] = []
        self.inputs: list[int] = []

    @property
    def position(self) -> int:
        way = round((time.monotonic() - self.since) * self.speed)
        return (
            self.end
            if way >= abs(self.end - self.start)
            else self.start + (way if self.end > self.start else -way)
        )

    @property
    def moving(self) -> bool:
        return self.position != self.end

    def go(self, end: int, speed: float) -> None:
        self.start, self.end, self.since, self.speed = self.position, end, time.monotonic(), speed

    def outputs(self) -> int:
        stopped = self.inputs and self.inputs[-1] >> 5 & 1
        ready = not (self.moving or self.alarm or self.not_ready or stopped)
        return ready << 5 | bool(self.alarm) << 7 | self.moving << 13

    async def access(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        if address >= 0x0300 and address not in (0x0386, 0x0388, 0x038A):
            return ExcCodes.ILLEGAL_ADDRESS
        if values is not None:
            words = [int(value) for value in values]
            signed = [(words[at] << 16 | words[at + 1] & 0xFFFF) for at in range(0, len(words), 2)]
            signed = [value - 2**32 if value >= 2**31 else value for value in signed]
            if address == 0x0058:
                self.operations.append(tuple(signed))
                if not self.deaf and not self.alarm:
                    self.go(signed[2], signed[3])
            elif address == 0x007C:
                self.inputs.append(signed[0])
                if signed[0] >> 5 & 1:
                    self.start = self.end = self.position
                if signed[0] >> 4 & 1 and not self.deaf:
                    self.go(0, 10_000)
                    self.homed = 1
            return None
        known = {
            0x007E: self.outputs(), 0x0080: self.alarm, 0x00C6: self.position,
            0x00CC: self.position, 0x0178: self.homed << 17,
            0x0386: 1, 0x0388: 20 * STEPS, 0x038A: -20 * STEPS,
        }  # fmt: skip
        value = known[address]
        registers[address - start : address - start + 2] = [value >> 16 & 0xFFFF, value & 0xFFFF]
        return None


Motors = tuple[str, dict[int, Motor]]
Axes = tuple[OrientalAxis, OrientalAxis, dict[int, Motor]]
Open = Callable[[str], ModbusLine]


@pytest.fixture
def motors() -> Iterator[Motors]:
    """Slaves 1 and 2 of one line, served by another library."""
    slaves = {1: Motor(), 2: Motor()}
    block = [SimData(0, count=0x0400, datatype=DataType.REGISTERS)]
    begun, address = threading.Event(), list[str]()
    loop = asyncio.new_event_loop()

    async def serve() -> None:
        devices = [
            SimDevice(id=number, simdata=block, action=motor.access)
            for number, motor in slaves.items()
        ]
        server = ModbusTcpServer(devices, framer=FramerType.RTU, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        assert isinstance(server.transport, asyncio.Server)
        address.append("{}:{}".format(*server.transport.sockets[0].getsockname()))
        begun.set()
        ended = asyncio.Event()
        stop.append(lambda: loop.call_soon_threadsafe(ended.set))
        await ended.wait()
        await server.shutdown()

    stop: list[Callable[[], object]] = []
    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()))
    thread.start()
    assert begun.wait(10)
    yield address[0], slaves
    while not stop:
        time.sleep(0.01)
    stop[0]()
    thread.join()
    loop.close()


@pytest.fixture
def line() -> Iterator[Open]:
    lines: list[ModbusLine] = []

    def open_line(address: str) -> ModbusLine:
        keys = OrientalKeys(device=1, steps_per_degree=STEPS, timeout=0.3)
        lines.append(
            ModbusLine(
                lambda: make_client(address, keys.baud, keys.parity, keys.timeout), address, 0.1
            )
        )
        return lines[-1]

    yield open_line
    for one in lines:
        one.close()


@pytest.fixture
def axes(motors: Motors, line: Open) -> Axes:
    address, slaves = motors
    shared = line(address)
    made = [
        OrientalAxis(
            f"axis {n}",
            shared,
            OrientalKeys(device=n, steps_per_degree=STEPS, timeout=0.3),
            90 * DEGREE,
        )
        for n in slaves
    ]
    return made[0], made[1], slaves


def rested(axis: OrientalAxis) -> None:
    deadline = time.monotonic() + 5
    while axis.is_busy():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@given(st.integers(-(2**31), 2**31 - 1))
def test_every_value_survives_its_two_registers(value: int) -> None:
    assert from_words(*to_words([value])) == value


def test_the_published_example_of_a_negative_value() -> None:
    assert to_words([-1000]) == [0xFFFF, 0xFC18]


def test_connecting_moves_nothing_and_reads_the_limits(axes: Axes) -> None:
    first, _, slaves = axes
    assert first.travel == pytest.approx((-20 * DEGREE, 20 * DEGREE))
    assert first.position() == pytest.approx(7 * DEGREE)
    assert not first.is_homed()
    assert all(motor.operations == motor.inputs == [] for motor in slaves.values())


def test_two_drives_of_one_line_home_and_move_each_for_itself(axes: Axes) -> None:
    first, second, slaves = axes
    for axis in (first, second):
        axis.start_home()
        rested(axis)
        assert axis.is_homed()
        assert axis.position() == 0
    first.start_move(3.456789 * DEGREE)
    second.start_move(-2 * DEGREE)
    rested(first)
    rested(second)
    assert first.position() == pytest.approx(3.46 * DEGREE)
    assert second.position() == pytest.approx(-2 * DEGREE)
    assert slaves[1].operations == [(0, 1, 346, 9000, 45_000, 45_000, 1000, 1)]
    assert slaves[1].inputs == [1 << 4, 0]


def test_wrap_mode_asks_for_a_place_within_the_wrap_range(motors: Motors, line: Open) -> None:
    address, slaves = motors
    ring = OrientalAxis(
        "ring",
        line(address),
        OrientalKeys(device=2, steps_per_degree=STEPS, wrap=True, timeout=0.3),
        DEGREE * 90,
    )
    ring.start_move(DEGREE)
    assert slaves[2].operations[0][:3] == (0, 8, 100)


def test_a_command_that_is_acknowledged_and_then_ignored_is_noticed(axes: Axes) -> None:
    axis, _, slaves = axes
    slaves[1].deaf = True
    with pytest.raises(
        DeviceError,
        match=r"axis 1: asked to move to 5\.000000 deg, the drive acknowledged and did nothing",
    ) as caught:
        axis.start_move(5 * DEGREE)
    assert "\n" not in str(caught.value)
    assert slaves[1].inputs == [1 << 5, 0], "it was not told to stop"
    with pytest.raises(
        DeviceError, match="look for its reference, the drive acknowledged and did nothing"
    ):
        axis.start_home()


def test_a_drive_that_is_not_ready_is_told_nothing(axes: Axes) -> None:
    axis, _, slaves = axes
    slaves[1].not_ready = True
    with pytest.raises(DeviceError, match="its drive is not ready"):
        axis.start_move(DEGREE)
    assert slaves[1].operations == []


def test_a_drive_that_did_not_hear_the_end_of_a_stop_can_be_used_again(axes: Axes) -> None:
    axis, _, slaves = axes
    slaves[1].inputs.append(1 << 5)
    axis.start_home()
    rested(axis)
    assert axis.is_homed()


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x4A, "before it has a reference; home it"), (0x30, "overload"), (0x99, "alarm 99")],
)
def test_an_alarm_is_a_sentence(code: int, words: str, axes: Axes) -> None:
    axis, _, slaves = axes
    slaves[1].alarm = code
    with pytest.raises(DeviceError, match=words):
        axis.start_move(DEGREE)
    assert any(words in phrase for phrase in axis.warnings())
    assert slaves[1].operations == []


def test_a_stop_goes_before_all_who_wait_for_the_line(axes: Axes) -> None:
    first, second, _ = axes
    first.start_home()
    rested(first)
    first.start_move(15 * DEGREE)
    over = threading.Event()

    def keep_asking() -> None:
        while not over.is_set():
            second.position()

    askers = [threading.Thread(target=keep_asking) for _ in range(4)]
    for asker in askers:
        asker.start()
    first.stop()
    over.set()
    for asker in askers:
        asker.join()
    assert not first.is_busy()
    assert 0 <= first.position() < 15 * DEGREE


def test_more_steps_than_the_drive_can_count_are_refused(axes: Axes) -> None:
    with pytest.raises(LimitError, match="more than the drive can count"):
        axes[0].start_move(1e9)


@pytest.mark.parametrize(
    ("speed", "ramp", "sentence"),
    [
        (
            1e-3,
            "0.2 s",
            (
                r"tilt: asked for 0\.001 deg/s, 0 steps/s of a drive that does 1 to 4000000;"
                r" correct `speed` or"
            ),
        ),
        (1e9, "0.2 s", r"tilt: asked for 1e\+09 deg/s, 100000000000 steps/s of a drive"),
        (40_001.0, "0.2 s", r"tilt: asked for 40001 deg/s, 4000100 steps/s of a drive that"),
        (
            10.0,
            "100 ns",
            (
                r"tilt: asked to reach its speed in 1e-07 s, 10000000000 steps/s\^2 of a drive .*;"
                r" correct `ramp`"
            ),
        ),
    ],
)
def test_a_speed_or_ramp_that_a_drive_cannot_be_told_is_refused(
    speed: float, ramp: str, sentence: str, dialogue: Callable[..., str], line: Open
) -> None:
    keys = OrientalKeys.model_validate({"device": 1, "steps_per_degree": STEPS, "ramp": ramp})
    with pytest.raises(DeviceError, match=sentence):
        OrientalAxis("tilt", line(dialogue([])), keys, speed * DEGREE)


@pytest.mark.parametrize(
    "bits", [{"stop_input": 4}, {"home_input": 5}, {"ready_output": 7}, {"moving_output": 5}]
)
def test_two_signals_on_one_bit_are_refused(bits: dict[str, int]) -> None:
    """A stop that is the start of a homing would be none."""
    with pytest.raises(ValidationError, match="a bit of its own"):
        OrientalKeys.model_validate({"device": 1, "steps_per_degree": STEPS, **bits})


def test_a_line_that_was_let_go_of_while_somebody_asks_is_not_opened_anew() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = make_client(f"127.0.0.1:{server.getsockname()[1]}", 115200, "E", 0.5)
        assert client.connect()
        client.close()
        with pytest.raises(ModbusException):
            client.read_holding_registers(0x00CC, count=2, device_id=1)
        assert not client.connected


def test_an_absent_slave_is_named_with_what_to_look_at(
    dialogue: Callable[..., str], line: Open
) -> None:
    asked = request(0x0386, slave=9)
    address = dialogue([(asked, b""), (request(0x00C6, slave=9, count=3), b"")])
    with pytest.raises(
        CommunicationError,
        match=r"lost \(slave 9\): .* check cable, parity, slave number and power",
    ):
        OrientalAxis(
            "lost",
            line(address),
            OrientalKeys(device=9, steps_per_degree=STEPS, timeout=0.3),
            DEGREE,
        )


def test_nobody_listening_is_said(line: Open) -> None:
    with pytest.raises(
        CommunicationError,
        match=r"127\.0\.0\.1:9: cannot be reached; check power, network and address",
    ):
        line("127.0.0.1:9")


@pytest.mark.parametrize(
    "answer",
    ["010304000002bcfa", "020304000002bc", "010302000078", "0103040000", "7f4b233f"],
    ids=["wrong crc", "other slave", "too few registers", "half", "noise"],
)
def test_an_answer_that_is_not_right_is_never_a_position(
    answer: str, dialogue: Callable[..., str], line: Open
) -> None:
    """Each of two tries is answered wrongly; frames that need one get a right CRC, so only what is
    wrong is wrong.
    """
    body = bytes.fromhex(answer)
    framed = body + crc(body) if answer in ("020304000002bc", "010302000078") else body
    asked = request(0x00CC)
    address = dialogue(
        [
            (request(0x0386), read_reply(0xFFFFFFFF)),
            (asked, framed),
            in_step(3),
            (asked, framed),
        ]
    )
    axis = OrientalAxis(
        "tilt", line(address), OrientalKeys(device=1, steps_per_degree=STEPS, timeout=0.3), DEGREE
    )
    with pytest.raises(CommunicationError, match=r"tilt \(slave 1\)"):
        axis.position()


@pytest.mark.parametrize("delay", [0.05, 0.4], ids=["twice", "late"])
def test_an_answer_that_comes_again_or_late_is_not_taken_for_the_next(
    delay: float, line: Open
) -> None:
    """The second answer to the limits' question comes when the position is asked for; late: the
    first one comes too late.
    """
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            link, _ = server.accept()
            assert link.recv(8) == request(0x0386)
            if delay < 0.3:
                link.sendall(read_reply(0xFFFFFFFF))
            time.sleep(delay)
            link.sendall(read_reply(0xFFFFFFFF))
            if delay > 0.3:
                link.close()
                link, _ = server.accept()
                link.sendall(read_reply(0xFFFFFFFF))
                assert link.recv(8) == in_step(3)[0]
                link.sendall(in_step(3)[1])
                assert link.recv(8) == request(0x0386)
                link.sendall(read_reply(0xFFFFFFFF))
            assert link.recv(8) == request(0x00CC)
            link.sendall(read_reply(1234))
            link.close()

        peer = threading.Thread(target=answer)
        peer.start()
        axis = OrientalAxis(
            "tilt",
            line("{}:{}".format(*server.getsockname())),
            OrientalKeys(device=1, steps_per_degree=STEPS),
            DEGREE,
        )
        time.sleep(0.1)
        assert axis.position() == pytest.approx(12.34 * DEGREE)
        peer.join()


def crc(body: bytes) -> bytes:
    """CRC-16/MODBUS bit by bit."""
    rest = 0xFFFF
    for byte in body:
        for bit in range(8):
            odd = (rest ^ byte >> bit) & 1
            rest = rest >> 1 ^ 0xA001 * odd
    return bytes((rest & 0xFF, rest >> 8))


def request(register: int, slave: int = 1, count: int = 2) -> bytes:
    body = bytes((slave, 3, register >> 8, register & 0xFF, 0, count))
    return body + crc(body)


def in_step(count: int) -> tuple[bytes, bytes]:
    """What is asked after a fault to know that earlier answers have come, and its answer."""
    body = bytes((1, 3, 2 * count)) + bytes(2 * count)
    return request(0x00C6, count=count), body + crc(body)


def read_reply(value: int) -> bytes:
    body = bytes((1, 3, 4)) + value.to_bytes(4, "big")
    return body + crc(body)

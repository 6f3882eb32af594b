"""Lines as they are in laboratories: adapters that hand back what is sent, bytes that come one by
one, controllers that name themselves otherwise, addresses that are none.
"""

import contextlib
import math
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from pymodbus.framer.rtu import FramerRTU

from drivers.modbus import Echo, ModbusLine, make_client
from drivers.oriental import OrientalAxis, OrientalKeys
from drivers.places import ximc_place
from drivers.thorlabs import AptLink, ThorlabsAxis, ThorlabsKeys
from drivers.transport import (
    Wire,
    open_serial,
    open_tcp,
    real_number,
    serial_place,
    whole_number,
)
from drivers.zaber import ZaberAxis, ZaberChain, ZaberKeys
from flflab.errors import CommunicationError, DeviceError, InputError
from sim.clock import RunningClock
from sim.faults import Faults
from sim.oriental import Drive, Line, LineSession, Wiring
from sim.server import TcpLine
from sim.stage import Stage
from sim.thorlabs import COUNT, COUNTS_PER_DEGREE, Controller, ControllerSession
from sim.world import Carriage

Alter = Callable[[bytes], Iterator[bytes]]
KEYS = ZaberKeys.model_validate({"device": 1, "microstep": "1 um"})


class Adapter:
    """A line to an instrument that does something to the bytes on their way.

    Args:
        upstream: the instrument's address.
        to_host: what becomes of the bytes that the instrument sends.
        echo: whether the host hears what it sends.
    """

    def __init__(self, upstream: str, to_host: Alter, *, echo: bool = False) -> None:
        self._upstream, self._to_host, self._echo = upstream, to_host, echo
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._over = threading.Event()
        self._threads = [threading.Thread(target=self._serve)]
        self._threads[0].start()

    def _serve(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(TimeoutError):
                host, _ = self._server.accept()
                line, port = self._upstream.rsplit(":", 1)
                instrument = socket.create_connection((line, int(port)))
                for one in (host, instrument):
                    one.settimeout(0.05)
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                for ends in ((host, instrument, True), (instrument, host, False)):
                    self._threads.append(threading.Thread(target=self._pass, args=ends))
                    self._threads[-1].start()

    def _pass(self, source: socket.socket, sink: socket.socket, from_host: bool) -> None:
        with source, contextlib.suppress(OSError):
            while not self._over.is_set():
                try:
                    come = source.recv(4096)
                except TimeoutError:
                    continue
                if not come:
                    break
                if from_host and self._echo:
                    source.sendall(come)
                for piece in (come,) if from_host else self._to_host(come):
                    sink.sendall(piece)
            sink.shutdown(socket.SHUT_WR)

    def end(self) -> None:
        self._over.set()
        for thread in list(self._threads):
            thread.join()
        self._server.close()


def as_it_is(come: bytes) -> Iterator[bytes]:
    yield come


def one_by_one(come: bytes) -> Iterator[bytes]:
    """A byte every 10 ms: an answer takes longer than its time-out."""
    for byte in come:
        time.sleep(0.01)
        yield bytes((byte,))


def source_zero(come: bytes) -> Iterator[bytes]:
    """APT messages in the name of 0x00, to 0x00, as a TDC001 was reported to send them."""
    while come:
        size = 6 + (struct.unpack_from("<H", come, 2)[0] if come[4] & 0x80 else 0)
        yield come[:4] + bytes((come[4] & 0x80, 0)) + come[6:size]
        come = come[size:]


@pytest.fixture
def adapter() -> Iterator[Callable[..., str]]:
    adapters: list[Adapter] = []

    def start(upstream: str, to_host: Alter = as_it_is, *, echo: bool = False) -> str:
        adapters.append(Adapter(upstream, to_host, echo=echo))
        return adapters[-1].address

    yield start
    for one in adapters:
        one.end()


@pytest.fixture
def cube() -> Iterator[str]:
    """A simulated KDC101, at 20 degrees."""
    per_degree = COUNTS_PER_DEGREE
    carriage = Carriage(RunningClock(50), 20 * per_degree * COUNT)
    stage = Stage(carriage, (-250.0, 250.0), COUNT, 10 * per_degree, 50 * per_degree, home=0.0)
    controller = Controller(stage, Faults(()), 27_000_001, threading.RLock())
    line = TcpLine(lambda: ControllerSession(controller))
    yield line.address
    line.stop()


@pytest.fixture
def drives() -> Iterator[str]:
    """Two simulated AZ drives on one line."""
    clock, step = RunningClock(50), 3.5e-5

    def drive() -> Drive:
        ends = (-20_000 * step, 20_000 * step)
        stage = Stage(Carriage(clock, 4000 * step), ends, step, 5000, 25_000, home=0.0)
        return Drive(stage, Faults(()), Wiring(), 180_000)

    bus = Line({1: drive(), 2: drive()}, threading.RLock())
    line = TcpLine(lambda: LineSession(bus))
    yield line.address
    line.stop()


def wait(axis: ThorlabsAxis | OrientalAxis) -> None:
    deadline = time.monotonic() + 20
    while axis.is_busy():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("to_host", "echo"),
    [(source_zero, False), (one_by_one, False), (as_it_is, True), (source_zero, True)],
    ids=["source 0x00", "byte by byte", "echo", "source 0x00 and echo"],
)
def test_a_controller_is_talked_to_whatever_its_line_does(
    to_host: Alter, echo: bool, cube: str, adapter: Callable[..., str]
) -> None:
    address = adapter(cube, to_host, echo=echo)
    link = AptLink(lambda: open_serial(address, 115200), 0.2)
    axis = ThorlabsAxis("tilt", link, ThorlabsKeys(timeout=0.2), math.radians(10))
    assert "serial 27000001" in axis.identity()
    axis.start_home()
    wait(axis)
    assert axis.is_homed()
    axis.start_move(math.radians(3))
    wait(axis)
    assert axis.position() == pytest.approx(math.radians(3), abs=2 * COUNT)
    axis.stop()
    link.close()


def test_an_adapter_that_echoes_is_found_out_and_said_once(
    drives: str, adapter: Callable[..., str], capfd: pytest.CaptureFixture[str]
) -> None:
    address = adapter(drives, echo=True)
    bus = ModbusLine(lambda: make_client(address, 115200, "N", 0.5), address, 0.5)
    for slave in (1, 2):
        keys = OrientalKeys(device=slave, steps_per_degree=500)
        axis = OrientalAxis("tilt", bus, keys, math.radians(10))
        axis.start_home()
        wait(axis)
        axis.start_move(math.radians(2))
        wait(axis)
        assert axis.position() == pytest.approx(math.radians(2), abs=1e-4)
        axis.stop()
    bus.close()
    said = capfd.readouterr().err
    assert said == (
        f"flflab: {address}: its adapter hands back what is sent, which is passed over\n"
    )


@pytest.mark.parametrize("pieces", [(20,), (3, 5, 8, 13), (8, 9, 10, 11, 12, 20)])
def test_an_echo_that_comes_in_pieces_is_passed_over_with_nothing_of_the_answer(
    pieces: tuple[int, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    asked, answer = bytes.fromhex("010300cc00020434"), bytes.fromhex("01030400001388f6c1")
    echo = Echo("a line")
    assert echo.pass_over(True, asked) == asked
    come = [echo.pass_over(False, (asked + answer)[:size]) for size in pieces]
    assert come == [(asked + answer)[8:size] for size in pieces]
    assert echo.pass_over(True, asked) == asked
    assert echo.pass_over(False, answer) == answer
    assert "hands back what is sent" in capfd.readouterr().err or max(pieces) < 8


def test_a_chain_behind_an_adapter_that_echoes_byte_by_byte_is_talked_to(
    toy_stage: Callable[..., object], toy_chain: Callable[..., str], adapter: Callable[..., str]
) -> None:
    address = adapter(toy_chain(toy_stage()), one_by_one, echo=True)
    chain = ZaberChain(lambda: open_serial(address, 115200), timeout=0.15)
    axis = ZaberAxis("stage", chain, KEYS, 10.0, homes_up=False)
    assert axis.position() == 0.0
    axis.stop()
    chain.close()


def answering(adapter_bytes: Iterator[tuple[float, bytes]]) -> Wire:
    """A connection on which bytes come after so many seconds each."""

    def receive() -> bytes:
        seconds, more = next(adapter_bytes, (0.02, b""))
        time.sleep(seconds)
        return more

    return Wire("a line", len, receive, lambda: None)


def test_a_line_is_timed_from_its_last_byte_and_not_from_its_first() -> None:
    wire = answering(iter([(0.06, bytes((byte,))) for byte in b"@01 0 00 OK\n"]))
    assert wire.read_until(b"\n", 0.2) == b"@01 0 00 OK"


def test_a_line_that_never_ends_is_given_up_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.transport.LONGEST_S", 0.2)
    trickle = answering((0.02, b"1") for _ in range(10_000))
    with pytest.raises(CommunicationError, match=r"b'1+' came within 0\.3 s, and no end of it"):
        trickle.read_until(b"\n", 0.1)


@pytest.mark.parametrize(
    "address",
    [
        "spy:///dev/ttyUSB0?file=victim.txt", "spy://COM3?file=victim.txt", "loop://",
        "alt:///dev/ttyUSB0?class=PosixPollSerial", "hwgrep://.*", "cp2110://1",
        "file:///etc/passwd", "SPY:///dev/ttyUSB0", "socket://127.0.0.1:1?logging=debug",
        "rfc2217://127.0.0.1:1?logging=debug", "rfc2217://127.0.0.1", "$(touch pwned)", "COM3;id",
        "", " ", "ttyUSB0", "socket://", "127.0.0.1:0", "127.0.0.1:99999", "127.0.0.1:\uff11",
    ],
)  # fmt: skip
def test_an_address_of_no_known_kind_is_refused_before_anything_is_opened(
    address: str, tmp_path: object
) -> None:
    for use in (
        lambda: serial_place(address),
        lambda: open_serial(address, 9600),
        lambda: make_client(address, 9600, "N", 0.1),
    ):
        with pytest.raises(InputError, match="is not an address; give"):
            use()


def test_addresses_of_known_kinds_are_spelt_one_way() -> None:
    assert serial_place("socket://LocalHost:07000") == "127.0.0.1:7000"
    assert serial_place("com3") == serial_place(r"\\.\COM3") == "COM3"
    remote = "rfc2217://lab-server.invalid:4001?ign_set_control&timeout=3"
    assert serial_place(remote) == "lab-server.invalid:4001"
    assert serial_place("RFC2217://127.1:4001") == serial_place("rfc2217://localhost:4001")
    assert ximc_place("xi-net://localhost/000A") == ximc_place("xi-net://127.1/000A")
    assert ximc_place("xi-tcp://localhost:1820") == "xi-tcp://127.0.0.1:1820"
    assert ximc_place("xi-emu:///a/virtual.bin") == "xi-emu:///a/virtual.bin"


def test_why_a_port_cannot_be_opened_is_said_once() -> None:
    with pytest.raises(CommunicationError) as refusal:
        open_serial("/dev/no-such-port", 9600)
    assert str(refusal.value) == (
        "/dev/no-such-port: cannot be opened (No such file or directory); check the address, and"
        " who else holds it"
    )
    with pytest.raises(CommunicationError, match=r"cannot be reached \(Connection refused\);"):
        open_tcp("127.0.0.1:1")


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals there")
@pytest.mark.parametrize("by_modbus", [False, True])
def test_a_lock_that_a_child_holds_until_it_runs_its_own_program_is_waited_for(
    by_modbus: bool,
) -> None:
    import fcntl

    master, slave = os.openpty()
    fcntl.flock(slave, fcntl.LOCK_EX)
    letting_go = threading.Timer(0.1, os.close, (slave,))
    letting_go.start()
    try:
        if by_modbus:
            client = make_client(os.ttyname(slave), 9600, "N", 0.1)
            assert client.connect()
            client.close()
        else:
            open_serial(os.ttyname(slave), 9600).close()
    finally:
        letting_go.join()
        os.close(master)


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals there")
@pytest.mark.parametrize("whole", [True, False])
def test_a_drive_that_falls_behind_by_one_answer_tells_no_value_for_another(
    whole: bool,
) -> None:
    """Its first answer comes with the second question, and each later one a little late;
    it has all registers, or none but these two.
    """
    known = {0x0178: b"\x00\x02\x04\x10", 0x00CC: b"\x00\x00\x04\xd2"}
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    late: list[bytes] = []

    def serve() -> None:
        behind = True
        while len(heard := os.read(master, 8)) == 8:
            size, place = 2 * heard[5], int.from_bytes(heard[2:4])
            answer = bytes((1, 3, size)) + known.get(place, bytes(size))
            if place not in known and not whole:
                answer = bytes((1, 0x83, 2))
            answer += FramerRTU.compute_CRC(answer).to_bytes(2)
            if behind:
                late.append(answer)
                behind = False
                continue
            for one in late:
                os.write(master, one)
            late.clear()
            time.sleep(0.05)
            os.write(master, answer)

    thread = threading.Thread(target=serve)
    thread.start()
    address = os.ttyname(slave)
    try:
        line = ModbusLine(lambda: make_client(address, 115200, "N", 0.2), address, 0.1)
        told = [line.read("ring", 1, register) for register in (0x0178, 0x00CC, 0x0178)]
        line.close()
    finally:
        os.write(slave, b"x")  # less than a question: it ends
        thread.join()
        os.close(slave)
        os.close(master)
    assert told == [0x20410, 1234, 0x20410]


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals there")
def test_a_port_that_another_program_keeps_is_refused() -> None:
    import fcntl

    master, slave = os.openpty()
    fcntl.flock(slave, fcntl.LOCK_EX)
    try:
        with pytest.raises(CommunicationError, match="who else holds it"):
            open_serial(os.ttyname(slave), 9600)
        assert not make_client(os.ttyname(slave), 9600, "N", 0.1).connect()
        beside = make_client(os.ttyname(slave), 9600, "N", 0.1, alone=False)
        assert beside.connect()  # who only stops
        beside.close()
    finally:
        os.close(slave)
        os.close(master)


@pytest.mark.parametrize(
    ("said", "whole", "real"),
    [
        ("12", 12, 12.0), ("-7", -7, -7.0), ("+3", 3, 3.0), ("1e-3", None, 1e-3),
        (" 2.5 ", None, 2.5), (".5", None, 0.5), ("nan", None, None), ("inf", None, None),
        ("-Infinity", None, None), ("1e400", None, None), ("9" * 5000, None, None),
        ("1_000", None, None), ("٣٤٥", None, None), ("0x10", None, None), ("", None, None),
        ("1 2", None, None), ("12\x1b[2J", None, None),
    ],
)  # fmt: skip
def test_a_number_is_what_a_device_may_say_as_one(
    said: str, whole: int | None, real: float | None
) -> None:
    assert whole_number(said) == whole
    assert real_number(said) == real


@pytest.mark.parametrize(
    ("settings", "fault", "says"),
    [
        ({"resolution": 0}, CommunicationError, "a full step has 0 microsteps; at least 1 is due"),
        ({"resolution": "9" * 5000}, CommunicationError, r"got '9+\.\.\., not a whole number"),
        ({"resolution": "nan"}, CommunicationError, "got 'nan', not a whole number"),
        ({"limit.max": "٣٤٥"}, CommunicationError, "not a whole number|no text|not a reply"),
        ({"limit.min": 100001}, DeviceError, "the device's own limits are 100001 to 100000 micro"),
    ],
)
def test_a_stage_that_says_no_number_is_refused_in_one_sentence(
    settings: dict[str, object],
    fault: type[DeviceError],
    says: str,
    toy_stage: Callable[..., object],
    toy_chain: Callable[..., str],
) -> None:
    toy = toy_stage()
    toy.settings |= settings  # type: ignore[attr-defined]
    address = toy_chain(toy)
    chain = ZaberChain(lambda: open_serial(address, 115200), timeout=0.3)
    with pytest.raises(fault, match=says) as refusal:
        ZaberAxis("stage", chain, KEYS, 10.0, homes_up=False)
    assert len(str(refusal.value)) < 400
    chain.close()

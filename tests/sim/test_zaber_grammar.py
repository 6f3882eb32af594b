"""The chain's grammar over bare sockets, and its stages on a clock that only the test moves."""

import socket
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager

import pytest

from sim.clock import RunningClock, SteppedClock
from sim.faults import Fault
from sim.server import TcpLine
from sim.zaber import Chain

MakeChain = Callable[..., Chain]


END = b"@02 0 77 OK IDLE "  # how device 2 begins its answer to the last message


@contextmanager
def talk_to(line: TcpLine) -> Generator[Callable[..., list[bytes]]]:
    """Sends bytes, returns the lines that come before device 2 answers a last message, or before an
    alert where one is due.
    """
    host, port = line.address.split(":")
    with socket.create_connection((host, int(port)), timeout=10) as client:

        def talk(data: bytes, until: bytes = END) -> list[bytes]:
            client.sendall(data + (b"/2 0 77\n" if until == END else b""))
            heard = b""
            while until not in heard or not heard.endswith(b"\r\n"):
                more = client.recv(4096)
                if not more:
                    return [b"closed"]
                heard += more
            answer = heard.split(END)[0]
            return answer.removesuffix(b"\r\n").split(b"\r\n") if answer else []

        yield talk


@pytest.fixture
def talk(tcp_chain: TcpLine) -> Iterator[Callable[..., list[bytes]]]:
    with talk_to(tcp_chain) as talking:
        yield talking


@pytest.mark.parametrize(
    ("sent", "heard"),
    [
        (b"/1 0 00 get system.axiscount\n", [b"@01 0 00 OK IDLE WR 1"]),
        (b"/1\r\n", [b"@01 0 OK IDLE WR 0"]),
        (b"/\n", [b"@01 0 OK IDLE WR 0", b"@02 0 OK IDLE WR 0"]),
        (b"/get resolution\n", [b"@01 0 OK IDLE WR 64", b"@02 0 OK IDLE WR 64"]),
        (b"/02 1 17 get pos\r", [b"@02 1 17 OK IDLE WR 0"]),
        (b"/1 0 --\n", []),
        (b"/3 get pos\n", []),
        (b"no slash\n", []),
        (b"/1 2 get pos\n", [b"@01 2 RJ IDLE WR BADAXIS"]),
        (b"/1 1 100 get pos\n", [b"@01 1 100 RJ IDLE WR BADMESSAGEID"]),
        (b"/1 1 get version\n", [b"@01 1 RJ IDLE WR DEVICEONLY"]),
        (b"/1 get nothing\n", [b"@01 0 RJ IDLE WR BADCOMMAND"]),
        (b"/1 set resolution 3\n", [b"@01 0 RJ IDLE WR BADCOMMAND"]),
        (b"/1 move abs\n", [b"@01 0 RJ IDLE WR BADDATA"]),
        (b"/1 move abs ten\n", [b"@01 0 RJ IDLE WR BADDATA"]),
        (b"/1 move abs -1\n", [b"@01 0 RJ IDLE WR BADDATA"]),
        (b"/1 warnings\n", [b"@01 0 OK IDLE WR 01 WR"]),
        (b"/1 tools echo good morning\n", [b"@01 0 OK IDLE WR good morning"]),
        (b"/1 get vesr\x08\x08\x08\x08version\n", [b"@01 0 OK IDLE WR 7.38"]),
        (b"/1 get rubbish\x7f/1 get deviceid\n", [b"@01 0 OK IDLE WR 50000"]),
    ],
)
def test_a_line_is_answered_as_the_manual_says(
    talk: Callable[..., list[bytes]], sent: bytes, heard: list[bytes]
) -> None:
    assert talk(sent) == heard


def test_checksums_are_checked_and_given(talk: Callable[..., list[bytes]]) -> None:
    # Sums as the vendor's client sends them; the reply's sum with its own checksum is a multiple of
    # 256.
    (reply,) = talk(b"/1 0 00 get pos:2D\n")
    body, given = reply[1:].rsplit(b":", 1)
    assert (sum(body) + int(given, 16)) % 256 == 0
    assert talk(b"/1 0 00 get pos:2E\n") == []
    assert len(talk(b"/0 0 01:FF\n")) == 2


def test_renumbering_follows_the_chain(talk: Callable[..., list[bytes]]) -> None:
    assert talk(b"/1 renumber 9\n") == [b"@09 0 OK IDLE WR 0"]
    assert talk(b"/1\n") == []
    assert talk(b"/renumber\n") == [b"@01 0 OK IDLE WR 0", b"@02 0 OK IDLE WR 0"]


def test_position_can_be_declared_and_then_warns_that_nobody_homed(
    talk: Callable[..., list[bytes]],
) -> None:
    assert talk(b"/1 set pos 500\n") == [b"@01 0 OK IDLE WH 0"]
    assert talk(b"/1 get pos\n") == [b"@01 0 OK IDLE WH 500"]


def test_an_alert_tells_that_a_motion_ended(talk: Callable[..., list[bytes]]) -> None:
    talk(b"/1 set comm.alert 1\n")
    assert talk(b"/1 home\n", b"!") == [b"@01 0 OK BUSY WR 0", b"!01 1 IDLE --"]


def test_a_stage_moves_by_the_clock_stops_slowly_and_then_at_once(make_chain: MakeChain) -> None:
    clock = SteppedClock()
    chain = make_chain(clock, devices=1)
    stage = chain.devices[0].stage
    assert chain.answer(b"/1 home") == b"@01 0 OK BUSY WR 0\r\n"
    # 20 mm at 10 mm/s with ramps of 10/400 s.
    clock.step(2.02)
    assert stage.busy()
    clock.step(0.01)
    assert chain.answer(b"/1") == b"@01 0 OK IDLE -- 0\r\n"
    chain.answer(b"/1 move abs 201575")  # 100 mm
    clock.step(1.0)
    assert stage.position() == pytest.approx(9.875 / stage.microstep, abs=1)
    assert chain.answer(b"/1 stop") == b"@01 0 OK BUSY NI 0\r\n"
    clock.step(0.01)
    assert stage.busy()
    chain.answer(b"/1 stop")
    assert not stage.busy()
    assert chain.answer(b"/1 warnings clear") == b"@01 0 OK IDLE -- 01 NI\r\n"
    assert chain.answer(b"/1 warnings") == b"@01 0 OK IDLE -- 00\r\n"


def test_a_stage_without_a_reference_runs_into_the_end_of_its_travel(make_chain: MakeChain) -> None:
    clock = SteppedClock()
    chain = make_chain(clock, devices=1, start=20.0)
    chain.answer(b"/1 move max")  # the counter says 0 at 20 mm, so this asks for 170 mm of 150
    clock.step(100)
    assert chain.answer(b"/1") == b"@01 0 OK IDLE FS 0\r\n"


def test_losing_power_loses_the_reference(make_chain: MakeChain) -> None:
    clock = SteppedClock()
    chain = make_chain(clock, devices=1)
    chain.answer(b"/1 home")
    clock.step(100)
    chain.answer(b"/1 system reset")
    assert chain.answer(b"/1 warnings") == b"@01 0 OK IDLE WR 01 WR\r\n"


@pytest.mark.parametrize(
    ("kind", "heard"),
    [
        ("silence", []),
        ("garbage", [b"\x7fK#?\xfe@@!"]),
        ("cut", [b"@01 0 OK I"]),
        ("wrong-checksum", [b"@01 0 OK IDLE WR 0:%02X" % ((1 - sum(b"01 0 OK IDLE WR 0")) % 256)]),
        ("hang-up", [b"closed"]),
    ],
)
def test_a_fault_shows_from_its_command_on(
    make_chain: MakeChain, kind: str, heard: list[bytes]
) -> None:
    line = TcpLine(make_chain(RunningClock(), faults={1: Fault(kind, after=1)}).open_session)
    try:
        with talk_to(line) as talk:
            assert talk(b"/1\n") == [b"@01 0 OK IDLE WR 0"]
            assert talk(b"/1\n") == heard
    finally:
        line.stop()


def test_a_dropped_answer_is_dropped_once(make_chain: MakeChain) -> None:
    chain = make_chain(SteppedClock(), devices=1, faults={1: Fault("drop")})
    assert [chain.answer(b"/1"), chain.answer(b"/1")] == [b"", b"@01 0 OK IDLE WR 0\r\n"]


def test_a_jammed_stage_stalls_and_says_so(make_chain: MakeChain) -> None:
    clock = SteppedClock()
    chain = make_chain(clock, devices=1, faults={1: Fault("stall")})
    chain.answer(b"/1 home")
    clock.step(100)
    assert chain.answer(b"/1") == b"@01 0 OK IDLE FS 0\r\n"


def test_several_clients_talk_at_once_and_a_stopped_line_lets_go_of_all(
    make_chain: MakeChain,
) -> None:
    line = TcpLine(make_chain(RunningClock()).open_session)
    with talk_to(line) as one, talk_to(line) as other:
        assert one(b"/1 get pos\n") == other(b"/1 get pos\n")
        begun = time.monotonic()
        line.stop()
        assert time.monotonic() - begun < 1.0
        assert one(b"") == [b"closed"]

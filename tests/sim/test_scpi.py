"""The camera, iris and wheel by docs/scpi-camera.md, over bare sockets with a reader of blocks of
the test's own.
"""

import socket
import struct
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from flflab.bench import Bench
from sim.serve import Served, serve

WriteBench = Callable[..., Bench]


class Client:
    """Ten lines that know IEEE 488.2 blocks and nothing else."""

    def __init__(self, address: str) -> None:
        host, port = address.split(":")
        self.wire = socket.create_connection((host, int(port)), timeout=20)
        self.file = self.wire.makefile("rwb")

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *problem: object) -> None:
        self.file.close()
        self.wire.close()

    def tell(self, line: str) -> None:
        self.file.write(line.encode() + b"\n")
        self.file.flush()

    def ask(self, line: str) -> str:
        self.tell(line)
        return self.file.readline().decode().rstrip("\n")

    def fetch(self) -> tuple[list[float], np.ndarray]:
        self.tell("FETC?")
        head = b""
        while not head.endswith(b"#"):
            head += self.file.read(1)
        digits = int(self.file.read(1))
        length = int(self.file.read(digits))
        values = struct.unpack(f"<{length // 2}H", self.file.read(length))
        assert self.file.read(1) == b"\n"
        facts = [float(word) for word in head.decode().removesuffix(",#").split(",")]
        return facts, np.array(values).reshape(int(facts[5]), int(facts[4]))


@pytest.fixture
def served(write_bench_file: WriteBench) -> Iterator[Served]:
    with serve(write_bench_file()) as running:
        yield running


@pytest.fixture
def client(served: Served) -> Iterator[Client]:
    with Client(served.addresses["camera"]["address"]) as talking:
        yield talking


def take(client: Client, exposure: float = 0.005, kind: str = "white") -> np.ndarray:
    client.tell(f"EXP {exposure};TARG:KIND {kind}")
    assert client.ask("*OPC?;SYST:ERR?") == '1;0,"No error"'
    client.tell("INIT")
    return client.fetch()[1]


def test_tells_what_it_is(client: Client) -> None:
    assert client.ask("*IDN?").count(",") == 3
    assert (
        client.ask("SENS:SIZE?;SENS:PITC?;SENS:BITS?;SENS:FULL?;SENS:OFFS?;SENS:NOIS?")
        == "240,180;0.006;12;4095;64;3"
    )
    assert (
        client.ask("FORM?;FORM:CAT?;EXP?;GAIN?;EXP? MIN;EXP? MAXIMUM")
        == '"MONO12";"MONO12";0.01;1;1e-05;10'
    )
    assert client.ask("sensor:size?;:SENSOR:WELL?") == "240,180;12000"


def test_full_well_meets_full_scale_at_any_gain(client: Client) -> None:
    per_dn = float(client.ask("SENS:CONV?"))
    assert per_dn == pytest.approx(12000 / (4095 - 64), rel=1e-3)
    assert float(client.ask("GAIN 4;SENS:CONV?")) == pytest.approx(per_dn / 4)


def test_a_frame_comes_as_a_block_with_its_facts(client: Client) -> None:
    before = time.time()
    client.tell("EXP 0.02;GAIN 2;INIT")
    facts, picture = client.fetch()
    assert facts[:1] + facts[2:] == [1, 0.02, 2, 240, 180, 0]
    assert facts[1] >= before - 1
    assert picture.shape == (180, 240)
    client.tell("INIT")
    assert client.fetch()[0][0] == 2


def test_what_moves_after_the_exposure_is_not_in_the_picture(client: Client) -> None:
    at_rest = take(client, 5.0)  # lasts 25 ms on the bench's clock
    assert client.ask("*RST;EXP 5;INIT;EXP:BUSY?") == "1"
    while client.ask("EXP:BUSY?") == "1":
        pass
    client.tell('TARG:KIND "black"')
    assert np.array_equal(client.fetch()[1], at_rest)


def test_the_white_picture_shows_round_micro_images(client: Client) -> None:
    picture = take(client)
    # Pitch 0.407667 mm at 6 um: 68 px; on the axis bright, a half pitch away in both directions
    # dark.
    row, column = 90, 120
    assert picture[row - 3 : row + 3, column - 3 : column + 3].mean() > 1500
    assert picture[row + 34, column + 34] == pytest.approx(64, abs=8)


def test_light_grows_with_exposure_and_gain_and_noise_is_as_stated(client: Client) -> None:
    dark = take(client, kind="black").astype(float)
    conversion = float(client.ask("SENS:CONV?"))
    assert dark.mean() == pytest.approx(64, abs=0.05)
    assert dark.std() == pytest.approx(np.hypot(3 / conversion, np.sqrt(1 / 12)), rel=0.05)
    once, twice = take(client, 0.002).astype(float) - 64, take(client, 0.004).astype(float) - 64
    assert twice.sum() / once.sum() == pytest.approx(2, rel=0.01)
    client.tell("GAIN 2")
    assert (take(client, 0.002).astype(float) - 64).sum() / once.sum() == pytest.approx(2, rel=0.01)


def test_shot_noise_is_that_of_counted_electrons(client: Client) -> None:
    pictures = np.array([take(client, 0.004).astype(float) for _ in range(12)])
    bright = pictures.mean(axis=0) > 1000
    conversion = float(client.ask("SENS:CONV?"))
    electrons = (pictures[:, bright].mean(axis=0) - 64) * conversion
    variance = pictures[:, bright].var(axis=0, ddof=1) * conversion**2
    assert variance.mean() == pytest.approx((electrons + 9 + conversion**2 / 12).mean(), rel=0.05)


def test_frames_differ_in_noise_but_a_point_measured_again_gives_the_same_frames(
    client: Client, write_bench_file: WriteBench
) -> None:
    first, second = take(client), take(client)
    assert np.any(first != second)
    take(client, kind="black")
    again = take(client)
    assert np.array_equal(again, first)
    with serve(write_bench_file()) as other, Client(other.addresses["camera"]["address"]) as fresh:
        assert np.array_equal(take(fresh), first)


def test_a_smaller_stop_gives_the_light_of_a_narrower_cone(client: Client) -> None:
    def brightness(f_number: float) -> float:
        client.tell(f"LENS:FNUM {f_number};TARG:KIND white")
        assert client.ask("*OPC?") == "1"
        return float(np.mean([take(client, 0.01)[89:91, 119:121].mean() for _ in range(8)])) - 64

    # At F/4 the microlens limits the cone (0.168 mm half width), at F/16 the main lens (3.125 *
    # 1.15 / 60 / 0.234923 / 2 mm).
    half = 3.125 * 1.15 / 60 / 0.234923 / 2
    assert brightness(16) / brightness(4) == pytest.approx((half / 0.168) ** 2, rel=0.02)


def test_the_iris_and_the_wheel_take_their_time_and_report(client: Client) -> None:
    assert client.ask("LENS:FNUM?;TARG:KIND?") == '4;"white"'
    client.tell('LENS:FNUM 8;TARG:KIND "four-dot"')
    assert (
        client.ask("*OPC?;LENS:FNUM?;TARG:KIND?;LENS:BUSY?;TARG:BUSY?;SYST:BUSY?")
        == '1;8;"four-dot";0;0;0'
    )
    assert client.ask("LENS:FNUM? MIN;LENS:FNUM? MAX") == "1;32"
    assert client.ask("TARG:CAT?").split(",")[:4] == ['"four-dot"', '"bars"', '"white"', '"black"']


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("DANCE", -113), ("EXP 100", -222), ("EXP long", -104), ("EXP nan", -104), ("EXP", -109),
        ("EXP 1,2", -108),
        ("LENS:FNUM 0.5", -222), ('TARG:KIND "sphere"', -224), ("FORM MONO8", -224),
        ("*RST 1", -108), ("EXP? MIDDLE", -224),
        ("INIT;INIT", -213), ("INIT;EXP 1", -221), ("*CLS;FETC?", -221), ("x" * 1025, -223),
        ("EXP\t1", -101),
    ],
)  # fmt: skip
def test_a_wrong_command_changes_nothing_and_is_queued(
    client: Client, line: str, number: int
) -> None:
    client.tell(line)
    assert client.ask("SYST:ERR?").startswith(f'{number},"')
    assert client.ask("SYST:ERR?") == '0,"No error"'
    assert client.ask("EXP?;LENS:FNUM?;TARG:KIND?") == '0.01;4;"white"'


def test_errors_of_one_client_are_not_those_of_another_and_too_many_overflow(
    client: Client, served: Served
) -> None:
    with Client(served.addresses["camera"]["address"]) as other:
        for _ in range(20):
            client.tell("DANCE")
        assert [client.ask("SYST:ERR?")[:4] for _ in range(17)] == ["-113"] * 15 + ["-350", '0,"N']
        assert other.ask("SYST:ERR?") == '0,"No error"'


def test_a_fetch_without_a_frame_is_an_empty_block(client: Client) -> None:
    assert client.ask("FETC?") == "0,0,0,0,0,0,0,#10"
    assert client.ask("SYST:ERR?").startswith("-214,")


def test_a_full_buffer_drops_the_oldest_frame(client: Client) -> None:
    for _ in range(6):
        client.tell("INIT")
        client.ask("*OPC?")
    assert client.ask("FETC:COUN?;FETC:DROP?") == "4;2"
    assert client.fetch()[0][0] == 3
    assert client.ask("ABOR;FETC:COUN?;FETC:DROP?") == "0;2"
    assert client.ask("*RST;FETC:DROP?") == "0"


@pytest.mark.parametrize(
    ("device", "fault", "line", "answer"),
    [
        ("camera", "garbage", "EXP?", "\x7fK#?"),
        ("camera", "hang-up", "EXP?", ""),
        ("iris", "garbage", "LENS:FNUM?", "\x7fK#?"),
    ],
)
def test_a_fault_of_an_instrument_shows(
    write_bench_file: WriteBench, device: str, fault: str, line: str, answer: str
) -> None:
    faults = [{"device": device, "fault": fault, "after": 1}]
    with (
        serve(write_bench_file(faults=faults)) as running,
        Client(running.addresses["camera"]["address"]) as client,
    ):
        assert client.ask(line).isprintable()
        client.tell(line)
        assert client.file.readline().decode("latin-1")[:4] == answer


def test_a_lost_frame_and_a_stalled_iris_are_reported(write_bench_file: WriteBench) -> None:
    faults = [{"device": "camera", "fault": "lost-frame"}, {"device": "iris", "fault": "stall"}]
    with (
        serve(write_bench_file(faults=faults)) as running,
        Client(running.addresses["camera"]["address"]) as client,
    ):
        client.tell("INIT")
        assert client.ask("FETC?") == "0,0,0,0,0,0,1,#10"
        assert client.ask("SYST:ERR?").startswith("-230,")
        assert client.ask("LENS:FNUM 8;*OPC?;LENS:FNUM?;SYST:ERR?").startswith("1;4.5;-200,")

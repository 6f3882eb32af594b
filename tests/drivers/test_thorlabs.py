"""The Thorlabs driver byte by byte: against an independent encoder, the manual's numbers, and peers
that answer wrongly.
"""

import math
import struct
from collections.abc import Callable, Iterator

import pytest
import thorlabs_apt_protocol as apt
from hypothesis import given
from hypothesis import strategies as st

from drivers.axis import Axis
from drivers.thorlabs import AptLink, ThorlabsAxis, ThorlabsKeys, encode, read_message
from drivers.transport import open_tcp
from flflab.bench import ANGLE
from flflab.errors import CommunicationError, DeviceError, LimitError, NotHomedError

Pairs = list[tuple[bytes, bytes | Callable[[], bytes] | None]]
Start = Callable[[Pairs], str]
PER_DEGREE = 1919.6418578623391
TO = {"dest": 0x50, "source": 1}
MARK = apt.mod_req_chanenablestate(**TO, chan_ident=1)
MARKED = bytes.fromhex("120201010150")
STATUS = apt.mot_req_dcstatusupdate(**TO, chan_ident=1) + MARK
ENABLED, HOMED, HOMING, FORWARD, FOLLOWING_ERROR = 1 << 31, 1 << 10, 1 << 9, 1 << 4, 1 << 14


def state(counts: int, bits: int, channel: int = 1) -> bytes:
    """A status, and the answer to the question that follows every other."""
    return bare_state(counts, bits, channel) + MARKED


def bare_state(counts: int, bits: int, channel: int = 1) -> bytes:
    return bytes.fromhex("91040e008150") + struct.pack("<HlHHL", channel, counts, 0, 0, bits)


INFO = bytes.fromhex("060054008150") + struct.pack(
    "<L8sH4B60sHHH", 27123456, b"KDC101", 44, 9, 1, 2, 0, bytes(60), 1, 0, 1
)
VELOCITY = bytes.fromhex("15040e008150") + struct.pack("<Hlll", 1, 0, 147, 429417)
BACKLASH = bytes.fromhex("3c0406008150") + struct.pack("<Hl", 1, 1920)
WAKING: Pairs = [
    (apt.hw_req_info(**TO), INFO),
    (apt.mot_req_velparams(**TO, chan_ident=1) + MARK, VELOCITY + MARKED),
    (apt.mot_req_genmoveparams(**TO, chan_ident=1) + MARK, BACKLASH + MARKED),
    (apt.mot_set_genmoveparams(**TO, chan_ident=1, backlash_distance=0), b""),
    (apt.mot_req_genmoveparams(**TO, chan_ident=1) + MARK, BACKLASH[:-4] + bytes(4) + MARKED),
    (apt.mod_set_chanenablestate(**TO, chan_ident=1, enable_state=1), b""),
]


@pytest.fixture
def linked() -> Iterator[Callable[[str], AptLink]]:
    """Links to peers, closed at the end."""
    links: list[AptLink] = []

    def link(address: str) -> AptLink:
        links.append(AptLink(lambda: open_tcp(address), 0.3))
        return links[-1]

    yield link
    for one in links:
        one.close()


@pytest.fixture
def stage(dialogue: Start, linked: Callable[[str], AptLink]) -> Callable[..., ThorlabsAxis]:
    def connect(*pairs: tuple[bytes, bytes | Callable[[], bytes] | None]) -> ThorlabsAxis:
        return ThorlabsAxis(
            "tilt", linked(dialogue([*WAKING, *pairs])), ThorlabsKeys(timeout=0.3), math.radians(10)
        )

    return connect


@given(st.integers(1, 4), st.integers(-(2**31), 2**31 - 1))
def test_messages_are_those_of_an_independent_encoder(channel: int, counts: int) -> None:
    assert encode(0x0453, data=struct.pack("<Hl", channel, counts)) == apt.mot_move_absolute(
        **TO, chan_ident=channel, position=counts
    )
    assert encode(0x0443, channel) == apt.mot_move_home(**TO, chan_ident=channel)
    assert encode(0x0465, channel, 2) == apt.mot_move_stop(**TO, chan_ident=channel, stop_mode=2)
    assert encode(0x0490, channel) == apt.mot_req_dcstatusupdate(**TO, chan_ident=channel)


def test_an_absolute_move_is_the_manuals_example() -> None:
    assert encode(0x0453, data=struct.pack("<Hl", 1, 200000)).hex() == "53040600d0010100400d0300"


@pytest.mark.parametrize(
    "junk",
    ["ffffffffffff", "910420008450", "9104ff0f8150"],
    ids=["noise", "for another host", "endless"],
)
def test_what_is_no_message_is_refused(junk: str) -> None:
    with pytest.raises(CommunicationError, match="got"):
        read_message(lambda count: bytes.fromhex(junk)[:count])


def test_connecting_sets_the_speed_that_was_asked_for(
    dialogue: Start, linked: Callable[[str], AptLink]
) -> None:
    half = round(429417 / 2)
    set_to = VELOCITY[:-4] + struct.pack("<l", half)
    address = dialogue(
        [
            *WAKING[:2],
            (
                apt.mot_set_velparams(
                    **TO, chan_ident=1, min_velocity=0, acceleration=147, max_velocity=half
                ),
                b"",
            ),
            (apt.mot_req_velparams(**TO, chan_ident=1) + MARK, set_to + MARKED),
            *WAKING[2:],
            (apt.hw_req_info(**TO) + MARK, INFO + MARKED),
        ]
    )
    axis = ThorlabsAxis("tilt", linked(address), ThorlabsKeys(timeout=0.3), math.radians(5))
    assert axis.identity() == "Thorlabs KDC101, serial 27123456, firmware 2.1.9"


def test_a_controller_that_keeps_its_backlash_correction_is_refused(
    dialogue: Start, linked: Callable[[str], AptLink]
) -> None:
    """It would overshoot beyond the way that was found free."""
    address = dialogue(
        [*WAKING[:4], (apt.mot_req_genmoveparams(**TO, chan_ident=1) + MARK, BACKLASH + MARKED)]
    )
    with pytest.raises(
        DeviceError,
        match=(
            "tilt: asked to switch its backlash correction off, it keeps 1920 counts; switch it"
            " off in"
        ),
    ):
        ThorlabsAxis("tilt", linked(address), ThorlabsKeys(timeout=0.3), math.radians(10))


def test_a_move_is_whole_counts_and_reads_back(stage: Callable[..., ThorlabsAxis]) -> None:
    counts = round(12.3456789 * PER_DEGREE)
    axis = stage(
        (STATUS, state(0, ENABLED | HOMED)),
        (apt.mot_move_absolute(**TO, chan_ident=1, position=counts), b""),
        (STATUS, state(100, ENABLED | HOMED | FORWARD)),
        (STATUS, state(counts, ENABLED | HOMED)),
    )
    axis.start_move(math.radians(12.3456789))
    assert math.degrees(axis.position()) == pytest.approx(12.3456789, abs=0.5 / PER_DEGREE)


def test_more_counts_than_a_controller_takes_are_refused_before_it_is_told(
    stage: Callable[..., ThorlabsAxis], dialogue: Start, linked: Callable[[str], AptLink]
) -> None:
    with pytest.raises(
        LimitError,
        match=(
            r"tilt: 2e\+06 deg are 3839283716 counts, more than the controller can count; nothing"
            r" moved"
        ),
    ):
        stage().start_move(math.radians(2e6))
    with pytest.raises(
        DeviceError,
        match=(
            r"tilt: asked for 1e\+06 deg/s, more than the controller can be told; correct `speed`"
        ),
    ):
        ThorlabsAxis("tilt", linked(dialogue([])), ThorlabsKeys(timeout=0.3), math.radians(1e6))


def test_a_move_that_never_shows_is_an_error_that_says_so(
    stage: Callable[..., ThorlabsAxis], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.thorlabs.START_S", 0.0)
    axis = stage(
        (STATUS, state(0, ENABLED | HOMED)),
        (apt.mot_move_absolute(**TO, chan_ident=1, position=9999), b""),
        (STATUS, state(0, ENABLED | HOMED)),
    )
    with pytest.raises(CommunicationError, match="no motion shows"):
        axis.start_move(9999 / PER_DEGREE * math.pi / 180)


def test_a_motor_that_is_off_is_not_told_to_move(stage: Callable[..., ThorlabsAxis]) -> None:
    axis = stage((STATUS, state(0, HOMED)))
    with pytest.raises(DeviceError, match="switched off"):
        axis.start_move(0.1)


def test_ends_told_unasked_do_not_pass_for_answers(stage: Callable[..., ThorlabsAxis]) -> None:
    completed = bytes.fromhex("64040e008150") + bare_state(777, 0)[6:]
    axis = stage((STATUS, completed + state(5, ENABLED | HOMED | FOLLOWING_ERROR)))
    assert axis.faults() == ("position error too large",)


def test_after_a_lost_answer_a_late_one_is_not_taken_for_the_next(
    stage: Callable[..., ThorlabsAxis],
) -> None:
    axis = stage(
        (
            STATUS,
            b"",
        ),  # its answer comes late: before that to the question that tells answers apart
        (apt.hw_req_info(**TO), state(111, ENABLED) + INFO),
        (STATUS, state(222, ENABLED)),
    )
    assert axis.position() == pytest.approx(math.radians(222 / PER_DEGREE))


def test_an_answer_given_twice_is_not_taken_for_the_next(
    stage: Callable[..., ThorlabsAxis],
) -> None:
    stray = bare_state(111, ENABLED)
    axis = stage((STATUS, state(111, ENABLED)), (STATUS, stray + state(222, ENABLED)))
    assert axis.position() == pytest.approx(math.radians(111 / PER_DEGREE))
    assert axis.position() == pytest.approx(math.radians(222 / PER_DEGREE))


def test_an_axis_in_degrees_says_degrees(stage: Callable[..., ThorlabsAxis]) -> None:
    axis = Axis(
        "tilt", stage(*[(STATUS, state(0, ENABLED))] * 2), (-0.1, 0.1), 0.1, coordinate=ANGLE
    )
    with pytest.raises(
        NotHomedError, match=r"asked to go to 5\.000000 deg, but it has no reference"
    ):
        axis.move_to(math.radians(5))

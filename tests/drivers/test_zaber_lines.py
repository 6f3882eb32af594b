"""The grammar of the Zaber driver against lines written down by hand, and every fault of a line
against a scripted peer.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from drivers.line import stop_surely
from drivers.transport import Wire, open_serial
from drivers.zaber import ZaberAxis, ZaberChain, ZaberKeys, checksum, encode, parse
from flflab.errors import CommunicationError

Play = Callable[[list[tuple[bytes, object]]], str]


def line(body: str) -> bytes:
    """A line with the checksum as its definition has it: everything after the first character sums
    to 0 modulo 256.
    """
    return f"{body}:{(256 - sum(map(ord, body[1:])) % 256) % 256:02X}\r\n".encode()


@pytest.mark.parametrize(
    ("body", "due"), [(b"1 0 00 get pos", "2D"), (b"0 0 01", "FF"), (b"1 1 42", "F8")]
)
def test_the_checksum_is_the_one_the_vendors_client_sends(body: bytes, due: str) -> None:
    assert checksum(body) == due


def test_a_command_carries_address_id_and_checksum() -> None:
    assert encode(1, 0, 0, "get pos") == b"/1 0 00 get pos:2D\r\n"
    assert encode(1, 1, 42) == b"/1 1 42:F8\r\n"


def test_a_reply_is_read_field_by_field() -> None:
    reply = parse(b"@01 1 42 OK IDLE -- 0:06")
    assert reply is not None
    assert (
        reply.device,
        reply.axis,
        reply.id,
        reply.accepted,
        reply.busy,
        reply.flag,
        reply.data,
    ) == (1, 1, 42, True, False, "--", "0")


@pytest.mark.parametrize("unasked", [b"#01 0 hello: world", b"!01 1 IDLE --", b"!01 1 IDLE FS"])
def test_information_and_alerts_are_not_replies(unasked: bytes) -> None:
    assert parse(unasked) is None


@pytest.mark.parametrize(
    "garbage",
    [
        b"",
        b"@",
        b"@01 1 42 OK IDLE -- 0:07",
        b"@1 1 42 OK IDLE",
        b"\xff\x00\x80",
        b"HTTP/1.1 400 Bad Request",
    ],
)
def test_what_is_not_this_protocol_is_refused(garbage: bytes) -> None:
    with pytest.raises(CommunicationError, match="got"):
        parse(garbage)


def test_a_reply_without_checksum_is_taken_unless_one_is_required_or_was_sent_before(
    dialogue: Play,
) -> None:
    bare = b"@02 1 00 OK IDLE -- 5"
    taken = parse(bare)
    assert taken is not None
    assert taken.data == "5"
    with pytest.raises(CommunicationError, match="without a checksum"):
        parse(bare, with_checksum=True)
    chain = chain_at(
        dialogue(
            [(FIRST, bare + b"\r\n"), (AGAIN, GOOD_AGAIN), (THIRD, b"@02 1 02 OK IDLE -- 51\r\n")]
        )
    )
    for _ in range(2):
        assert chain.ask("array_stage", 2, 1, "get pos", repeatable=False).data == "5"
    with pytest.raises(CommunicationError, match="without the checksum that it sent before"):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=False)
    chain.close()


@pytest.mark.parametrize("unasked", [b"!03 1 IDLE --\r\n", b"#02 1 hello\r\n"])
def test_alerts_and_information_without_end_are_no_reply(unasked: bytes) -> None:
    over = threading.Event()

    def receive() -> bytes:
        time.sleep(0.001)
        return unasked

    wire = Wire("line", lambda _: None, receive, over.set)
    chain = ZaberChain(lambda: wire, timeout=0.1)
    with pytest.raises(
        CommunicationError, match=r"no answer within 0\.1 s, though other lines came"
    ):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=True)
    chain.close()


@pytest.mark.parametrize("flag", ["WM", "FS"])
def test_a_stage_that_was_displaced_or_stalled_has_no_known_place(
    flag: str, toy_stage: type[Any], toy_chain: Callable[..., str]
) -> None:
    stage = toy_stage()
    keys = ZaberKeys.model_validate({"device": 1, "microstep": "0.5 um"})
    chain = chain_at(toy_chain(stage))
    axis = ZaberAxis("array_stage", chain, keys, 10.0, homes_up=False)
    assert axis.reading() == 0
    stage.flags.add(flag)
    assert axis.reading() is None
    assert not axis.is_homed()
    chain.close()


def chain_at(address: str) -> ZaberChain:
    return ZaberChain(lambda: open_serial(address, 115200), timeout=0.15)


FIRST = line("/2 1 00 get pos")
AGAIN = line("/2 1 01 get pos")
THIRD = line("/2 1 02 get pos")
GOOD = line("@02 1 00 OK IDLE -- 5")
GOOD_AGAIN = line("@02 1 01 OK IDLE -- 5")
FAULTS = {
    "silence": (b"", "no answer within 0.15 s"),
    "a torn line": (GOOD[:11], "without its end|its checksum"),
    "a wrong checksum": (GOOD.replace(b"5:", b"6:"), "its checksum is wrong"),
    "garbage": (b"\x00\xfe\x81\r\n", "not a reply of the Zaber ASCII protocol"),
    "another device's reply": (line("@03 1 00 OK IDLE -- 5"), "got the reply of device 3"),
    "another message's reply": (line("@02 1 77 OK IDLE -- 5"), "to message 77, not to message 0"),
    "another axis's reply": (line("@02 2 00 OK IDLE -- 5"), "device 2 axis 2"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_move_is_never_sent_twice_and_its_fault_names_device_question_answer(
    fault: str, dialogue: Play
) -> None:
    came, says = FAULTS[fault]
    chain = chain_at(dialogue([(line("/2 1 00 move abs 5"), came)]))
    with pytest.raises(CommunicationError, match=says) as caught:
        chain.ask("array_stage", 2, 1, "move abs 5", repeatable=False)
    assert "array_stage (device 2 axis 1): asked" in str(caught.value)
    assert "asked 'move abs 5'" in str(caught.value)
    chain.close()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_question_is_repeated_once_after_what_was_left_on_the_line(
    fault: str, dialogue: Play
) -> None:
    chain = chain_at(dialogue([(FIRST, FAULTS[fault][0]), (AGAIN, GOOD_AGAIN)]))
    assert chain.ask("array_stage", 2, 1, "get pos", repeatable=True).data == "5"
    chain.close()


def test_a_question_is_not_repeated_twice(dialogue: Play) -> None:
    chain = chain_at(dialogue([(FIRST, b"?\r\n"), (AGAIN, b"?\r\n")]))
    with pytest.raises(CommunicationError, match="not a reply"):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=True)
    chain.close()


def test_a_late_reply_is_not_taken_for_the_next_ones(dialogue: Play) -> None:
    def late() -> bytes:
        time.sleep(0.2)
        return GOOD

    chain = chain_at(dialogue([(FIRST, late), (AGAIN, line("@02 1 01 OK IDLE -- 7"))]))
    with pytest.raises(CommunicationError, match="no answer"):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=False)
    time.sleep(0.1)
    assert chain.ask("array_stage", 2, 1, "get pos", repeatable=False).data == "7"
    chain.close()


def test_a_reply_may_be_late_by_any_number_of_commands(dialogue: Play) -> None:
    """Ids go round after 99 commands, in a tenth of a second on a network; the reply of the round
    before tells an old position.
    """
    prompt = [
        (line(f"/2 1 {one:02d} get pos"), line(f"@02 1 {one:02d} OK IDLE -- 7"))
        for one in [*range(1, 99), 1]
    ]
    prompt[98] = (prompt[98][0], GOOD + prompt[98][1])
    chain = chain_at(dialogue([(FIRST, b""), *prompt]))
    with pytest.raises(CommunicationError, match="no answer"):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=False)
    assert {
        chain.ask("array_stage", 2, 1, "get pos", repeatable=False).data for _ in range(99)
    } == {"7"}
    chain.close()


@pytest.mark.ci
def test_a_line_on_which_nothing_is_understood_is_asked_on_and_on(dialogue: Play) -> None:
    chain = chain_at(
        dialogue([(line(f"/2 1 {number % 99:02d} get pos"), b"?\r\n") for number in range(120)])
    )
    for _ in range(120):
        with pytest.raises(CommunicationError, match="not a reply"):
            chain.ask("array_stage", 2, 1, "get pos", repeatable=False)
    chain.close()


def test_a_line_that_is_cut_is_an_error_that_says_so(dialogue: Play) -> None:
    chain = chain_at(dialogue([(FIRST, None)]))
    with pytest.raises(CommunicationError, match="the connection is gone"):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=False)
    chain.close()


def test_a_flood_without_line_ends_is_refused(dialogue: Play) -> None:
    chain = chain_at(dialogue([(FIRST, b"\x55" * 200_000)]))
    chain._timeout = 5.0  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    with pytest.raises(CommunicationError, match="check the baud rate"):
        chain.ask("array_stage", 2, 1, "get pos", repeatable=False)
    chain.close()


def test_what_comes_unasked_is_kept_aside(dialogue: Play) -> None:
    chain = chain_at(dialogue([(FIRST, b"#02 0 an info line\r\n!02 1 IDLE --\r\n" + GOOD)]))
    assert chain.ask("array_stage", 2, 1, "get pos", repeatable=False).data == "5"
    assert list(chain.unasked) == ["#02 0 an info line", "!02 1 IDLE --"]
    chain.close()


def test_a_stop_does_not_wait_for_another_exchange_and_its_reply_disturbs_none(
    dialogue: Play,
) -> None:
    stop = line("/1 1 99 stop")
    chain = chain_at(dialogue([(stop, line("@01 1 99 OK IDLE -- 0")), (FIRST, GOOD)]))
    with chain._turns.take():  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
        stop_surely(chain.line, "stage", stop, lambda: None)
    assert chain.ask("array_stage", 2, 1, "get pos", repeatable=False).data == "5"
    chain.close()


def test_a_stop_whose_reply_takes_long_leaves_time_for_the_one_that_confirms_it(
    dialogue: Play,
) -> None:
    def slowly(reply: bytes) -> Callable[[], bytes]:
        return lambda: (time.sleep(0.6), reply)[1]

    stopped, state = slowly(line("@01 1 99 OK BUSY -- 0")), slowly(line("@01 1 00 OK IDLE -- 0"))
    address = dialogue([(line("/1 1 99 stop"), stopped), (line("/1 1 00"), state)])
    chain = ZaberChain(lambda: open_serial(address, 115200), timeout=1.0)
    chain.stop("stage", 1, 1)
    chain.close()


def test_nobody_at_the_address_is_said_with_the_address() -> None:
    with pytest.raises(CommunicationError, match=r"127\.0\.0\.1:1: cannot be reached"):
        open_serial("127.0.0.1:1", 115200)
    with pytest.raises(CommunicationError, match="/dev/no-such-port: cannot be opened"):
        open_serial("/dev/no-such-port", 115200)

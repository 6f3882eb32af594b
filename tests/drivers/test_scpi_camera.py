"""The SCPI camera, iris and wheel against lines written down by hand from docs/scpi-camera.md, and
every way a frame can go wrong.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bluesky import protocols

from drivers.base import Camera, Detector
from drivers.cameras.scpi import ScpiCamera
from drivers.scpi_link import ScpiLink, on_link, split
from drivers.scpi_settings import ScpiIris, ScpiTarget
from drivers.setting import Setting
from drivers.transport import what_to_check
from flflab.errors import CommunicationError, DeviceError, LimitError, MotionError

Play = Callable[[list[tuple[bytes, object]]], str]
NONE = b'0,"No error"\n'
BEGIN: list[tuple[bytes, object]] = [
    (b"*CLS;ABOR;*RST;SYST:ERR?\n", NONE),
    (
        b"*CLS;SENS:FULL?;SENS:OFFS?;SENS:READ?;EXP? MIN;EXP? MAX;GAIN? MIN;GAIN? MAX;SYST:ERR?\n",
        b"4095;64;0.05;1e-05;10;1;16;" + NONE,
    ),
    (b"*CLS;SENS:SIZE?;FORM?;SYST:ERR?\n", b'3,2;"MONO12";' + NONE),
    (b"*CLS;EXP?;GAIN?;SENS:CONV?;SENS:NOIS?;SYST:ERR?\n", b"0.01;1;4;3;" + NONE),
]
PIXELS = np.array([[0, 1, 2], [256, 4094, 4095]], dtype=np.uint16)
BLOCK = b"\x00\x00\x01\x00\x02\x00\x00\x01\xfe\x0f\xff\x0f"
ALIVE: list[tuple[bytes, object]] = [(b"SYST:BUSY?\n", b"0\n")]
INIT: list[tuple[bytes, object]] = [*ALIVE, (b"*CLS;INIT;SYST:ERR?\n", NONE)]


def frame(
    number: int = 1,
    dropped: int = 0,
    exposure: str = "0.01",
    size: str = "3,2",
    head: str = "#212",
    end: bytes = b"\n",
) -> bytes:
    return f"{number},1700000000.25,{exposure},1,{size},{dropped},{head}".encode() + BLOCK + end


def camera_at(address: str) -> Camera:
    return Camera(
        "camera",
        on_link(ScpiLink("camera", address, timeout=0.3), lambda link: ScpiCamera(link, slack=0.3)),
    )


def test_a_frame_arrives_bit_by_bit_with_what_it_was_taken_with(dialogue: Play) -> None:
    camera = camera_at(dialogue([*BEGIN, *INIT, (b"FETC?\n", frame())]))
    taken = camera.grab()
    assert taken.picture.dtype == np.uint16
    assert np.array_equal(taken.picture, PIXELS)
    assert (taken.number, taken.dropped, taken.exposure_s, taken.gain, taken.timestamp) == (
        1,
        0,
        0.01,
        1.0,
        1700000000.25,
    )
    assert taken.pixel_format == camera.pixel_format == "Mono12"
    assert (camera.full_scale, camera.offset_dn, camera.dn_per_electron, camera.read_noise_dn) == (
        4095,
        64.0,
        0.25,
        0.75,
    )
    camera.close()


def test_preparing_sets_exposure_and_gain_and_reads_back_what_became_of_them(
    dialogue: Play,
) -> None:
    camera = camera_at(
        dialogue(
            [
                *BEGIN,
                *ALIVE,
                (b"*CLS;EXP 0.02;GAIN 2.0;SYST:ERR?\n", NONE),
                (b"*CLS;EXP?;GAIN?;SENS:CONV?;SENS:NOIS?;SYST:ERR?\n", b"0.0200001;2;2;3;" + NONE),
                *INIT,
                (b"FETC?\n", frame(exposure="0.0200001").replace(b",1,3,2", b",2,3,2")),
            ]
        )
    )
    camera.prepare(0.02, 2.0)
    assert camera.dn_per_electron == 0.5
    assert camera.grab().exposure_s == 0.0200001
    camera.close()


def test_a_camera_that_cannot_take_a_picture_yet_is_not_asked_for_one(dialogue: Play) -> None:
    def not_yet() -> None:
        raise CommunicationError("the bench still compiles")

    camera = Camera(
        "camera", on_link(ScpiLink("camera", dialogue(BEGIN), timeout=0.3), ScpiCamera), not_yet
    )
    with pytest.raises(CommunicationError, match="still compiles"):
        camera.grab()
    assert camera.dropped == 0
    camera.close()


def test_who_waits_for_the_light_is_told_when_it_is_in_before_the_frame_is_asked_for(
    dialogue: Play,
) -> None:
    busy: list[tuple[bytes, object]] = [(b"EXP:BUSY?\n", b"1\n"), (b"EXP:BUSY?\n", b"0\n")]
    camera = camera_at(dialogue([*BEGIN, *INIT, *busy, (b"FETC?\n", frame())]))
    told: list[bool] = []
    taken = camera.grab(lambda: told.append(True))
    assert told == [True]
    assert np.array_equal(taken.picture, PIXELS)
    camera.close()


def test_a_late_frame_is_told_with_one_advice_and_without_a_cable_where_this_machine_serves_it(
    dialogue: Play,
) -> None:
    camera = camera_at(dialogue([*BEGIN, *INIT, (b"FETC?\n", b"")]))
    with pytest.raises(CommunicationError) as told:
        camera.grab()
    said = re.sub(r"[\d.]+ s", "_ s", str(told.value))
    assert said.endswith(
        "no answer within _ s; is `flflab sim` still running? On a busy machine, or while a"
        " defocused picture is simulated, wait and try again"
    )
    assert said.count(";") == 1
    assert (
        what_to_check("10.0.0.7:5025")
        == what_to_check("/dev/ttyUSB0")
        == "check cable, power and address"
    )
    camera.close()


@pytest.mark.parametrize(
    ("exposure", "gain"), [(0.0, 1.0), (11.0, 1.0), (float("nan"), 1.0), (0.01, 0.5), (0.01, 17.0)]
)
def test_an_exposure_outside_the_limits_is_refused_and_not_sent(
    exposure: float, gain: float, dialogue: Play
) -> None:
    camera = camera_at(dialogue(BEGIN))
    with pytest.raises(LimitError, match=r"camera: asked for .* allowed is"):
        camera.prepare(exposure, gain)
    camera.close()


FAULTS: dict[str, tuple[object, str]] = {
    "no frame in time": (b"", "no answer within"),
    "a block cut in the middle of its fields": (frame()[:20], "no answer within"),
    "a line cut in the middle of the block": (None, "the connection is gone"),
    "one byte too many": (frame(end=b"\xff\n"), "after a block of 12 bytes"),
    "a length that is too short": (frame(head="#211"), "after a block of 11 bytes"),
    "an endless block": (frame(head="#9999999999"), "not one of at most 12 bytes"),
    "an indefinite block": (frame(head="#0"), "not one of at most 12 bytes"),
    "a length that is not a number": (frame(head="#2x2"), "not one of at most 12 bytes"),
    "a field too few": (frame().replace(b"1,1700000000.25,", b"1,"), "where 7 fields are due"),
    "a field that is no number": (
        frame().replace(b"0.01", b"oops"),
        "seven finite numbers are due",
    ),
    "a frame lost before it": (
        frame(number=2, dropped=1),
        "frame number 2 instead of 1, dropped frames 1 instead of 0",
    ),
    "the frame before once more": (frame(number=0), "frame number 0 instead of 1"),
    "another exposure": (frame(exposure="0.02"), "exposure 0.02 instead of 0.01"),
    "another size": (frame(size="2,3"), "columns 2 instead of 3"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_frame_that_is_not_the_one_asked_for_is_an_error_and_the_next_one_is_good(
    fault: str, dialogue: Play
) -> None:
    came, says = FAULTS[fault]
    anew = [*ALIVE, *BEGIN, (b"*CLS;INIT;SYST:ERR?\n", NONE), (b"FETC?\n", frame())]
    camera = camera_at(dialogue([*BEGIN, *INIT, (b"FETC?\n", came), *anew]))
    with pytest.raises(CommunicationError, match=says):
        camera.grab()
    taken = camera.grab()
    assert np.array_equal(taken.picture, PIXELS)
    assert (taken.number, taken.dropped) == (2, 1)
    camera.close()


def test_a_frame_the_camera_lost_is_an_error_with_the_cameras_reason(dialogue: Play) -> None:
    empty = b"0,0,0,0,0,0,1,#10\n"
    camera = camera_at(
        dialogue(
            [
                *BEGIN,
                *INIT,
                (b"FETC?\n", empty),
                (b"SYST:ERR?\n", b'-230,"Data corrupt or stale;frame 1 lost"\n'),
            ]
        )
    )
    with pytest.raises(CommunicationError, match="-230 Data corrupt or stale;frame 1 lost"):
        camera.grab()
    camera.close()


def test_a_large_frame_that_comes_in_pieces_is_whole(dialogue: Play) -> None:
    block = (np.arange(1200 * 900) % 4096).astype("<u2").tobytes()
    size = [
        (question, answer.replace(b"3,2;", b"1200,900;") if isinstance(answer, bytes) else answer)
        for question, answer in BEGIN
    ]
    answer = b"1,1700000000.25,0.01,1,1200,900,0,#72160000" + block + b"\n"
    camera = camera_at(dialogue([*size, *INIT, (b"FETC?\n", answer)]))
    assert camera.grab().picture.tobytes() == block
    camera.close()


def test_a_camera_that_is_something_else_is_refused(dialogue: Play) -> None:
    with pytest.raises(CommunicationError, match="not an error's number and text"):
        camera_at(dialogue([(b"*CLS;ABOR;*RST;SYST:ERR?\n", b"@01 0 RJ IDLE -- BADCOMMAND\n")]))


def test_a_camera_without_one_of_its_facts_is_refused(dialogue: Play) -> None:
    answer = b'4095;0.05;1e-05;10;1;16;-113,"Undefined header;SENS:OFFS?"\n'
    with pytest.raises(DeviceError, match="-113 Undefined header"):
        camera_at(dialogue([BEGIN[0], (BEGIN[1][0], answer)]))


def test_answers_are_split_outside_quotes_only() -> None:
    assert split('1;"a;b";-222,"x;EXP ""1"";y"') == ["1", '"a;b"', '-222,"x;EXP ""1"";y"']


LIMITS: list[tuple[bytes, object]] = [
    (b"*CLS;LENS:FNUM? MIN;LENS:FNUM? MAX;SYST:ERR?\n", b"2;16;" + NONE)
]
CATALOGUE: list[tuple[bytes, object]] = [
    (b"*CLS;TARG:CAT?;SYST:ERR?\n", b'"four-dot","bars","white","black";' + NONE)
]


def iris_at(address: str) -> Setting[float]:
    return Setting("iris", ScpiIris(ScpiLink("iris", address, timeout=0.3)), timeout=0.5)


def target_at(address: str) -> Setting[str]:
    return Setting("target", ScpiTarget(ScpiLink("target", address, timeout=0.3)), timeout=0.5)


def test_the_iris_moves_and_is_read_back(dialogue: Play) -> None:
    moving = [
        (b"LENS:BUSY?\n", b"1\n"),
        (b"LENS:BUSY?\n", b"0\n"),
        (b"*CLS;LENS:FNUM?;SYST:ERR?\n", b"4;" + NONE),
    ]
    iris = iris_at(dialogue([*LIMITS, (b"*CLS;LENS:FNUM 4.0;SYST:ERR?\n", NONE), *moving]))
    iris.set(4.0).wait(2)
    iris.close()


@pytest.mark.parametrize("f_number", [1.9, 16.1, float("nan"), float("inf")])
def test_an_f_number_outside_the_limits_is_refused(f_number: float, dialogue: Play) -> None:
    iris = iris_at(dialogue(LIMITS))
    with pytest.raises(LimitError, match="allowed is a number from 2 to 16"):
        iris.set(f_number)
    iris.close()


def test_a_stalled_iris_fails_with_the_instruments_words(dialogue: Play) -> None:
    stalled = [
        (b"LENS:BUSY?\n", b"0\n"),
        (b"*CLS;LENS:FNUM?;SYST:ERR?\n", b"5.6;" + NONE),
        (b"SYST:ERR?\n", b'-200,"Execution error;iris stalled"\n'),
    ]
    iris = iris_at(dialogue([*LIMITS, (b"*CLS;LENS:FNUM 4.0;SYST:ERR?\n", NONE), *stalled]))
    with pytest.raises(MotionError, match=r"iris: set to 4.0: ended at 5.6 instead .*iris stalled"):
        iris.set(4.0).wait(2)
    iris.close()


def test_an_iris_that_falls_silent_fails_with_a_sentence(dialogue: Play) -> None:
    iris = iris_at(
        dialogue([*LIMITS, (b"*CLS;LENS:FNUM 4.0;SYST:ERR?\n", NONE), (b"LENS:BUSY?\n", b"")])
    )
    with pytest.raises(CommunicationError, match=r"iris at .*no answer within 0.3 s"):
        iris.set(4.0).wait(2)
    iris.close()


def test_the_wheel_turns_to_a_name_in_its_catalogue_only(dialogue: Play) -> None:
    turning = [(b"TARG:BUSY?\n", b"0\n"), (b"*CLS;TARG:KIND?;SYST:ERR?\n", b'"bars";' + NONE)]
    target = target_at(
        dialogue([*CATALOGUE, (b'*CLS;TARG:KIND "bars";SYST:ERR?\n', NONE), *turning])
    )
    with pytest.raises(LimitError, match="allowed are four-dot, bars, white, black"):
        target.set("siemens star")
    target.set("bars").wait(2)
    target.close()


def test_camera_iris_and_wheel_satisfy_blueskys_promises(dialogue: Play, tmp_path: Path) -> None:
    camera = camera_at(dialogue([*BEGIN, *INIT, (b"FETC?\n", frame())]))
    iris, target = iris_at(dialogue(LIMITS)), target_at(dialogue(CATALOGUE))
    detector = Detector(camera)
    detector.folder = tmp_path
    for promise in ("Triggerable", "Readable"):
        assert isinstance(detector, getattr(protocols, promise)), promise
    for setting in (iris, target):
        for promise in ("Movable", "Readable", "Locatable", "Stoppable", "Checkable", "HasHints"):
            assert isinstance(setting, getattr(protocols, promise)), promise
    detector.trigger().wait(2)
    assert detector.read()["camera_number"]["value"] == 1
    # the frames themselves are in the file beside
    assert detector.describe().keys() - detector.read().keys() == {"camera"}
    detector.close()
    for device in (camera, iris, target):
        device.close()


def taken_in_a_row(dialogue: Play, *frames: bytes) -> Camera:
    pairs: list[tuple[bytes, object]] = [*BEGIN]
    for came in frames:
        pairs += [*INIT, (b"FETC?\n", came)]
    camera = camera_at(dialogue(pairs))
    for _ in frames:
        camera.grab()
    camera.close()
    return camera


def stamped(number: int, stamp: str, pixels: bytes = BLOCK) -> bytes:
    return f"{number},{stamp},0.01,1,3,2,0,#212".encode() + pixels + b"\n"


def test_an_old_picture_under_a_new_number_is_said_once(
    dialogue: Play, capsys: pytest.CaptureFixture[str]
) -> None:
    taken_in_a_row(dialogue, *(stamped(number, f"{number}.5") for number in (1, 2, 3)))
    said = capsys.readouterr().err
    assert said.startswith("flflab: camera: frame 2: the frame has the pixels of the one before")
    assert said.count("\n") == 1


def test_a_clock_that_goes_back_is_said(dialogue: Play, capsys: pytest.CaptureFixture[str]) -> None:
    other = bytes((1,)) + BLOCK[1:]
    taken_in_a_row(dialogue, stamped(1, "1700000000.25"), stamped(2, "1699996400.25", other))
    assert capsys.readouterr().err == (
        "flflab: camera: frame 2: its clock went back by 3.6e+03 s between two frames; see what"
        " sets it\n"
    )


def test_pictures_without_anything_in_them_may_be_alike(
    dialogue: Play, capsys: pytest.CaptureFixture[str]
) -> None:
    taken_in_a_row(dialogue, stamped(1, "1.5", bytes(12)), stamped(2, "2.5", bytes(12)))
    assert capsys.readouterr().err == ""


IMPOSSIBLE = {
    "no full scale": (b"4095;64", b"0;64", "full scale 0 DN, which no camera has"),
    "a full scale of nan": (b"4095;64", b"nan;64", "not finite numbers"),
    "a full scale of inf": (b"4095;64", b"inf;64", "not finite numbers"),
    "exposures turned round": (b"1e-05;10", b"10;1e-05", "exposures of 10 s to 1e-05 s"),
    "no gain": (b"1;16;", b"0;0;", "gains of 0 to 0"),
    "no pixels": (b'3,2;"MONO12"', b'0,0;"MONO12"', "got '0,0', not columns,rows of at least 1,1"),
    "too many pixels": (b"3,2;", b"1000000,1000000;", "at most 500 megapixels"),
    "a size of letters": (b"3,2;", b"64,4x;", "got '64,4x', not columns,rows"),
    "a size of digits of another script": (b"3,2;", "3,²;".encode(), "which is no text"),
    "5,000 digits": (b"3,2;", b"9" * 5000 + b",2;", r"got '9+\.\.\., not columns,rows"),
    "noise below 0": (b"0.01;1;4;3;", b"0.01;1;4;-1;", "its noise is -1 electrons; 0 or more is"),
    "electrons without end": (b"0.01;1;4;3;", b"0.01;1;inf;3;", "not finite numbers"),
    "an exposure of nan": (b"0.01;1;4;3;", b"nan;1;4;3;", "not finite numbers"),
    "an endless error": (b'0,"No', b"-" + b"9" * 5000 + b',"No', "not an error's number and text"),
}


@pytest.mark.parametrize("fault", IMPOSSIBLE)
def test_what_no_camera_says_of_itself_is_refused_in_one_sentence(
    fault: str, dialogue: Play
) -> None:
    old, new, says = IMPOSSIBLE[fault]
    pairs: list[tuple[bytes, object]] = []
    for due, reply in BEGIN:
        changed = bytes(reply).replace(old, new) if isinstance(reply, bytes) else reply
        pairs.append((due, changed))
        if changed != reply:
            break
    with pytest.raises(CommunicationError, match=says) as refusal:
        camera_at(dialogue(pairs))
    assert len(str(refusal.value)) < 400

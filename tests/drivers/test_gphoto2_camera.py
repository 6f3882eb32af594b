"""A tethered camera against libgphoto2's own virtual PTP camera, which serves our raw files.

Its card has room for 26 pictures as long as its library stays loaded: few are taken here, and the
test that fills it has its own process.
"""

import importlib.util
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.base import Camera, Setting
from drivers.cameras.gphoto2 import GphotoCamera, GphotoIris, GphotoKeys, GphotoLink
from flflab.errors import CommunicationError, DeviceError, LimitError
from flflab.files.raw import RawPicture, write_raw

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("gphoto2") is None,
    reason="the virtual camera comes with the wheel for Linux (extra gphoto2)",
)
RAMP = (np.arange(48 * 64).reshape(48, 64) % 4000).astype(np.uint16)
PORT = "usb:001,001"


def put(card: Path, picture: Any = RAMP, white: int = 4095, cut: int | None = None) -> None:
    """Lay a raw file on the card under the name that the virtual camera takes pictures by, and
    nothing else.
    """
    for file in card.iterdir():
        file.unlink()
    write_raw(card / "frame.dng", RawPicture(picture, "rggb", (64, 64, 64, 64), white))
    content = (card / "frame.dng").read_bytes()
    (card / "frame.dng").unlink()
    (card / "frame.jpg").write_bytes(content[:cut])


@pytest.fixture
def link(card: Path) -> Iterator[GphotoLink]:
    put(card)
    link = GphotoLink(PORT)
    yield link
    link.close()


def camera_on(link: GphotoLink, **keys: Any) -> Camera:
    known: dict[str, Any] = {
        "black_level": 64,
        "electrons_per_dn": 2,
        "read_noise_electrons": 3,
        "full_scale": 4095,
    }
    return Camera(
        "camera",
        GphotoCamera(
            link, GphotoKeys.model_validate({"timeout": "1 s", "quiet": "20 ms"} | known | keys)
        ),
    )


def test_a_raw_file_is_released_downloaded_and_read_to_the_bit(link: GphotoLink) -> None:
    camera = camera_on(link)
    camera.prepare(0.02)
    for number in (1, 2):
        frame = camera.grab()
        assert np.array_equal(frame.picture, RAMP)
        assert (frame.exposure_s, frame.pixel_format, frame.number, frame.dropped) == (
            0.02,
            "BayerRG12",
            number,
            0,
        )
    assert camera.identity() == "Nikon DSC D750"


def test_shutter_speeds_are_those_the_camera_offers_and_no_other(link: GphotoLink) -> None:
    camera = camera_on(link)
    assert camera.exposure_limits == (0.0001, 1.0)
    camera.prepare(0.05)
    with pytest.raises(
        LimitError,
        match=r"asked for exposure 0\.03 s; the camera offers 0\.02 s and 0\.05 s beside it",
    ):
        camera.prepare(0.03)
    assert link.value("shutterspeed") == "0.0500s"
    with pytest.raises(LimitError, match="allowed is 1 only"):
        camera.prepare(0.05, 2.0)  # this body's speed cannot be set


def test_the_iris_takes_the_lens_own_f_numbers(link: GphotoLink) -> None:
    iris = Setting[float]("iris", GphotoIris(link))
    iris.set(5.6).wait(5)
    assert iris.value() == 5.6
    with pytest.raises(LimitError, match=r"f-number 6; the camera offers 5\.6 and 6\.3"):
        iris.set(6.0)
    with pytest.raises(LimitError, match=r"from 2\.8 to 22"):
        iris.set(1.4)
    iris.close()
    assert link.value("f-number") == "f/5.6"  # as the body itself says


def test_a_setting_that_the_camera_takes_and_ignores_is_noticed(link: GphotoLink) -> None:
    with pytest.raises(DeviceError, match=r"asked for shutterspeed 0\.0300s, it stays at 0\.0\d+s"):
        camera_on(link, settings={"shutterspeed": "0.0300s"})
    camera_on(link, settings={"exposurecompensation": "1"})
    assert link.value("exposurecompensation") == "1"


@pytest.mark.ci
def test_every_fault_is_one_error_and_the_next_frame_is_good_and_set_as_before(
    link: GphotoLink, card: Path
) -> None:
    camera = camera_on(link)
    camera.prepare(0.02)
    faults = (
        (
            lambda: put(card, cut=3000),
            r"asked for an event|no whole raw file|no file came",
            1,
        ),  # torn: the length is known from before
        (
            lambda: (card / "frame.jpg").unlink(),
            r"asked for a picture|asked for an event|no file came",
            1,
        ),  # nothing is exposed
        (
            lambda: put(card, white=16383),
            r"white level 16383 instead of 4095; correct the camera",
            2,
        ),
        (
            lambda: jpeg(card),
            r"delivered GPH_\d+\.JPG and no raw file; set its picture quality to raw",
            3,
        ),
    )
    for spoil, says, dropped in faults:
        spoil()
        link.close()  # the virtual camera looks at its files' lengths when it is opened
        with pytest.raises(CommunicationError, match=says) as told:
            camera.grab()
        assert str(told.value).startswith("camera")
        # and with it the body as it was: the virtual camera forgets its card only when nobody holds
        # it
        del told
        put(card)
        link.close()
        frame = camera.grab()
        assert np.array_equal(frame.picture, RAMP)
        assert (frame.exposure_s, frame.dropped) == (0.02, dropped)
        assert link.value("shutterspeed") == "0.0200s"


def jpeg(card: Path) -> None:
    assert cv2.imwrite(str(card / "frame.jpg"), RAMP.astype(np.uint8))


@pytest.mark.ci
def test_pictures_somebody_takes_at_the_body_are_no_frames(link: GphotoLink) -> None:
    camera = camera_on(link, quiet="200 ms")
    camera.grab()
    link.ask(
        "a picture", lambda body: body.trigger_capture()
    )  # it is told 0.1 s later, when ours was asked for already
    with pytest.raises(
        CommunicationError, match=r"took GPH_\d+\.JPG and GPH_\d+\.JPG for one exposure"
    ):
        camera.grab()
    assert camera.grab().dropped == 1
    link.ask("a picture", lambda body: body.trigger_capture())
    time.sleep(0.3)
    with pytest.raises(CommunicationError, match=r"took GPH_\d+\.JPG unasked, no frame"):
        camera.grab()
    assert camera.grab().dropped == 1


def test_a_camera_that_is_not_there_is_told_with_what_to_do(card: Path) -> None:
    put(card)
    with pytest.raises(
        CommunicationError,
        match=r"camera at usb:009,009: asked for the model, got libgphoto2's error .*check cable",
    ):
        GphotoLink("usb:009,009")


FILL = """
import sys
from drivers.base import Camera
from drivers.cameras.gphoto2 import GphotoCamera, GphotoKeys, GphotoLink
from flflab.errors import CommunicationError
keys = GphotoKeys(black_level=64, electrons_per_dn=2, read_noise_electrons=3, full_scale=4095, timeout="1 s", quiet="0 ms")
camera = Camera("camera", GphotoCamera(GphotoLink("usb:001,001"), keys))
whole = 0
try:
    while True:
        whole += camera.grab().picture.shape == (48, 64)
except CommunicationError as error:
    print(whole, camera.dropped, error)
print(camera.grab().number)  # opened anew, the virtual camera has an empty card again
"""  # noqa: E501


@pytest.mark.ci
def test_a_full_card_is_an_error_and_no_frame_before_it_is_lost(card: Path) -> None:
    put(card)
    done = subprocess.run(
        [sys.executable, "-c", FILL], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert said[0].startswith(
        "26 1 camera at usb:001,001: no file came within 1.01 s; see that it focuses by hand and"
        " has room"
    ), said
    assert said[1] == "28"

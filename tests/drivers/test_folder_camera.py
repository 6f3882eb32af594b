"""A watched folder by docs/folder-camera.md: files written by somebody else's writers, in every way
they can come.
"""

import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from drivers.base import Camera
from drivers.cameras.folder import FolderKeys, open_camera
from flflab.errors import CommunicationError, DeviceError
from flflab.files.raw import RawPicture, write_raw

PICTURE = (np.arange(60 * 80).reshape(60, 80) % 4000).astype(np.uint16)
Bring = Callable[[Path], None]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "watched").mkdir()
    return tmp_path / "watched"


@pytest.fixture
def aside() -> Iterator[Callable[..., None]]:
    """Do something in a thread, which ends with the test."""
    threads: list[threading.Thread] = []

    def start(task: Callable[..., None], *arguments: Any) -> None:
        threads.append(threading.Thread(target=task, args=arguments))
        threads[-1].start()

    yield start
    for thread in threads:
        thread.join()


def camera_on(folder: Path, **keys: Any) -> Camera:
    settled: dict[str, Any] = {
        "black_level": 64, "electrons_per_dn": 2, "read_noise_electrons": 3, "full_scale": 4095,
        "exposures": ["1 ms", "1 s"], "gains": [1, 8], "settle": "60 ms", "timeout": "0.8 s",
    }  # fmt: skip
    camera = Camera(
        "camera", open_camera(str(folder), FolderKeys.model_validate(settled | keys), None)
    )
    camera.prepare(0.02, 2.0)
    return camera


def dng(
    file: Path,
    picture: Any = PICTURE,
    exposure: float = 0.02,
    iso: float = 200.0,
    white: int = 4095,
    pattern: Any = None,
) -> None:
    write_raw(
        file, RawPicture(picture, pattern, (64, 64, 64, 64), white, exposure_s=exposure, iso=iso)
    )


def in_pieces(source: Path, file: Path, pieces: int = 6, pause: float = 0.04) -> None:
    """Write as a slow program does, and last the two bytes that say what kind of file it is."""
    content = source.read_bytes()
    size = -(-len(content) // pieces)
    with file.open("wb") as stream:
        stream.write(b"\0\0" + content[2:size])
        for start in range(size, len(content), size):
            stream.flush()
            time.sleep(pause)
            stream.write(content[start : start + size])
        stream.seek(0)
        stream.write(content[:2])


def test_a_person_is_asked_and_the_next_file_is_the_frame(
    folder: Path, aside: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    dng(folder / "IMG_0001.dng")  # there before
    camera = camera_on(folder)
    camera.arm()
    camera.trigger()
    assert "camera: take one picture now, 0.02 s at gain 2" in capfd.readouterr().err
    (folder / "IMG_0002.JPG").write_bytes(b"its preview")
    dng(folder / "IMG_0002.dng", pattern="grbg")
    frame = camera.fetch()
    assert np.array_equal(frame.picture, PICTURE)
    assert (frame.exposure_s, frame.gain, frame.pixel_format, frame.number) == (
        0.02,
        2.0,
        "BayerGR12",
        1,
    )
    assert frame.timestamp == pytest.approx(time.time(), abs=5)


@pytest.mark.parametrize("ending", [".dng", ".tiff", ".png"])
def test_a_file_still_being_written_is_never_read_half(
    folder: Path, tmp_path: Path, aside: Any, ending: str
) -> None:
    source = tmp_path / f"whole{ending}"
    if ending == ".tiff":
        tifffile.imwrite(
            source, PICTURE, rowsperstrip=4
        )  # its directory comes first, its numbers after
    elif ending == ".png":
        assert cv2.imwrite(str(source), PICTURE)
    else:
        dng(source)
    camera = camera_on(folder, timeout="10 s")
    camera.arm()
    camera.trigger()
    aside(in_pieces, source, folder / f"IMG_0002{ending}")
    assert np.array_equal(camera.fetch().picture, PICTURE)


def test_a_file_that_has_its_length_before_its_content_is_awaited(
    folder: Path, tmp_path: Path, aside: Any
) -> None:
    dng(tmp_path / "whole.dng")
    content = (tmp_path / "whole.dng").read_bytes()

    def fill() -> None:
        with (folder / "IMG_0003.dng").open("wb") as stream:
            stream.truncate(len(content))
            for start in range(0, len(content), 1000):
                stream.seek(start)
                stream.write(content[start : start + 1000])
                stream.flush()
                time.sleep(0.03)

    camera = camera_on(folder, settle="300 ms", timeout="10 s")
    camera.arm()
    camera.trigger()
    aside(fill)
    assert np.array_equal(camera.fetch().picture, PICTURE)


FAULTS: dict[str, tuple[Bring, str]] = {
    "nothing": (
        lambda folder: None,
        r"no file came within 0\.82 s; see that the shutter is released",
    ),
    "half a file": (
        lambda folder: (
            dng(folder / "a.dng"),
            (folder / "a.dng").write_bytes((folder / "a.dng").read_bytes()[:4000]),
        )[0],
        (
            r"a\.dng is no whole picture after 0\.82 s; .*cannot be read as a raw picture .*take"
            r" the picture again"
        ),
    ),
    "two files": (
        lambda folder: (dng(folder / "a.dng"), dng(folder / "b.dng"))[0],
        r"a\.dng, b\.dng came for one exposure",
    ),
    "another exposure": (
        lambda folder: dng(folder / "a.dng", exposure=0.04),
        r"a\.dng was taken with exposure 0\.04 instead of 0\.02",
    ),
    "another speed": (
        lambda folder: dng(folder / "a.dng", iso=800),
        r"taken with gain 8 instead of 2",
    ),
    "another white level": (
        lambda folder: dng(folder / "a.dng", white=16383),
        r"white level 16383 instead of 4095",
    ),
    "floating point": (
        lambda folder: tifffile.imwrite(folder / "a.tif", PICTURE.astype(np.float32)) and None,
        r"holds float32 numbers",
    ),
    "a folder that is gone": (
        lambda folder: shutil.rmtree(folder),
        r"the folder cannot be read .*check path, network and card reader",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_frame_is_one_error_and_the_next_frame_is_good(folder: Path, fault: str) -> None:
    bring, says = FAULTS[fault]
    camera = camera_on(folder)
    camera.arm()
    camera.trigger()
    bring(folder)
    with pytest.raises(CommunicationError, match=says) as told:
        camera.fetch()
    assert "camera in " in str(told.value)
    folder.mkdir(exist_ok=True)
    camera.arm()
    camera.trigger()
    dng(folder / "z.dng", PICTURE + 1)
    frame = camera.fetch()
    assert np.array_equal(frame.picture, PICTURE + 1)
    assert (frame.number, frame.dropped) == (2, 1)


def test_a_file_nobody_asked_for_is_told_once_and_never_taken(folder: Path) -> None:
    camera = camera_on(folder)
    dng(folder / "stray.dng")
    with pytest.raises(CommunicationError, match=r"stray\.dng came unasked and is no frame"):
        camera.arm()
    camera.arm()
    camera.trigger()
    dng(folder / "IMG_7.dng", PICTURE + 1)
    assert camera.fetch().picture[0, 0] == 1
    assert camera.dropped == 0


def test_a_late_file_is_no_later_frame(folder: Path) -> None:
    for released_by in ("person", "program"):
        camera = camera_on(folder, released_by=released_by, timeout="0.1 s", settle="20 ms")
        camera.arm()
        camera.trigger()
        number = (
            json.loads((folder / "request.json").read_text())["number"]
            if released_by == "program"
            else 20
        )
        with pytest.raises(CommunicationError, match="no file came"):
            camera.fetch()
        assert not (folder / "request.json").exists()  # taken back: nobody exposes for it any more
        dng(folder / f"late{number}.dng", PICTURE + 9)
        camera.arm()
        camera.trigger()
        dng(folder / f"good{number + 1}.dng", PICTURE + 1)
        assert camera.fetch().picture[0, 0] == 1


def test_a_program_is_asked_by_a_number_above_all_that_lie_there(folder: Path) -> None:
    dng(folder / "IMG_0041.dng")
    camera = camera_on(folder, released_by="program")
    camera.arm()
    camera.trigger()
    assert json.loads((folder / "request.json").read_text()) == {
        "number": 42,
        "exposure_s": 0.02,
        "gain": 2.0,
    }
    (folder / "request.json").unlink()
    dng(folder / "IMG_0042.dng", exposure=0.0, iso=0.0)  # it does not say how it was taken
    assert camera.fetch().exposure_s == 0.02


def test_no_folder_and_limits_that_fall_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CommunicationError, match=r"camera in .*nowhere: the folder cannot be read"):
        camera_on(tmp_path / "nowhere")
    with pytest.raises(DeviceError, match=r"exposures run from 1 to 0\.001"):
        camera_on(tmp_path, exposures=["1 s", "1 ms"])

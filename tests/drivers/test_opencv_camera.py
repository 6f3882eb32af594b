"""A camera behind OpenCV: videos and pictures that OpenCV itself wrote, and a live stream from a
server of the test's own.
"""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from drivers.base import Camera
from drivers.cameras.opencv import OpencvKeys, open_camera
from flflab.errors import CommunicationError, DeviceError, LimitError

Pictures = list[npt.NDArray[Any]]
GREY = [
    (np.arange(48 * 64).reshape(48, 64) * 20 + 7 * number).astype(np.uint16) for number in range(4)
]


def keys(**told: Any) -> OpencvKeys:
    known: dict[str, Any] = {
        "black_level": 0, "electrons_per_dn": 2, "read_noise_electrons": 3,
        "exposures": ["10 ms", "10 ms"], "stale": 0, "timeout": "1 s",
    }  # fmt: skip
    return OpencvKeys.model_validate(known | told)


def camera_on(address: object, **told: Any) -> Camera:
    return Camera("camera", open_camera(str(address), keys(**told), None))


def write_video(file: Path, pictures: Pictures, depth: int, colour: bool = False) -> Path:
    rows, columns = pictures[0].shape[:2]
    settings = [
        cv2.VIDEOWRITER_PROP_IS_COLOR,
        int(colour),
        cv2.VIDEOWRITER_PROP_DEPTH,
        cv2.CV_16U if depth == 16 else cv2.CV_8U,
    ]
    writer = cv2.VideoWriter(
        str(file), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), 10, (columns, rows), settings
    )
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return file


def test_sixteen_bits_of_a_video_arrive_to_the_bit_and_in_order(tmp_path: Path) -> None:
    camera = camera_on(write_video(tmp_path / "grey.mkv", GREY, 16), raw=True, full_scale=65535)
    for number, picture in enumerate(GREY, start=1):
        frame = camera.grab()
        assert np.array_equal(frame.picture, picture)
        assert (frame.number, frame.pixel_format) == (number, "Mono16")
    with pytest.raises(
        CommunicationError,
        match=r"gave no frame within 1 s, 4 frames are all there are; check cable",
    ):
        camera.grab()
    with pytest.raises(CommunicationError, match="gave no frame"):
        camera.grab()  # it does not begin anew: no frame comes twice
    assert camera.dropped == 2
    camera.close()


def test_eight_bits_are_the_same_numbers_as_grey_or_as_the_channel_named(tmp_path: Path) -> None:
    grey = [(picture // 300).astype(np.uint8) for picture in GREY]
    camera = camera_on(write_video(tmp_path / "grey.avi", grey, 8))
    assert np.array_equal(camera.grab().picture, grey[0])
    camera.close()
    colours = [np.dstack([picture, picture // 2, picture // 4]) for picture in grey]
    for number, picture in enumerate(colours):
        assert cv2.imwrite(str(tmp_path / f"colour_{number}.png"), picture)
    camera = camera_on(tmp_path / "colour_%d.png", channel="green")
    frame = camera.grab()
    assert np.array_equal(frame.picture, grey[0] // 2)
    assert frame.pixel_format == "G8"
    camera = camera_on(tmp_path / "colour_%d.png")
    with pytest.raises(
        CommunicationError,
        match="gives colours; say in the bench file which is the picture, `channel: green`",
    ):
        camera.grab()


def test_what_the_device_ignores_is_refused_with_what_it_is_at(tmp_path: Path) -> None:
    video = write_video(
        tmp_path / "grey.avi", [(picture // 300).astype(np.uint8) for picture in GREY], 8
    )
    with pytest.raises(
        DeviceError,
        match=r"asked for columns \(640\), the device (takes it and|does not take it and) is at 64",
    ):
        camera_on(video, columns=640)
    camera_on(video, columns=64, rows=48).close()
    with pytest.raises(
        DeviceError,
        match=(
            r"asked for exposure 0\.001 s, OpenCV's FFMPEG sets none; set the device by other means"
        ),
    ):
        camera_on(video, exposures=["1 ms", "10 ms"])
    camera = camera_on(video)
    with pytest.raises(LimitError, match=r"asked for exposure 0\.02 s; allowed is 0\.01 s only"):
        camera.prepare(0.02)
    camera.prepare(0.01)
    assert "FFMPEG" in camera.identity()
    camera.close()


def test_nothing_there_is_told_with_what_to_do(tmp_path: Path) -> None:
    for address in (tmp_path / "nowhere.avi", 97, "http://127.0.0.1:1/stream"):
        with pytest.raises(
            CommunicationError,
            match=r"camera at .*: OpenCV opens nothing there; check number or path, cable",
        ):
            camera_on(address)


class Stream:
    """A network camera: pictures as Motion JPEG over HTTP, one every 20 ms, the number of each in
    its brightness.
    """

    def __init__(self) -> None:
        self.sent = 0
        self.fault = ""
        self._over = threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.address = f"http://127.0.0.1:{self._server.getsockname()[1]}/stream.mjpg"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(TimeoutError, ConnectionError):
                link, _ = self._server.accept()
                with link:
                    if self.fault == "unplugged":
                        continue
                    link.settimeout(1.0)
                    link.recv(4096)
                    link.sendall(
                        b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace;"
                        b" boundary=next\r\n\r\n"
                    )
                    self._play(link)

    def _play(self, link: socket.socket) -> None:
        while not self._over.wait(0.02):
            if self.fault == "unplugged":
                return
            if self.fault == "stalled":
                continue
            self.sent += 1
            _, jpeg = cv2.imencode(
                ".jpg",
                np.full((48, 64), self.sent % 250, np.uint8),
                [cv2.IMWRITE_JPEG_QUALITY, 100],
            )
            link.sendall(
                b"--next\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % jpeg.size
                + jpeg.tobytes()
                + b"\r\n"
            )

    def end(self) -> None:
        self._over.set()
        self._thread.join()
        self._server.close()


@pytest.fixture
def stream() -> Iterator[Stream]:
    stream = Stream()
    yield stream
    stream.end()


@pytest.mark.ci
@pytest.mark.parametrize("stale", [0, 1])
def test_a_live_stream_gives_what_was_sent_after_the_trigger(stream: Stream, stale: int) -> None:
    camera = camera_on(stream.address, stale=stale, timeout="3 s")
    for _ in range(3):
        time.sleep(0.5)  # 25 frames wait, many more than was told
        camera.arm()
        sent = stream.sent
        camera.trigger()
        shown = int(np.median(camera.fetch().picture))
        assert 0 < (shown - sent) % 250 < 125
    camera.close()


@pytest.mark.ci
@pytest.mark.parametrize("fault", ["stalled", "unplugged"])
def test_a_stream_that_ends_or_stalls_is_one_error_and_then_goes_on(
    stream: Stream, fault: str
) -> None:
    camera = camera_on(stream.address, stale=3, timeout="2 s")
    camera.grab()
    stream.fault = fault
    with pytest.raises(
        CommunicationError,
        match=r"camera at http.*: OpenCV opens nothing there; check number or path, cable",
    ):
        camera.grab()
    stream.fault = ""
    assert camera.grab().picture.shape == (48, 64)
    camera.close()


@pytest.mark.ci
@pytest.mark.parametrize("fault", ["stalled", "unplugged"])
def test_a_stream_that_breaks_after_the_trigger_gives_no_frame_in_its_time(
    stream: Stream, fault: str
) -> None:
    device = open_camera(stream.address, keys(stale=3, timeout="2 s"), None)
    device.trigger()
    stream.fault = fault

    def play_on() -> None:
        for _ in range(1000):  # what was on its way before the fault comes first
            device.fetch()

    with pytest.raises(
        CommunicationError,
        match=r"camera at http.*: gave no frame within 2 s; check cable and power",
    ):
        play_on()
    device.close()

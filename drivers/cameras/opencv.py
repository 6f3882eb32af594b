"""Whatever OpenCV opens: a camera of the system by its number, a stream by its URL, a video file,
numbered pictures.

Only what is told here is asked of the device, and each is read back: OpenCV says of many a setting
that it was taken, and the device goes on as before. Units of the exposure are those of OpenCV's
V4L2 backend (100 us) and of DirectShow and Media Foundation (log2 s); on other backends the
exposure is what the bench file says it is. Neither unit was confirmed with a device.
"""

import contextlib
import math
import time
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field

from drivers.camera_commands import SensorKeys, Setup, Taken
from flflab.description import Time
from flflab.errors import CommunicationError, DeviceError

MANUAL = {"V4L2": 1.0, "DSHOW": 0.0, "MSMF": 0.0}  # what switches the automatic exposure off
TICK_S = 1e-4  # of V4L2
SAME = 0.02  # an exposure that differs by more was not set
CHANNELS = {"blue": "B", "green": "G", "red": "R"}
Limits = tuple[Annotated[Time, Field(gt=0)], Annotated[Time, Field(gt=0)]]


class OpencvKeys(SensorKeys):
    """The keys of an OpenCV camera.

    ``full_scale``: what a saturated pixel reads; 255 where it gives 8 bits. ``exposures``: shortest
    and longest exposure it can be set to; the same twice for one that is set by other means.
    ``columns``, ``rows``: what to ask for. ``raw``: the numbers as the device sends them, not
    turned into colours. ``channel``: which plane of a colour picture is the picture. ``stale``: how
    many frames wait in the device and are thrown away before each; 0 for a file. A stream is opened
    anew for each picture, so that none waits here. ``timeout``: how long a frame may take beyond
    the exposure.
    """

    full_scale: Annotated[int, Field(gt=0, le=65535)] = 255
    exposures: Limits
    columns: Annotated[int, Field(gt=0)] | None = None
    rows: Annotated[int, Field(gt=0)] | None = None
    raw: bool = False
    channel: Literal["blue", "green", "red"] | None = None
    stale: Annotated[int, Field(ge=0)] = 5
    timeout: Annotated[Time, Field(gt=0)] = 5.0


class OpencvCamera:
    """A camera behind ``cv2.VideoCapture``; satisfies ``CameraCommands``.

    Args:
        address: number of a device, URL, file, or pattern of numbered files
            (``shots/frame_%03d.png``).
        keys: what the bench file says of it.

    Raises:
        CommunicationError: OpenCV opens nothing there.
        DeviceError: the device does not become what was asked.
    """

    offered_exposures: tuple[float, ...] = ()

    gain_limits = (1.0, 1.0)

    def __init__(self, address: str, keys: OpencvKeys) -> None:
        self._address, self._keys = address, keys
        self._who = f"camera at {address}"
        self.exposure_limits = keys.exposures
        self._capture: Any = None
        self._stream = "://" in address
        self._live = address.isdigit() or self._stream
        self._exposing_since = 0.0
        self._played = (
            0  # frames of a file, which goes on where it was after a fault: no frame twice
        )
        self.setup: Setup = keys.setup(keys.exposures[0], 1.0, "", keys.full_scale)
        self._opened()

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Set the exposure and read it back; where the bench file gives one exposure only, nothing
        is set.

        Raises:
            DeviceError: the device ignores it, or takes another.
        """
        self._set_exposure(self._opened(), exposure_s)
        self.setup = self._keys.setup(exposure_s, gain, "", self._keys.full_scale)

    def arm(self) -> None:
        """See that it is open."""
        self._opened()

    def trigger(self) -> None:
        """Throw away what was exposed before: the frames that wait in the device and, of a stream,
        all that was sent until now.

        How many frames of a stream wait in buffers on the way here nobody tells, nor does the time
        that one takes to come on a busy machine; what a new connection brings was sent after it was
        opened.

        Raises:
            CommunicationError: it gives no frames.
        """
        if self._stream:
            self.close()
        self._exposing_since = time.time()
        for _ in range(self._keys.stale):
            if not self._opened().grab():
                raise self._no_frame()

    def exposing(self) -> None:
        """Only its picture can tell."""

    def fetch(self) -> Taken:
        """Wait for the next frame.

        Raises:
            CommunicationError: it does not come, or is no picture of one plane.
        """
        came, picture = self._opened().read()
        if not came or picture is None:
            raise self._no_frame()
        self._played += not self._live
        plane, pixel_format = self._plane(np.asarray(picture))
        return Taken(
            plane, self.setup.exposure_s, self.setup.gain, self._exposing_since, pixel_format
        )

    def reset(self) -> None:
        """Let go of it; the next question opens it anew."""
        self.close()

    def identity(self) -> str:
        """The backend of OpenCV that reads it; the device itself tells nothing."""
        return f"OpenCV {cv2.__version__}, {self._opened().getBackendName()}"

    def close(self) -> None:
        """Let go of it."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _opened(self) -> Any:
        """The capture, opened anew after a fault.

        Raises:
            CommunicationError: OpenCV opens nothing there.
            DeviceError: it does not become what was asked.
        """
        if self._capture is None:
            milliseconds = math.ceil(1000 * (self._keys.timeout + self.setup.exposure_s))
            waits = [
                cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
                milliseconds,
                cv2.CAP_PROP_READ_TIMEOUT_MSEC,
                milliseconds,
            ]
            if self._address.isdigit():
                capture = cv2.VideoCapture(int(self._address))
            elif "%" in self._address:
                capture = cv2.VideoCapture(self._address, cv2.CAP_IMAGES)
            else:
                capture = cv2.VideoCapture(self._address, cv2.CAP_FFMPEG, waits)
            if not capture.isOpened():
                capture.release()
                raise CommunicationError(
                    f"{self._who}: OpenCV opens nothing there; check number or path, cable, and who"
                    " else uses it"
                )
            self._capture = capture
            try:
                self._set_up(capture)
                for _ in range(self._played):
                    capture.grab()
            except DeviceError:
                self.close()
                raise
        return self._capture

    def _set_up(self, capture: Any) -> None:
        for what, code, asked in (
            ("columns", cv2.CAP_PROP_FRAME_WIDTH, self._keys.columns),
            ("rows", cv2.CAP_PROP_FRAME_HEIGHT, self._keys.rows),
        ):
            if asked is not None and round(capture.get(code)) != asked:
                self._set(capture, what, code, asked, asked)
        if (
            self._keys.raw and capture.getBackendName() != "CV_IMAGES"
        ):  # which reads files as they are
            self._set(capture, "raw numbers (CONVERT_RGB 0)", cv2.CAP_PROP_CONVERT_RGB, 0, 0)
        self._set_exposure(capture, self.setup.exposure_s)

    def _set_exposure(self, capture: Any, exposure_s: float) -> None:
        least, most = self._keys.exposures
        if least == most:
            return
        backend = capture.getBackendName()
        if backend not in MANUAL:
            raise DeviceError(
                f"{self._who}: asked for exposure {exposure_s:g} s, OpenCV's {backend} sets none;"
                " set the device by other means and give that exposure twice as `exposures`"
            )
        self._set(
            capture,
            "automatic exposure off",
            cv2.CAP_PROP_AUTO_EXPOSURE,
            MANUAL[backend],
            MANUAL[backend],
        )
        native = exposure_s / TICK_S if backend == "V4L2" else math.log2(exposure_s)
        slack = SAME * native if backend == "V4L2" else math.log2(1 + SAME)
        self._set(
            capture, f"exposure {exposure_s:g} s", cv2.CAP_PROP_EXPOSURE, native, native, slack
        )

    def _set(
        self, capture: Any, what: str, code: int, value: float, due: float, slack: float = 0.0
    ) -> None:
        """Set a property and compare what was asked with what the device then says.

        Raises:
            DeviceError: they differ.
        """
        taken = capture.set(code, value)
        now = capture.get(code)
        if not taken or abs(now - due) > slack:
            said = "does not take it" if not taken else "takes it"
            raise DeviceError(
                f"{self._who}: asked for {what} ({value:g}), the device {said} and is at {now:g}; "
                "give in the bench file what it can do, or another backend's address"
            )

    def _plane(self, picture: npt.NDArray[Any]) -> tuple[npt.NDArray[np.uint16], str]:
        """The picture as one plane, and its pixel format.

        Raises:
            CommunicationError: it is in colours and no channel was chosen, or of another kind.
        """
        letter = "Mono"
        if picture.ndim == 3 and picture.shape[2] == 3:
            if self._keys.channel is not None:
                letter = CHANNELS[self._keys.channel]
                picture = picture[..., list(CHANNELS).index(self._keys.channel)]
            elif np.array_equal(picture[..., 0], picture[..., 1]) and np.array_equal(
                picture[..., 0], picture[..., 2]
            ):
                picture = picture[..., 0]
            else:
                raise CommunicationError(
                    f"{self._who}: gives colours; say in the bench file which is the picture,"
                    " `channel: green`"
                )
        if picture.ndim != 2 or picture.dtype.name not in ("uint8", "uint16"):
            raise CommunicationError(
                f"{self._who}: gives {picture.shape} numbers of {picture.dtype}; a plane of 8 or 16"
                " bits is due"
            )
        return picture.astype(np.uint16), f"{letter}{self._keys.full_scale.bit_length()}"

    def _no_frame(self) -> CommunicationError:
        played = ""
        with contextlib.suppress(AttributeError):
            last, count = (
                self._capture.get(cv2.CAP_PROP_POS_FRAMES),
                self._capture.get(cv2.CAP_PROP_FRAME_COUNT),
            )
            played = f", {count:.0f} frames are all there are" if 0 < count <= last else ""
        return CommunicationError(
            f"{self._who}: gave no frame within {self._keys.timeout:g} s{played}; check cable and"
            " power, then try again"
        )


def open_camera(address: str, keys: OpencvKeys, share: object) -> OpencvCamera:
    """Open a camera.

    Raises:
        DeviceError: exposures that fall, or the device does not become what was asked.
        CommunicationError: there is none.
    """
    if keys.exposures[0] > keys.exposures[1]:
        least, most = keys.exposures
        raise DeviceError(
            f"camera: exposures run from {least:g} s to {most:g} s; the first must not be above the"
            " second"
        )
    return OpencvCamera(address, keys)

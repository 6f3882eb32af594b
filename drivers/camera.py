"""What a camera promises: a frame with what it was taken with, and the facts of its noise."""

import threading
import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from drivers.status import Status


@dataclass(frozen=True)
class Frame:
    """One picture as the sensor gave it.

    ``picture`` is [row, column] in DN: columns rise with world x, rows with world y. ``timestamp`` is the camera's own clock,
    s since 1970. ``number`` rises by one with every exposure; ``dropped`` counts the frames lost since the camera was opened.
    """

    picture: npt.NDArray[np.uint16]
    exposure_s: float
    gain: float
    timestamp: float
    number: int
    dropped: int


class CameraDevice(Protocol):
    """A camera. The facts in DN are those at the gain last prepared."""

    name: str
    full_scale: int
    dn_per_electron: float
    read_noise_dn: float
    offset_dn: float
    exposure_limits: tuple[float, float]

    def prepare(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure time in s and gain.

        Raises:
            LimitError: outside what the camera can do.
            CommunicationError: it does not answer.
        """
        ...

    def grab(self) -> Frame:
        """Take one picture now.

        Raises:
            CommunicationError: the frame came late, torn, lost or out of turn.
        """
        ...

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the camera tells."""
        ...

    def close(self) -> None:
        """Let go of the camera; raises nothing."""
        ...


class Detector:
    """A camera as bluesky triggers and reads it; ``latest`` is the frame of the last trigger.

    Args:
        camera: any camera.
    """

    parent = None

    def __init__(self, camera: CameraDevice) -> None:
        self.name = camera.name
        self.camera = camera
        self.latest: Frame | None = None

    def trigger(self) -> Status:
        """Take one picture in a thread."""
        status = Status(f"{self.name}: take a picture")

        def take() -> None:
            try:
                self.latest = self.camera.grab()
            except Exception as error:
                status.complete(error)
            else:
                status.complete()

        threading.Thread(target=take, name=f"grab {self.name}", daemon=True).start()
        return status

    def read(self) -> dict[str, Any]:
        """What the last picture was taken with; empty numbers before the first."""
        now, frame = time.time(), self.latest
        values = (0, 0, 0.0, 0.0) if frame is None else (frame.number, frame.dropped, frame.exposure_s, frame.gain)
        return {key: {"value": value, "timestamp": now} for key, value in zip(self.describe(), values, strict=True)}

    def describe(self) -> dict[str, Any]:
        """What ``read`` returns."""
        source = f"camera {self.name}"
        return {
            f"{self.name}_number": {"source": source, "dtype": "integer", "shape": []},
            f"{self.name}_dropped": {"source": source, "dtype": "integer", "shape": []},
            f"{self.name}_exposure_s": {"source": source, "dtype": "number", "shape": [], "units": "s"},
            f"{self.name}_gain": {"source": source, "dtype": "number", "shape": []},
        }

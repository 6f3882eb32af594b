"""What cameras with GenICam features share, whoever carries them: exposure, gain, pixel format,
trigger, by their standard names.

Names and units are those of GenICam's Standard Features Naming Convention, and the older names of
Basler's GigE cameras beside them.
"""

import math
import re
from typing import Annotated, Any, Protocol

import numpy as np
import numpy.typing as npt
from pydantic import Field

from drivers.camera_commands import SensorKeys, Setup
from flflab.description import Time
from flflab.errors import CommunicationError, DeviceError

EXPOSURES = ("ExposureTime", "ExposureTimeAbs")  # us
MICROSECOND = 1e-6
SAME = (
    0.02  # a camera rounds to its own steps; more than this share away is another exposure or gain
)
AUTOMATIC = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
TRIGGER = (("TriggerSelector", "FrameStart"), ("TriggerMode", "On"), ("TriggerSource", "Software"))
UNPACKED = re.compile(r"(Mono|Bayer(?:RG|BG|GR|GB))(8|10|12|14|16)")


class Nodes(Protocol):
    """The features of one camera by name."""

    def has(self, name: str) -> bool:
        """Whether there is one that can be read now."""
        ...

    def read(self, name: str) -> Any:
        """Its value."""
        ...

    def write(self, name: str, value: str | float) -> None:
        """Set it.

        Raises:
            DeviceError: the camera refuses.
        """
        ...

    def limits(self, name: str) -> tuple[float, float]:
        """Least and largest value of a number."""
        ...

    def unit(self, name: str) -> str:
        """Unit of a number, as the camera has it."""
        ...


class GenicamSensorKeys(SensorKeys):
    """The keys of a camera with GenICam features.

    ``pixel_format``: one with a whole number of bytes a pixel, ``Mono12`` or ``BayerRG12``.
    ``exposure``: of a camera whose exposure cannot be set. ``settings``: other features to set on
    opening. ``timeout``: how long a frame may come after the exposure.
    """

    pixel_format: str = "Mono8"
    columns: Annotated[int, Field(gt=0)] | None = None
    rows: Annotated[int, Field(gt=0)] | None = None
    exposure: Annotated[Time, Field(gt=0)] | None = None
    settings: dict[str, str | float] = {}
    timeout: Annotated[Time, Field(gt=0)] = 5.0


class GenicamSettings:
    """Everything about a camera but its frames.

    Args:
        who: the camera, for messages.
        nodes: its features.
        keys: what the bench file says of it.

    Raises:
        DeviceError: it does not become what was asked, or its exposure is unknown.
    """

    def __init__(self, who: str, nodes: Nodes, keys: GenicamSensorKeys) -> None:
        self._who, self._nodes, self._keys = who, nodes, keys
        found = UNPACKED.fullmatch(keys.pixel_format)
        if found is None:
            raise DeviceError(
                f"{who}: pixel_format {keys.pixel_format} cannot be taken; give Mono8 to Mono16 or"
                " BayerRG8 and so on, unpacked"
            )
        self._full_scale = 2 ** int(found[2]) - 1
        for name in AUTOMATIC:
            if nodes.has(name):
                self._set(name, "Off")
        size = {"Width": keys.columns, "Height": keys.rows}
        for name, value in ({"PixelFormat": keys.pixel_format} | size | keys.settings).items():
            if value is not None:
                self._set(name, value)
        self.software_trigger = nodes.has("TriggerMode") and nodes.has("TriggerSoftware")
        if self.software_trigger:
            for name, value in TRIGGER:
                if nodes.has(name):
                    self._set(name, value)
        self._exposure = next((name for name in EXPOSURES if nodes.has(name)), "")
        self._gain = "Gain" if nodes.has("Gain") else ""
        if not self._exposure and keys.exposure is None:
            raise DeviceError(
                f"{who}: its exposure can be neither set nor read; give in the bench file what it"
                " is, `exposure: 10 ms`"
            )
        self.exposure_limits, self.gain_limits = self._limits()
        self.setup = self._read_back()

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Set both and read back what the camera made of them.

        Raises:
            DeviceError: something else.
        """
        if self._exposure:
            self._set(self._exposure, exposure_s / MICROSECOND)
        if self._gain:
            self._set(self._gain, 20 * math.log10(gain) if self._decibel else gain)
        self.setup = self._read_back()

    def plane(
        self, values: npt.NDArray[Any], columns: int, rows: int, pixel_format: str
    ) -> npt.NDArray[np.uint16]:
        """The picture, from the numbers of a buffer.

        Raises:
            CommunicationError: it has another format or size than was set.
        """
        if pixel_format != self._keys.pixel_format or values.size != columns * rows:
            raise CommunicationError(
                f"{self._who}: sent {values.size} numbers of {pixel_format} for {columns} x {rows},"
                f" {self._keys.pixel_format} is due; see who else sets it up, then take it again"
            )
        return values.reshape(rows, columns).astype(np.uint16)

    @property
    def _decibel(self) -> bool:
        return self._nodes.unit(self._gain).lower() == "db"

    def _limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        fixed = self._keys.exposure or 0.0
        exposures, gains = (fixed, fixed), (1.0, 1.0)
        if self._exposure:
            least, most = self._nodes.limits(self._exposure)
            exposures = (least * MICROSECOND, most * MICROSECOND)
        if self._gain:
            least, most = self._nodes.limits(self._gain)
            gains = (10 ** (least / 20), 10 ** (most / 20)) if self._decibel else (least, most)
        return exposures, gains

    def _read_back(self) -> Setup:
        exposure_s = (
            float(self._nodes.read(self._exposure)) * MICROSECOND
            if self._exposure
            else self._keys.exposure or 0.0
        )
        gain = float(self._nodes.read(self._gain)) if self._gain else 1.0
        if self._gain and self._decibel:
            gain = 10 ** (gain / 20)
        return self._keys.setup(exposure_s, gain, self._keys.pixel_format, self._full_scale)

    def _set(self, name: str, value: str | float) -> None:
        """Set a feature and read it back.

        Raises:
            DeviceError: the camera has no such one, refuses, or makes something else of it.
        """
        if not self._nodes.has(name):
            raise DeviceError(
                f"{self._who}: asked for {name} {value}, the camera has no such feature; take it"
                " out of the bench file"
            )
        self._nodes.write(name, value)
        now = self._nodes.read(name)
        same = (
            str(now) == value
            if isinstance(value, str)
            else math.isclose(float(now), value, rel_tol=SAME, abs_tol=1e-3)
        )
        if not same:
            raise DeviceError(
                f"{self._who}: asked for {name} {value}, the camera made {now} of it; give what it"
                " can do"
            )


def next_frame_number(who: str, last: int | None, came: int) -> int:
    """The camera's own number of a frame, which rises by one.

    Raises:
        CommunicationError: frames before it were lost, or it came before. After 65535 a GigE camera
            begins anew.
    """
    due = None if last is None else (last + 1,) if last < 65535 else (last + 1, 0, 1)
    if due is not None and came not in due:
        raise CommunicationError(
            f"{who}: its frame number {came} came where {due[0]} is due, one was lost or doubled;"
            " take the picture again"
        )
    return came

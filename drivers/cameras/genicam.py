"""An industrial camera of any maker through a GenTL producer, carried by harvesters (extra
``genicam``).

A camera with a software trigger is triggered; one without runs freely and is started for each
frame, whose exposure then begins after the trigger. Tried against the producer ``viky`` of the
genicam package, which has neither trigger nor exposure; no real camera was.
"""

import contextlib
import os
import time
from pathlib import Path
from typing import Any

from drivers.camera_commands import Setup, Taken
from drivers.genicam_nodes import GenicamSensorKeys, GenicamSettings, next_frame_number
from flflab.errors import CommunicationError, DeviceError


class GenicamKeys(GenicamSensorKeys):
    """``producer``: the camera maker's GenTL producer, a .cti file; empty takes every one in
    ``GENICAM_GENTL64_PATH``.
    """

    producer: str = ""


class HarvestersNodes:
    """Features as harvesters gives them; satisfies ``Nodes``."""

    def __init__(self, who: str, node_map: Any) -> None:
        self._who, self._map = who, node_map

    def has(self, name: str) -> bool:
        """Whether there is one."""
        return bool(self._map.has_node(name))

    def read(self, name: str) -> Any:
        """Its value."""
        return self._map.get_node(name).value

    def write(self, name: str, value: str | float) -> None:
        """Set it."""
        from genicam.genapi import GenericException

        node = self._map.get_node(name)
        try:
            node.value = (
                int(value) if isinstance(node.value, int) and not isinstance(value, str) else value
            )
        except (GenericException, TypeError, ValueError) as error:
            raise DeviceError(
                f"{self._who}: asked for {name} {value}, refused: {error}; give what the camera"
                " can do"
            ) from error

    def limits(self, name: str) -> tuple[float, float]:
        """Least and largest value."""
        node = self._map.get_node(name)
        return float(node.min), float(node.max)

    def unit(self, name: str) -> str:
        """Its unit."""
        return str(self._map.get_node(name).unit)


class GenicamCamera:
    """A camera behind a GenTL producer; satisfies ``CameraCommands``.

    Args:
        address: its id, serial number or model as the producer lists them; empty for the only one.
        keys: what the bench file says of it.

    Raises:
        CommunicationError: the library, the producer or the camera is missing.
        DeviceError: it does not become what was asked.
    """

    offered_exposures: tuple[float, ...] = ()

    def __init__(self, address: str, keys: GenicamKeys) -> None:
        self._address, self._keys = address, keys
        self._who = f"camera {address or '(the only one)'}"
        self._harvester: Any = None
        self._acquirer: Any = None
        self._number: int | None = None
        self._triggered_at = 0.0
        self._prepared: tuple[float, float] | None = None
        self._open()

    @property
    def exposure_limits(self) -> tuple[float, float]:
        """Shortest and longest exposure, s."""
        return self._settings.exposure_limits

    @property
    def gain_limits(self) -> tuple[float, float]:
        """Least and largest gain."""
        return self._settings.gain_limits

    @property
    def setup(self) -> Setup:
        """What it is set to."""
        return self._settings.setup

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Set both."""
        self._prepared = (exposure_s, gain)
        self._open()
        self._asked("exposure and gain", lambda: self._settings.prepare(exposure_s, gain))

    def arm(self) -> None:
        """See that it is open; one with a trigger waits for it from here on."""
        self._open()
        if self._settings.software_trigger and not self._acquirer.is_acquiring():
            self._asked("acquisition", self._acquirer.start)
            self._number = None

    def trigger(self) -> None:
        """Trigger it, or start it where it runs freely."""
        self._triggered_at = time.time()
        if self._settings.software_trigger:
            self._asked("a picture", self._acquirer.remote_device.node_map.TriggerSoftware.execute)
            return
        self._number = None  # a stream counts anew from its start
        self._asked("a picture", self._acquirer.start)

    def exposing(self) -> None:
        """Only its picture can tell."""

    def fetch(self) -> Taken:
        """Wait for the frame.

        Raises:
            CommunicationError: none came, it is torn, or frames were lost before it.
        """
        patience = self.setup.exposure_s + self._keys.timeout
        buffer = self._asked("a frame", lambda: self._acquirer.try_fetch(timeout=patience))
        if buffer is None:
            raise CommunicationError(
                f"{self._who}: no whole frame came within {patience:g} s; check cable and"
                " bandwidth, then try again"
            )
        try:
            self._number = next_frame_number(self._who, self._number, int(buffer.module.frame_id))
            part = buffer.payload.components[0]
            picture = self._settings.plane(part.data, part.width, part.height, part.data_format)
        finally:
            buffer.queue()
        if not self._settings.software_trigger:
            self._asked("an end", self._acquirer.stop)
        return Taken(
            picture,
            self.setup.exposure_s,
            self.setup.gain,
            self._triggered_at,
            self.setup.pixel_format,
        )

    def reset(self) -> None:
        """Let go of it; ``arm`` opens it anew."""
        self.close()

    def identity(self) -> str:
        """Maker, model, serial number and version as the producer lists them."""
        self._open()
        info = self._acquirer.device.module
        return ", ".join(
            str(fact)
            for fact in (info.vendor, info.model, info.serial_number, info.version)
            if fact
        )

    def close(self) -> None:
        """Let go of camera and producer."""
        if self._acquirer is not None:
            with contextlib.suppress(Exception):  # the camera may be gone
                self._acquirer.destroy()
            self._acquirer = None
        if self._harvester is not None:
            with contextlib.suppress(Exception):
                self._harvester.reset()
            self._harvester = None

    def _open(self) -> None:
        if self._acquirer is not None:
            return
        try:
            from harvesters.core import Harvester
        except ImportError as error:
            raise CommunicationError(
                f"driver genicam: harvesters cannot be loaded ({error}); where it is missing:"
                " pip install 'flflab[genicam]'"
            ) from error
        self._harvester = Harvester()
        try:
            for file in self._producers():
                self._asked(
                    f"producer {file}", lambda file=file: self._harvester.add_file(str(file))
                )
            self._asked("its cameras", self._harvester.update)
            self._acquirer = self._asked(
                "the camera", lambda: self._harvester.create(self._place())
            )
            nodes = HarvestersNodes(self._who, self._acquirer.remote_device.node_map)
            self._settings = self._asked(
                "its features", lambda: GenicamSettings(self._who, nodes, self._keys)
            )
            if self._prepared is not None:
                self._settings.prepare(*self._prepared)
        except BaseException:
            self.close()
            raise

    def _producers(self) -> list[Path]:
        if self._keys.producer:
            files = [Path(self._keys.producer).expanduser()]
        else:
            folders = [
                Path(folder)
                for folder in os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep)
                if folder
            ]
            files = [file for folder in folders for file in sorted(folder.glob("*.cti"))]
        if not files or not all(file.is_file() for file in files):
            missing = ", ".join(map(str, files)) or "GENICAM_GENTL64_PATH names none"
            raise CommunicationError(
                f"{self._who}: there is no GenTL producer ({missing}); give the maker's .cti file"
                " as `producer`"
            )
        return files

    def _place(self) -> int:
        """Which of the cameras listed it is."""
        listed = self._harvester.device_info_list
        names = [(info.id_, info.serial_number, info.model) for info in listed]
        found = (
            [place for place, known in enumerate(names) if self._address in known]
            if self._address
            else list(range(len(names)))
        )
        if len(found) != 1:
            said = (
                "; ".join(" / ".join(str(name) for name in known if name) for known in names)
                or "no camera"
            )
            raise CommunicationError(
                f"{self._who}: {len(found)} cameras answer to that; there are {said}; give an id as"
                " the address"
            )
        return found[0]

    def _asked(self, what: str, question: Any) -> Any:
        """What the library answers.

        Raises:
            CommunicationError: it reports an error of camera or producer.
        """
        from genicam.genapi import GenericException
        from genicam.gentl import GenericException as TransportException

        try:
            return question()
        except (GenericException, TransportException, OSError) as error:
            raise CommunicationError(
                f"{self._who}: asked for {what}, got {error}; check cable, power, and who else"
                " holds it"
            ) from error


def open_camera(address: str, keys: GenicamKeys, share: object) -> GenicamCamera:
    """Open a camera."""
    return GenicamCamera(address, keys)

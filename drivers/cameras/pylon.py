"""A Basler camera through pypylon (extra ``basler``); tried against pylon's own emulated cameras,
no real one was.
"""

import contextlib
import time
from typing import Any

from drivers.camera_commands import Setup, Taken
from drivers.genicam_nodes import GenicamSensorKeys, GenicamSettings, next_frame_number
from flflab.errors import CommunicationError, DeviceError


class PylonKeys(GenicamSensorKeys):
    """The keys of a Basler camera are those of any camera with GenICam features."""


class PylonNodes:
    """Features as pypylon gives them; satisfies ``Nodes``."""

    def __init__(self, who: str, camera: Any, errors: type[Exception]) -> None:
        self._who, self._map, self._errors = who, camera.GetNodeMap(), errors

    def has(self, name: str) -> bool:
        """Whether there is one that the camera has now."""
        # an extra that the checks do without
        from pypylon import genicam  # pyright: ignore[reportMissingImports]

        node = self._map.GetNode(name)
        return node is not None and (genicam.IsReadable(node) or genicam.IsWritable(node))

    def read(self, name: str) -> Any:
        """Its value."""
        return self._map.GetNode(name).Value

    def write(self, name: str, value: str | float) -> None:
        """Set it."""
        node = self._map.GetNode(name)
        try:
            node.Value = (
                int(value) if isinstance(node.Value, int) and not isinstance(value, str) else value
            )
        except (self._errors, TypeError) as error:
            raise DeviceError(
                f"{self._who}: asked for {name} {value}, refused: {error}; give what the camera"
                " can do"
            ) from error

    def limits(self, name: str) -> tuple[float, float]:
        """Least and largest value."""
        node = self._map.GetNode(name)
        return float(node.Min), float(node.Max)

    def unit(self, name: str) -> str:
        """Its unit."""
        return str(self._map.GetNode(name).Unit)


class PylonCamera:
    """A Basler camera under a software trigger; satisfies ``CameraCommands``.

    Args:
        address: its serial number; empty for the only one.
        keys: what the bench file says of it.

    Raises:
        CommunicationError: the library or the camera is missing.
        DeviceError: it does not become what was asked.
    """

    offered_exposures: tuple[float, ...] = ()

    def __init__(self, address: str, keys: PylonKeys) -> None:
        try:
            from pypylon import genicam, pylon  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise CommunicationError(
                f"driver pylon: pypylon cannot be loaded ({error}); where it is missing:"
                " pip install 'flflab[basler]'"
            ) from error
        self._pylon: Any = pylon
        self._errors: type[Exception] = genicam.GenericException
        self._address, self._keys = address, keys
        self._who = f"camera {address or '(the only one)'}"
        self._camera: Any = None
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
        """Wait for triggers from here on, and until the camera takes one.

        Raises:
            CommunicationError: it takes none, or sent frames that nobody asked for.
        """
        self._open()
        if not self._camera.IsGrabbing():
            self._asked(
                "acquisition", lambda: self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
            )
            self._number = None
        wait_ms = int(1000 * self._keys.timeout)
        if not self._asked(
            "readiness",
            lambda: self._camera.WaitForFrameTriggerReady(
                wait_ms, self._pylon.TimeoutHandling_Return
            ),
        ):
            raise CommunicationError(
                f"{self._who}: takes no trigger within {self._keys.timeout:g} s; check its cable,"
                " then take the picture again"
            )
        if self._asked("waiting frames", lambda: self._camera.GetGrabResultWaitObject().Wait(0)):
            raise CommunicationError(
                f"{self._who}: sent frames unasked; see who else triggers it, then take the picture"
                " again"
            )

    def trigger(self) -> None:
        """Trigger it."""
        self._triggered_at = time.time()
        self._asked("a picture", self._camera.ExecuteSoftwareTrigger)

    def exposing(self) -> None:
        """Only its picture can tell."""

    def fetch(self) -> Taken:
        """Wait for the frame.

        Raises:
            CommunicationError: none came, it is torn, or frames were lost before it.
        """
        patience = self.setup.exposure_s + self._keys.timeout
        result = self._asked(
            "a frame",
            lambda: self._camera.RetrieveResult(
                int(1000 * patience), self._pylon.TimeoutHandling_Return
            ),
        )
        try:
            if result is None or not result.IsValid():
                raise CommunicationError(
                    f"{self._who}: no frame came within {patience:g} s; check cable and power, then"
                    " take it again"
                )
            if not result.GrabSucceeded():
                raise CommunicationError(
                    f"{self._who}: the frame is torn ({result.ErrorDescription}); check cable and"
                    " bandwidth, then take it again"
                )
            self._number = next_frame_number(self._who, self._number, int(result.GetBlockID()))
            picture = self._settings.plane(
                result.Array, result.Width, result.Height, self.setup.pixel_format
            )
        finally:
            if result is not None:
                result.Release()
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
        """Maker, model, serial number and firmware."""
        self._open()
        info = self._camera.GetDeviceInfo()
        return (
            f"{info.GetVendorName()}, {info.GetModelName()}, {info.GetSerialNumber()},"
            f" {info.GetDeviceVersion()}"
        )

    def close(self) -> None:
        """Let go of it."""
        if self._camera is not None:
            with contextlib.suppress(self._errors):
                self._camera.StopGrabbing()
            with contextlib.suppress(self._errors):
                self._camera.Close()
            self._camera = None

    def _open(self) -> None:
        if self._camera is not None:
            return
        factory = self._pylon.TlFactory.GetInstance()
        listed = self._asked("the cameras", factory.EnumerateDevices)
        found = [info for info in listed if self._address in ("", info.GetSerialNumber())]
        if len(found) != 1:
            said = (
                ", ".join(f"{info.GetModelName()} {info.GetSerialNumber()}" for info in listed)
                or "no camera"
            )
            raise CommunicationError(
                f"{self._who}: {len(found)} cameras answer to that; there are {said}; give a serial"
                " number as the address"
            )
        self._camera = self._asked(
            "the camera", lambda: self._pylon.InstantCamera(factory.CreateDevice(found[0]))
        )
        try:
            self._asked("the camera", self._camera.Open)
            nodes = PylonNodes(self._who, self._camera, self._errors)
            self._settings = self._asked(
                "its features", lambda: GenicamSettings(self._who, nodes, self._keys)
            )
            if not self._settings.software_trigger:
                raise DeviceError(
                    f"{self._who}: has no software trigger; a camera without one is driven by"
                    " `driver: genicam`"
                )
            if self._prepared is not None:
                self._settings.prepare(*self._prepared)
        except BaseException:
            self.close()
            raise

    def _asked(self, what: str, question: Any) -> Any:
        """What the library answers.

        Raises:
            CommunicationError: it reports an error of the camera.
        """
        try:
            return question()
        except self._errors as error:
            raise CommunicationError(
                f"{self._who}: asked for {what}, got {error}; check cable, power, and who else"
                " holds it"
            ) from error


def open_camera(address: str, keys: PylonKeys, share: object) -> PylonCamera:
    """Open a camera."""
    return PylonCamera(address, keys)

"""Which drivers there are: one line each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from drivers import manual, oriental, scpi_settings, standa, thorlabs, zaber
from drivers.camera_commands import CameraCommands
from drivers.cameras import folder, genicam, gphoto2, opencv, pylon, scpi
from drivers.commands import AxisCommands, SettingCommands
from drivers.transport import serial_place, tcp_place
from flflab.bench import ANGLE, LENGTH, AxisDescription, Coordinate
from flflab.description import Description

Opened = TypeVar("Opened")
FOR_EVER = float("inf")


class Share(Protocol):
    """Several devices on one line: what an address was opened as, opened the first time."""

    def __call__(self, address: str, opener: Callable[[], Opened], /) -> Opened:
        """Return what was opened at this address."""
        ...


@dataclass(frozen=True)
class AxisDriver:
    """A driver of axes.

    Args:
        keys: the model of its own keys in the bench file.
        open: opens one axis, given its name, description, own keys and what opens or shares the
            line at its address; raises CommunicationError where nobody answers, DeviceError where
            the device refuses a setting.
        stop: given the same, stops one axis that was not opened: nothing that it could refuse is
            asked of it before.
        counts: lengths or angles; None: either.
        apart: which of its own keys tell the axes at one address from each other; None where an
            address says nothing.
        place: an address spelt one way; raises InputError where it is none.
        patience: how long an axis may be busy without progress, s.
    """

    keys: type[Description]
    open: Callable[[str, AxisDescription, Any, Share], AxisCommands]
    stop: Callable[[str, AxisDescription, Any, Share], None]
    counts: Coordinate | None
    apart: tuple[str, ...] | None
    place: Callable[[str], str] = serial_place
    patience: float = 3.0


@dataclass(frozen=True)
class SettingDriver:
    """A driver of an iris or a target holder: its own keys, how it is opened and spells an address,
    how long a change may take, s.
    """

    keys: type[Description]
    open: Callable[[str, Any, Share], SettingCommands[Any]]
    place: Callable[[str], str] = str
    timeout: float = 60.0


@dataclass(frozen=True)
class CameraDriver:
    """A driver of cameras: the model of its own keys, how a camera is opened, how it spells an
    address.
    """

    keys: type[Description]
    open: Callable[[str, Any, Share], CameraCommands]
    place: Callable[[str], str] = str


AXES: Mapping[str, AxisDriver] = {
    "zaber": AxisDriver(
        zaber.ZaberKeys, zaber.open_axis, zaber.stop_axis, LENGTH, ("device", "axis")
    ),
    "thorlabs": AxisDriver(
        thorlabs.ThorlabsKeys, thorlabs.open_axis, thorlabs.stop_axis, ANGLE, ("channel",)
    ),
    "oriental": AxisDriver(
        oriental.OrientalKeys, oriental.open_axis, oriental.stop_axis, ANGLE, ("device",)
    ),
    "standa": AxisDriver(
        standa.StandaKeys, standa.open_axis, standa.stop_axis, LENGTH, (), standa.place
    ),
    "manual": AxisDriver(
        manual.ManualAxisKeys,
        manual.open_axis,
        manual.stop_axis,
        None,
        None,
        str,
        patience=FOR_EVER,
    ),
}
CAMERAS: Mapping[str, CameraDriver] = {
    "scpi": CameraDriver(scpi.ScpiCameraKeys, scpi.open_camera, tcp_place),
    "folder": CameraDriver(folder.FolderKeys, folder.open_camera),
    "gphoto2": CameraDriver(gphoto2.GphotoKeys, gphoto2.open_camera),
    "opencv": CameraDriver(opencv.OpencvKeys, opencv.open_camera),
    "genicam": CameraDriver(genicam.GenicamKeys, genicam.open_camera),
    "pylon": CameraDriver(pylon.PylonKeys, pylon.open_camera),
}
IRISES: Mapping[str, SettingDriver] = {
    "scpi": SettingDriver(scpi_settings.ScpiSettingKeys, scpi_settings.open_iris, tcp_place),
    "gphoto2": SettingDriver(gphoto2.GphotoIrisKeys, gphoto2.open_iris),
    "manual": SettingDriver(manual.ManualIrisKeys, manual.open_iris, timeout=FOR_EVER),
}
TARGETS: Mapping[str, SettingDriver] = {
    "scpi": SettingDriver(scpi_settings.ScpiSettingKeys, scpi_settings.open_target, tcp_place),
    "manual": SettingDriver(manual.ManualTargetKeys, manual.open_target, timeout=FOR_EVER),
}

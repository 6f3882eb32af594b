"""Which drivers there are: one line each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from drivers import manual, oriental, scpi_settings, standa, thorlabs, zaber
from drivers.camera_commands import CameraCommands
from drivers.cameras import folder, genicam, gphoto2, opencv, pylon, scpi
from drivers.commands import AxisCommands, SettingCommands
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
        open: opens one axis, given its name, description, own keys and what opens or shares the line at its address; raises
            CommunicationError where nobody answers, DeviceError where the device refuses a setting.
        counts: lengths or angles; None: either.
        patience: how long an axis may be busy without progress, s.
    """

    keys: type[Description]
    open: Callable[[str, AxisDescription, Any, Share], AxisCommands]
    counts: Coordinate | None
    patience: float = 3.0


@dataclass(frozen=True)
class SettingDriver:
    """A driver of an iris or a target holder: the model of its own keys, how it is opened, how long a change may take, s."""

    keys: type[Description]
    open: Callable[[str, Any, Share], SettingCommands[Any]]
    timeout: float = 60.0


@dataclass(frozen=True)
class CameraDriver:
    """A driver of cameras: the model of its own keys and how a camera is opened."""

    keys: type[Description]
    open: Callable[[str, Any, Share], CameraCommands]


AXES: Mapping[str, AxisDriver] = {
    "zaber": AxisDriver(zaber.ZaberKeys, zaber.open_axis, LENGTH),
    "thorlabs": AxisDriver(thorlabs.ThorlabsKeys, thorlabs.open_axis, ANGLE),
    "oriental": AxisDriver(oriental.OrientalKeys, oriental.open_axis, ANGLE),
    "standa": AxisDriver(standa.StandaKeys, standa.open_axis, LENGTH),
    "manual": AxisDriver(manual.ManualAxisKeys, manual.open_axis, None, patience=FOR_EVER),
}
CAMERAS: Mapping[str, CameraDriver] = {
    "scpi": CameraDriver(scpi.ScpiCameraKeys, scpi.open_camera),
    "folder": CameraDriver(folder.FolderKeys, folder.open_camera),
    "gphoto2": CameraDriver(gphoto2.GphotoKeys, gphoto2.open_camera),
    "opencv": CameraDriver(opencv.OpencvKeys, opencv.open_camera),
    "genicam": CameraDriver(genicam.GenicamKeys, genicam.open_camera),
    "pylon": CameraDriver(pylon.PylonKeys, pylon.open_camera),
}
IRISES: Mapping[str, SettingDriver] = {
    "scpi": SettingDriver(scpi_settings.ScpiSettingKeys, scpi_settings.open_iris),
    "gphoto2": SettingDriver(gphoto2.GphotoIrisKeys, gphoto2.open_iris),
    "manual": SettingDriver(manual.ManualIrisKeys, manual.open_iris, timeout=FOR_EVER),
}
TARGETS: Mapping[str, SettingDriver] = {
    "scpi": SettingDriver(scpi_settings.ScpiSettingKeys, scpi_settings.open_target),
    "manual": SettingDriver(manual.ManualTargetKeys, manual.open_target, timeout=FOR_EVER),
}

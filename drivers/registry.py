"""Which drivers there are: one line each. A driver's own file, and what it needs, is loaded when
the bench has such a device: a stage moves also where no picture can be read.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, TypeVar

from drivers.commands import AxisCommands, SettingCommands
from drivers.places import PLACES
from drivers.transport import tcp_place
from flflab.bench import ANGLE, LENGTH, AxisDescription, Coordinate
from flflab.description import Description
from flflab.plugins import WithPlugins

Opened = TypeVar("Opened")
FOR_EVER = float("inf")


class Share(Protocol):
    """Several devices on one line: what an address was opened as, opened the first time."""

    def __call__(self, address: str, opener: Callable[[], Opened], /) -> Opened:
        """Return what was opened at this address."""
        ...


@dataclass(frozen=True)
class Loaded:
    """A name in a driver's file.

    Args:
        name: with its module, as ``zaber.ZaberKeys``.
        package: where the module is.
    """

    name: str
    package: str = "drivers"

    def get(self) -> Any:
        """What has this name; its module is loaded."""
        module, _, name = self.name.rpartition(".")
        return getattr(import_module(f"{self.package}.{module}"), name)


@dataclass(frozen=True)
class AxisDriver:
    """A driver of axes: a file with ``open_axis`` and ``stop_axis``.

    The first opens one axis, given its name, description, own keys and what opens or shares the
    line at its address; it raises CommunicationError where nobody answers, DeviceError where the
    device refuses a setting. The second, given the same, stops one axis that was not opened, beside
    whoever drives it, and returns what tells whether it still moves: nothing that it could refuse
    is asked of it before.

    Args:
        module: in ``drivers``.
        keys_named: the model of its own keys in the bench file.
        counts: lengths or angles; None: either.
        apart: which of its own keys tell the axes at one address from each other; None where an
            address says nothing.
        patience: how long an axis may be busy without progress, s.
        package: where the module is, of a driver that another package brings.
        spells: how that one spells an address one way, so that two names of a line are one line.
    """

    module: str
    keys_named: str
    counts: Coordinate | None
    apart: tuple[str, ...] | None
    patience: float = 3.0
    package: str = "drivers"
    spells: Callable[[str], str] | None = None

    @property
    def place(self) -> Callable[[str], str]:
        """Spells an address one way; raises InputError where it is none."""
        return self.spells or PLACES.get(self.module, str)

    @property
    def keys(self) -> type[Description]:
        """The model of its own keys."""
        return Loaded(f"{self.module}.{self.keys_named}", self.package).get()

    @property
    def open(self) -> Callable[[str, AxisDescription, Any, Share], AxisCommands]:
        """``open_axis`` of its file."""
        return Loaded(f"{self.module}.open_axis", self.package).get()

    @property
    def stop(self) -> Callable[[str, AxisDescription, Any, Share], Callable[[], bool]]:
        """``stop_axis`` of its file."""
        return Loaded(f"{self.module}.stop_axis", self.package).get()


@dataclass(frozen=True)
class _Driver:
    """A driver of one device besides the axes.

    Args:
        keys_named: the model of its own keys, with its module.
        open_named: what opens one, given address, keys and what shares a line.
        place: how it spells an address.
        timeout: how long a change of an iris or target holder may take, s.
        package: where its modules are.
    """

    keys_named: str
    open_named: str
    place: Callable[[str], str] = str
    timeout: float = 60.0
    package: str = "drivers"

    @property
    def keys(self) -> type[Description]:
        """The model of its own keys."""
        return Loaded(self.keys_named, self.package).get()


class SettingDriver(_Driver):
    """A driver of an iris or a target holder."""

    @property
    def open(self) -> Callable[[str, Any, Share], SettingCommands[Any]]:
        """What opens one."""
        return Loaded(self.open_named, self.package).get()


class CameraDriver(_Driver):
    """A driver of cameras."""

    @property
    def open(self) -> Callable[[str, Any, Share], Any]:
        """What opens one."""
        return Loaded(self.open_named, self.package).get()


AXES: Mapping[str, AxisDriver] = WithPlugins(
    {
        "zaber": AxisDriver("zaber", "ZaberKeys", LENGTH, ("device", "axis")),
        "thorlabs": AxisDriver("thorlabs", "ThorlabsKeys", ANGLE, ("channel",)),
        "oriental": AxisDriver("oriental", "OrientalKeys", ANGLE, ("device",)),
        "standa": AxisDriver("standa", "StandaKeys", LENGTH, ()),
        "manual": AxisDriver("manual", "ManualAxisKeys", None, None, patience=FOR_EVER),
    },
    "flflab.axes",
    AxisDriver,
)
CAMERAS: Mapping[str, CameraDriver] = WithPlugins(
    {
        "scpi": CameraDriver("cameras.scpi.ScpiCameraKeys", "cameras.scpi.open_camera", tcp_place),
        "folder": CameraDriver("cameras.folder.FolderKeys", "cameras.folder.open_camera"),
        "gphoto2": CameraDriver("cameras.gphoto2.GphotoKeys", "cameras.gphoto2.open_camera"),
        "opencv": CameraDriver("cameras.opencv.OpencvKeys", "cameras.opencv.open_camera"),
        "genicam": CameraDriver("cameras.genicam.GenicamKeys", "cameras.genicam.open_camera"),
        "pylon": CameraDriver("cameras.pylon.PylonKeys", "cameras.pylon.open_camera"),
    },
    "flflab.cameras",
    CameraDriver,
)
IRISES: Mapping[str, SettingDriver] = {
    "scpi": SettingDriver("scpi_settings.ScpiSettingKeys", "scpi_settings.open_iris", tcp_place),
    "gphoto2": SettingDriver("cameras.gphoto2.GphotoIrisKeys", "cameras.gphoto2.open_iris"),
    "manual": SettingDriver("manual.ManualIrisKeys", "manual.open_iris", timeout=FOR_EVER),
}
TARGETS: Mapping[str, SettingDriver] = {
    "scpi": SettingDriver("scpi_settings.ScpiSettingKeys", "scpi_settings.open_target", tcp_place),
    "manual": SettingDriver("manual.ManualTargetKeys", "manual.open_target", timeout=FOR_EVER),
}

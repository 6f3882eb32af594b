"""How the devices of a bench file are opened: each by its driver, lines shared, every fault
kept.
"""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, TypeVar

from drivers.axis import Axis
from drivers.camera import Camera
from drivers.described import device_of, driver_of, path_of, spelt
from drivers.lost import Trust
from drivers.registry import AxisDriver
from drivers.serials import require_serial
from drivers.setting import Setting
from drivers.simulated import SimulatedOnDemand
from flflab.bench import AxisDescription, Bench
from flflab.errors import CommunicationError, DeviceError, FlflabError

Opened = TypeVar("Opened")


def can_outlive(axis: AxisDescription) -> bool:
    """Whether an axis could go on moving after this process: what it simulates dies with it, a
    person knows to stop.
    """
    return axis.address != "simulated" and axis.driver != "manual"


class Connection:
    """Opening the devices of a bench, those of one line one after the other: at which addresses,
    and every fault so far.

    Args:
        described: the bench file, drivable (``require_drivable``).
        resources: closes what was opened.
        simulated: serves what the bench file has simulated.
    """

    def __init__(
        self, described: Bench, resources: ExitStack, simulated: SimulatedOnDemand
    ) -> None:
        self.addresses: dict[str, str] = {}
        self._described = described
        self._resources = resources
        self._shared: dict[str, Any] = {}
        self.faults: dict[str, FlflabError] = {}
        self._simulated = simulated

    def open(self, name: str) -> Any:
        """Open a device of the bench file, None where that failed."""
        device, path = device_of(self._described, name), path_of(name)
        try:
            driver = driver_of(self._described, name)
            keys = self._described.own_keys(driver.keys, *path)
            simulated = device.address == "simulated"
            if simulated:
                device = device.model_copy(update={"address": self._simulated.address(*path)})
            self.addresses[name] = device.address
            opened = self._open(driver, name, device, keys, simulated=simulated)
            self._resources.callback(opened.close)
            require_serial(name, device, opened)
            return opened
        except FlflabError as fault:
            # what is wrong with the whole simulated bench is told once, and not of each device
            alone = name in str(fault) or self._simulated.fault is fault
            self.faults[name] = fault if alone else type(fault)(f"{name}: {fault}")
            return None

    def raise_faults(self) -> None:
        """Raise all faults as one error.

        Raises:
            CommunicationError: at least one device does not answer.
            DeviceError: the other cases.
        """
        if self.faults:
            kinds = {type(fault) for fault in self.faults.values()}
            kind = CommunicationError if CommunicationError in kinds else DeviceError
            raise kind("\n".join(dict.fromkeys(str(fault) for fault in self.faults.values())))

    def _open(self, driver: Any, name: str, device: Any, keys: Any, *, simulated: bool) -> Any:

        def share(address: str, opener: Callable[[], Opened], /) -> Opened:
            return self._share(driver.place(address), opener)

        if isinstance(device, AxisDescription):
            commands = driver.open(name, device, keys, share)
            return Axis(
                name, commands, device.limits, device.speed,
                coordinate=device.coordinate, patience=driver.patience, homes_up=device.homes_up,
                trust=Trust(self._stage(name, driver, keys)),
            )  # fmt: skip
        opened = driver.open(device.address, keys, share)
        if name == "camera":
            return (
                Camera(name, opened, self._simulated.wait_until_ready)
                if simulated
                else Camera(name, opened)
            )
        return Setting[Any](name, opened, timeout=driver.timeout)

    def _stage(self, name: str, driver: AxisDriver, keys: Any) -> str:
        """What tells the stage of an axis from every other; empty where no other program reaches
        it.
        """
        device = device_of(self._described, name)
        if not isinstance(device, AxisDescription) or not can_outlive(device):
            return ""
        numbers = (getattr(keys, key) for key in driver.apart or ())
        return "|".join(map(str, (driver.module, spelt(device.driver, device.address), *numbers)))

    def _share(self, address: str, opener: Callable[[], Opened], /) -> Opened:
        if address not in self._shared:
            self._shared[address] = opener()
            self._resources.callback(self._shared[address].close)
        return self._shared[address]

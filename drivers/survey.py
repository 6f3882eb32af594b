"""A look at every device of a bench at once: who answers, who it is, where it stands, what it warns
of; nothing moves.
"""

import threading
import time
from contextlib import ExitStack
from typing import Any, NamedTuple

from drivers.axis import Axis
from drivers.connection import Connection, can_outlive
from drivers.described import device_of, require_drivable
from drivers.owner import Owner
from drivers.places import spelt
from drivers.setting import Setting
from drivers.simulated import SimulatedOnDemand, memory_of
from drivers.transport import what_to_check
from flflab.bench import Bench, DeviceDescription
from flflab.errors import FlflabError

TIMEOUT_S = 10.0
SILENT = "does not answer"
MOST_CHARACTERS = 200  # of what a device says of itself
FALLS = "vertical: without current it falls unless it has a brake, see that it has one"


class Identity(NamedTuple):
    """One line of the table of devices: texts; position in mm or rad is None where there is none or
    its reference is missing.

    The serial number is that of an axis, as ``AxisCommands`` has it.
    """

    name: str
    driver: str
    address: str
    identity: str
    position: float | None
    state: str
    serial: str = ""


def look(name: str, device: DeviceDescription, instrument: Any, address: str) -> Identity:
    """The line of a device that is open."""
    position, state, serial = None, "", ""
    try:
        identity = in_a_line(instrument.identity())
        if isinstance(instrument, Axis):
            serial = instrument.serial()
            position = instrument.position() if instrument.is_homed() else None
            falls = getattr(device, "vertical", False)
            state = "; ".join(
                ("moving",) * instrument.is_moving() + instrument.warnings() + (FALLS,) * falls
            )
        elif isinstance(instrument, Setting):
            state = in_a_line(str(instrument.value()))
    except FlflabError as error:
        identity, state = SILENT, str(error)
    return Identity(name, device.driver, address, identity, position, state, serial)


def in_a_line(said: str) -> str:
    """What a device said, as a line of a table can hold it."""
    return said if len(said) <= MOST_CHARACTERS else f"{said[:MOST_CHARACTERS]}..."


def survey(bench: Bench, timeout: float = TIMEOUT_S) -> list[Identity]:
    """Every device of a bench, all lines at once; who cannot be opened or says nothing in time has
    that in its line.

    Args:
        bench: the bench file as read.
        timeout: how long it may take in all, s.

    Raises:
        InputError: the bench file asks for what no driver could open, or for one stage twice.
        DeviceError: another program drives the bench.
    """
    require_drivable(bench)
    devices = {
        name: device_of(bench, name)
        for name in (*bench.description.axes, "camera", "iris", "target")
    }
    lines: dict[tuple[str, str], list[str]] = {}
    for name, device in devices.items():
        lines.setdefault((device.driver, spelt(device.driver, device.address)), []).append(name)
    with ExitStack() as resources:
        if any(can_outlive(axis) for axis in bench.description.axes.values()):
            resources.callback(Owner(bench.file).close)
        simulated = SimulatedOnDemand(bench, resources, memory_of(bench))
        rows: dict[str, Identity] = {}

        def look_along(line: list[str]) -> None:
            with ExitStack() as opened:
                connection = Connection(bench, opened, simulated)
                for name in line:
                    instrument, device = connection.open(name), devices[name]
                    address = connection.addresses.get(name, device.address)
                    fault = connection.faults.get(name)
                    silent = Identity(name, device.driver, address, SILENT, None, str(fault))
                    rows[name] = silent if fault else look(name, device, instrument, address)

        threads = [
            threading.Thread(
                target=look_along, args=(line,), name=f"look at {line[0]}", daemon=True
            )
            for line in lines.values()
        ]
        deadline = time.monotonic() + timeout
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        found = dict(rows)
    late = f"no answer within {timeout:g} s"
    return [
        found.get(name)
        or Identity(
            name,
            device.driver,
            device.address,
            SILENT,
            None,
            f"{name}: {late}; {what_to_check(device.address)}",
        )
        for name, device in devices.items()
    ]

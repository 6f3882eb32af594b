"""Serial numbers: what a device tells, and whether it is the one that the bench file expects."""

from typing import Any

from drivers.axis import Axis
from flflab.bench import DeviceDescription
from flflab.errors import DeviceError

FIELDS = 4  # of an identity as IEEE 488.2 has it: maker, model, serial number, version
UNKNOWN = "0"  # what that standard has an instrument say where it has no number


def serial_of(instrument: Any) -> str:
    """The serial number of an axis or a camera; empty where it tells none."""
    if isinstance(instrument, Axis):
        return instrument.serial()
    fields = [field.strip() for field in instrument.identity().split(",")]
    return fields[2] if len(fields) == FIELDS and fields[2] != UNKNOWN else ""


def require_serial(name: str, device: DeviceDescription, instrument: Any) -> None:
    """Refuse another device than the bench file expects at an address.

    Raises:
        DeviceError: its serial number is another one, or it tells none.
    """
    if not device.serial or (found := serial_of(instrument)) == device.serial:
        return
    raise DeviceError(
        f"{name}: the device at {device.address} says serial number {found or '(none)'!r}, the"
        f" bench file expects {device.serial!r}: cables or device numbers may be exchanged; correct"
        " them, or, where the device was replaced, `flflab bench check --pin --replace`; nothing"
        " moved"
    )

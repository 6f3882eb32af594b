"""The settings of a simulated Zaber device: name, scope, how it is read and written.

Names from Zaber's public setting constants. Speed settings are microsteps/s x 1.6384, accelerations
microsteps/s^2 x 1.6384 / 10000. Device id, serial and version are invented: no catalogue knows
them.
"""

from collections.abc import Callable
from dataclasses import dataclass

from sim.stage import RefusedError, Stage

SPEED = 1.6384  # setting for a speed of one microstep/s
ACCELERATION = 1.6384e-4  # setting for an acceleration of one microstep/s^2
RESOLUTION = 64  # microsteps a full step
TOP_SPEED = RESOLUTION * 16384  # largest maxspeed


@dataclass
class Communication:
    """What a device keeps about its line."""

    number: int
    serial: int
    alert: bool = False
    checksum: bool = False


@dataclass(frozen=True)
class Setting:
    """A setting of the device (``axis`` false) or of its axis; ``write`` is None where it is
    read-only.
    """

    axis: bool
    read: Callable[[Communication, Stage], str]
    write: Callable[[Communication, Stage, str], None] | None = None


def whole(word: str, low: int, high: int) -> int:
    """A whole number within limits.

    Raises:
        RefusedError: it is not (BADDATA).
    """
    try:
        number = int(word)
    except ValueError as error:
        raise RefusedError("BADDATA") from error
    if not low <= number <= high:
        raise RefusedError("BADDATA")
    return number


def speed_setting(stage: Stage) -> int:
    """``maxspeed``."""
    return round(stage.speed * SPEED)


def _set_speed(line: Communication, stage: Stage, word: str) -> None:
    stage.speed = whole(word, 1, TOP_SPEED) / SPEED


def _set_acceleration(line: Communication, stage: Stage, word: str) -> None:
    stage.acceleration = whole(word, 0, 2**31 - 1) / ACCELERATION


def _set_lower(line: Communication, stage: Stage, word: str) -> None:
    stage.lower = whole(word, -(10**9), stage.upper)


def _set_upper(line: Communication, stage: Stage, word: str) -> None:
    stage.upper = whole(word, stage.lower, 10**9)


def _set_position(line: Communication, stage: Stage, word: str) -> None:
    stage.set_position(whole(word, -(10**9), 10**9))


def _set_alert(line: Communication, stage: Stage, word: str) -> None:
    line.alert = bool(whole(word, 0, 1))


def _set_checksum(line: Communication, stage: Stage, word: str) -> None:
    line.checksum = bool(whole(word, 0, 1))


def _set_number(line: Communication, stage: Stage, word: str) -> None:
    line.number = whole(word, 1, 99)


def _fixed(text: str, axis: bool = False) -> Setting:
    return Setting(axis, lambda line, stage: text)


_ACCELERATION = Setting(
    True, lambda line, stage: str(round(stage.acceleration * ACCELERATION)), _set_acceleration
)

SETTINGS: dict[str, Setting] = {
    "pos": Setting(True, lambda line, stage: str(stage.position()), _set_position),
    "vel": Setting(True, lambda line, stage: str(round(stage.velocity() * SPEED))),
    "limit.min": Setting(True, lambda line, stage: str(stage.lower), _set_lower),
    "limit.max": Setting(True, lambda line, stage: str(stage.upper), _set_upper),
    "limit.home.preset": Setting(True, lambda line, stage: str(stage.preset)),
    "maxspeed": Setting(True, lambda line, stage: str(speed_setting(stage)), _set_speed),
    "accel": _ACCELERATION,
    "resolution": _fixed(str(RESOLUTION), axis=True),
    "peripheralid": _fixed("0", axis=True),
    "peripheral.id": _fixed("0", axis=True),
    "parking.state": Setting(True, lambda line, stage: str(int(stage.parked))),
    "driver.enabled": Setting(True, lambda line, stage: str(int(stage.enabled))),
    "motion.busy": Setting(True, lambda line, stage: str(int(stage.busy()))),
    "deviceid": _fixed("50000"),
    "device.id": _fixed("50000"),
    "device.hw.modified": _fixed("0"),
    "version": _fixed("7.38"),
    "version.build": _fixed("0"),
    "system.serial": Setting(False, lambda line, stage: str(line.serial)),
    "system.axiscount": _fixed("1"),
    "system.access": _fixed("1"),
    "system.voltage": _fixed("48.0"),
    "system.temperature": _fixed("30.0"),
    "comm.address": Setting(False, lambda line, stage: str(line.number), _set_number),
    "comm.alert": Setting(False, lambda line, stage: str(int(line.alert)), _set_alert),
    "comm.checksum": Setting(False, lambda line, stage: str(int(line.checksum)), _set_checksum),
    "comm.packet.size.max": _fixed("80"),
    "comm.command.packets.max": _fixed("1"),
    "comm.word.size.max": _fixed("50"),
    "get.settings.max": _fixed("1"),
}

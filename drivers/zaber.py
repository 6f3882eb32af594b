# longer than 450 lines because a device is one file read downwards
"""Zaber stages by the Zaber ASCII protocol: one daisy chain on one line, any number of axes on it.

What this file relies on, from the ASCII protocol manual (firmware 6 and 7):

- Commands ``/device axis id text:CC`` and CR LF; one reply ``@DD A id OK|RJ BUSY|IDLE flag
  data:CC``; lines that begin with ``#`` (information) or ``!`` (alerts) come unasked and are kept
  aside. CC is the two's complement of the sum of the bytes between the first character and the
  colon. A command with a wrong checksum is ignored, so it shows as silence.
- Positions are whole microsteps, ``maxspeed`` is microsteps/s times 1.6384. An empty command
  answers the state.
- A reply carries a checksum where the command did, unless the device's ``comm.checksum`` is 0; the
  maker's client takes replies without one too.
- ``warnings`` answers a count and flags; WR and WH say that the axis has no reference, WM that it
  was displaced at rest, FS that it stalled: its place is then not known either.
- ``home`` goes to the home sensor, towards lower positions, and counts from ``limit.home.preset``
  there.

Not confirmed from the manual: that ``stop`` raises the flag NI.
"""

import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from drivers.commands import at_the_other_end
from drivers.line import Line, stop_surely
from drivers.transport import (
    LostError,
    Wire,
    open_serial,
    show,
    what_to_check,
    whole_number,
)
from drivers.turns import Turns
from flflab.bench import AxisDescription
from flflab.description import Description, Length
from flflab.errors import CommunicationError, DeviceError, LimitError, NotHomedError
from flflab.printable import shortened

SPEED_UNIT = 1.6384
STOP_ID = 99
# in use: by the time the others have been waited for in vain, the first one's reply is not to come
# any more
FEWEST_IDS = 50
REPLY = re.compile(r"@(\d\d) (\d) (\d\d) (OK|RJ) (BUSY|IDLE) (--|[A-Z]{2}) ([^:]*)")
NO_REFERENCE = ("WR", "WH", "WM", "FS")
PRESET = "limit.home.preset"
STAGE_SERIAL = "peripheral.serial"
FLAGS = {
    "FF": "critical system error", "FN": "peripheral not supported", "FZ": "peripheral inactive",
    "FH": "hardware emergency stop",
    "FV": "driver off, voltage out of range", "FO": "driver disabled", "FC": "current inrush",
    "FM": "motor too hot",
    "FD": "driver disabled", "FQ": "encoder error", "FI": "index error",
    "FA": "analog encoder out of step", "FR": "overdrive limit",
    "FS": "stalled and stopped", "FB": "stream out of bounds", "FP": "path deviation",
    "FE": "limit error", "FT": "excessive twist",
    "WL": "unexpected limit trigger", "WV": "voltage out of range", "WT": "controller hot",
    "WS": "stalled and recovered",
    "WM": "displaced when stationary", "WP": "calibration of another type",
    "WR": "no reference position", "WH": "not homed",
    "NC": "moved by hand", "NI": "movement interrupted", "ND": "stream discontinuity",
    "NR": "value rounded", "NT": "value truncated",
    "NU": "setting update pending", "NJ": "joystick calibrating", "NB": "firmware update mode",
}  # fmt: skip
SPOILS_A_MOTION = ("WL", "NI", "NC")
REASONS = {
    "AGAIN": "it was busy with another command; try again",
    "BADAXIS": "there is no such axis; correct `axis` in the bench file",
    "BADCOMMAND": "it does not know this command; check model and firmware",
    "BADDATA": "out of its range; give another value, or home it",
    "DEVICEONLY": "this command is for the whole device",
    "DRIVERDISABLED": "its driver is off; clear the cause and enable it",
    "FULL": "its memory is full", "INACTIVE": "no stage is connected to this axis; plug it in",
    "LOCKSTEP": "the axis is locked to another", "NOACCESS": "this needs a higher access level",
    "NOTSUPPORTED": "the connected stage is not supported", "PARKED": "it is parked; unpark it",
    "REMOTE": "it is controlled by EtherCAT", "STATUSBUSY": "it moves; stop it first",
    "TWISTED": "the gantry is twisted",
    "BADMESSAGEID": "the message id is not one", "BADSPLIT": "a command in parts was broken",
}  # fmt: skip


Share = Callable[[str, Callable[[], "ZaberChain"]], "ZaberChain"]


class ZaberKeys(Description):
    """The keys of a Zaber axis in the bench file.

    ``microstep`` is the data sheet's microstep size, which holds for ``microsteps_per_step`` (the
    data sheet's default resolution); the device's own resolution is read from it.
    """

    device: Annotated[int, Field(ge=1, le=99)]
    axis: Annotated[int, Field(ge=1, le=9)] = 1
    microstep: Annotated[Length, Field(gt=0)]
    microsteps_per_step: Annotated[int, Field(ge=1)] = 64
    baud: Annotated[int, Field(ge=9600)] = 115200
    checksum: Literal["accepted", "required"] = "accepted"
    timeout: Annotated[float, Field(gt=0)] = 0.5


@dataclass(frozen=True)
class Reply:
    """A reply as parsed."""

    device: int
    axis: int
    id: int
    accepted: bool
    busy: bool
    flag: str
    data: str


def checksum(body: bytes) -> str:
    """Two upper-case hex digits: the two's complement of the sum of the bytes after the first
    character, up to the colon.
    """
    return f"{-sum(body) & 0xFF:02X}"


def encode(device: int, axis: int, message_id: int, text: str = "") -> bytes:
    """A command line with message id and checksum."""
    body = f"{device} {axis} {message_id:02d}{' ' if text else ''}{text}"
    return f"/{body}:{checksum(body.encode('ascii'))}\r\n".encode("ascii")


def parse(line: bytes, with_checksum: bool = False) -> Reply | None:
    """Read one line; None for information and alerts, and for a command that an adapter hands back.

    Args:
        line: without its CR LF.
        with_checksum: whether a reply has to carry one.

    Raises:
        CommunicationError: it is not a line of this protocol, or its checksum is wrong or missing.
    """
    body, colon, sum_ = line.rpartition(b":")
    if colon and re.fullmatch(rb"[0-9A-F]{2}", sum_):
        if sum_.decode() != checksum(body[1:]):
            raise CommunicationError(
                f"got {show(line)}, its checksum is wrong, {checksum(body[1:])} is due; check cable"
                " and baud rate"
            )
    elif with_checksum and line[:1] == b"@":
        raise CommunicationError(
            f"got {show(line)} without a checksum; set comm.checksum of the device to 1, or do"
            " without `checksum: required`"
        )
    else:
        body = line
    if body[:1] in (b"#", b"!", b"/"):
        return None
    found = REPLY.fullmatch(body.decode("ascii", "replace"))
    if found is None:
        raise CommunicationError(
            f"got {show(line)}, not a reply of the Zaber ASCII protocol; check cable, baud rate and"
            " protocol"
        )
    device, axis, message_id, flag, state, warning, data = found.groups()
    return Reply(
        int(device), int(axis), int(message_id), flag == "OK", state == "BUSY", warning, data
    )


class ZaberChain:
    """The one line that the axes of a chain share: one exchange at a time; a stop is written at
    once, past whoever waits.

    Args:
        opener: opens the line.
        with_checksum: whether replies have to carry a checksum.
        timeout: how long a reply may take, s.

    Raises:
        CommunicationError: the line cannot be opened.
    """

    def __init__(
        self, opener: Callable[[], Wire], with_checksum: bool = False, timeout: float = 0.5
    ) -> None:
        self.unasked: deque[str] = deque(maxlen=100)
        self.line = Line(opener)
        self._with_checksum = with_checksum
        self._timeout = timeout
        self._turns = Turns()
        self._ids = deque(range(STOP_ID))
        self._unanswered: deque[int] = deque()
        self._in_step = True
        self._stops = 0  # whose replies are still to come
        self._summed: set[int] = set()

    def ask(self, name: str, device: int, axis: int, text: str, *, repeatable: bool) -> Reply:
        """Send a command and return its reply, accepted or not.

        Args:
            name: the axis that asks, for messages.
            device: address on the chain.
            axis: of that device, 0 for the device itself.
            text: the command.
            repeatable: whether it may be sent a second time when the first reply is lost; never
                true of what moves.

        Raises:
            CommunicationError: no reply, or not the reply to this command.
        """
        try:
            with self._turns.take():
                return self._exchange(name, device, axis, text)
        except CommunicationError:
            if not repeatable:
                raise
        with self._turns.take():
            return self._exchange(name, device, axis, text)

    def stop(self, name: str, device: int, axis: int) -> None:
        """Decelerate an axis to rest; written at once, then the device is asked once for its state
        to know that it listens.

        Raises:
            CommunicationError: it does not answer, so that it may not have taken the stop.
            DeviceError: it has no such axis.
        """
        stop = encode(device, axis, STOP_ID, "stop")  # its reply is skipped by whoever reads
        self._stops += 1
        stop_surely(
            self.line,
            name,
            stop,
            lambda: _accepted(name, "", self.ask(name, device, axis, "", repeatable=False)),
        )

    def close(self) -> None:
        """Let go of the line."""
        self.line.close()

    def _exchange(self, name: str, device: int, axis: int, text: str) -> Reply:
        if len(self._ids) < FEWEST_IDS:
            self._ids.append(self._unanswered.popleft())
        message_id = self._ids.popleft()
        self._unanswered.append(
            message_id
        )  # used for nothing else: its late reply would be taken for another command's
        asked = f"{name} (device {device} axis {axis}): asked {text or 'for its state'!r}, "
        wire = self.line.get(asked)
        try:
            if not self._in_step:
                wire.drain()
            self._in_step = False
            wire.write(encode(device, axis, message_id, text))
            reply = self._next_reply(wire, message_id)
            if (reply.device, reply.axis, reply.id) != (device, axis, message_id):
                raise CommunicationError(
                    f"got the reply of device {reply.device} axis {reply.axis} to message"
                    f" {reply.id}, not to message {message_id}; check that no two devices share a"
                    " number and no other program is on the line"
                )
        except LostError as error:
            self.line.lose(wire)
            raise LostError(asked + str(error)) from error
        except CommunicationError as error:
            raise CommunicationError(asked + str(error)) from error
        self._in_step = True
        self._unanswered.remove(message_id)
        self._ids.append(message_id)
        return reply

    def _next_reply(self, wire: Wire, message_id: int) -> Reply:
        """The next one that is no stop's and none that was given up; of what else comes the reply
        to a stop gives it more time, for the device says it first.
        """
        deadline = time.monotonic() + self._timeout
        left = self._timeout
        while left > 0:
            line = wire.read_until(b"\n", left).rstrip(b"\r")
            reply = parse(line, self._with_checksum)
            if reply is None:
                self.unasked.append(line.decode("ascii", "replace"))
            elif reply.id == message_id or reply.id not in (STOP_ID, *self._unanswered):
                self._require_sum_as_before(reply, line)
                return reply
            elif reply.id == STOP_ID and self._stops > 0:
                self._stops -= 1
                deadline = time.monotonic() + self._timeout
            left = deadline - time.monotonic()
        raise CommunicationError(
            f"{wire.address}: no answer within {self._timeout:g} s, though other lines came;"
            f" {what_to_check(wire.address)}"
        )

    def _require_sum_as_before(self, reply: Reply, line: bytes) -> None:
        """Refuse a reply without checksum of a device that sent one before: its end is lost."""
        if b":" in line:
            self._summed.add(reply.device)
        elif reply.device in self._summed:
            raise CommunicationError(
                f"got {show(line)} without the checksum that it sent before; check cable and baud"
                " rate"
            )


class ZaberAxis:
    """One axis of a chain, in mm; satisfies ``AxisCommands``. Connecting reads settings and sets
    the speed; nothing moves.

    Args:
        name: the axis's name in the bench file.
        chain: the line it is on.
        keys: its own keys of the bench file.
        speed: of moves, mm/s.
        homes_up: whether its reference is to lie at the high end of its travel.

    Raises:
        CommunicationError: the device does not answer, or not in this protocol.
        DeviceError: it counts its reference at the other end, or refuses a setting, such as the
            speed.
    """

    measured = False

    def __init__(
        self, name: str, chain: ZaberChain, keys: ZaberKeys, speed: float, *, homes_up: bool
    ) -> None:
        self._name = name
        self._chain = chain
        self._keys = keys
        if (steps := self._setting("resolution")) < 1:
            raise CommunicationError(
                f"{name}: the device says that a full step has {steps} microsteps; at least 1 is"
                " due, check model and firmware"
            )
        self.resolution = keys.microstep * keys.microsteps_per_step / steps
        low, high = self._setting("limit.min"), self._setting("limit.max")
        if low > high:
            raise DeviceError(
                f"{name}: the device's own limits are {low} to {high} microsteps, the low one above"
                " the high one; set limit.min and limit.max anew"
            )
        self.travel = (low * self.resolution, high * self.resolution)
        self._require_reference(homes_up)
        maxspeed = round(speed / self.resolution * SPEED_UNIT)
        if self._setting("maxspeed") != maxspeed:
            self._command(f"set maxspeed {maxspeed}", repeatable=True)

    def start_home(self) -> None:
        """Start to look for the reference."""
        self._command("warnings clear", repeatable=True)
        self._command("home", repeatable=False)

    def start_move(self, position: float) -> None:
        """Start towards a reading in mm, rounded to the microstep.

        It is told how far to go, not where to: a device that lost its counter in between (a reset)
        stays on the way that was found free.

        Raises:
            LimitError: outside the device's own limits.
            NotHomedError: it has just lost its reference.
        """
        self._command("warnings clear", repeatable=True)
        here = self.reading()
        if here is None:
            raise NotHomedError(
                f"{self._name}: asked to move, but it has just lost its reference (a reset?); home"
                " it, nothing moved"
            )
        self._command(
            f"move rel {round(position / self.resolution) - round(here / self.resolution)}",
            repeatable=False,
        )

    def position(self) -> float:
        """The reading in mm."""
        return self._setting("pos") * self.resolution

    def reading(self) -> float | None:
        """The reading in mm, None without a reference: the reply says so itself, unless a graver
        flag hides it.
        """
        before = self._command("get pos", repeatable=True)
        if before.flag in NO_REFERENCE or (before.flag != "--" and not self.is_homed()):
            return None
        if before.flag == "--":
            return self._number("pos", before) * self.resolution
        here = self.position()
        return here if self.is_homed() else None

    def is_busy(self) -> bool:
        """Whether it moves."""
        return self._command("", repeatable=True).busy

    def is_homed(self) -> bool:
        """Whether no flag says that its place is not known."""
        return not any(flag in NO_REFERENCE for flag in self._flags())

    def stop(self) -> None:
        """Decelerate to rest."""
        self._chain.stop(self._name, self._keys.device, self._keys.axis)

    def faults(self) -> tuple[str, ...]:
        """Flags that spoil a motion: every F, and WL, NI, NC (as the vendor's client judges its own
        moves).
        """
        return tuple(
            _phrase(flag) for flag in self._flags() if flag[0] == "F" or flag in SPOILS_A_MOTION
        )

    def warnings(self) -> tuple[str, ...]:
        """Every flag raised."""
        return tuple(_phrase(flag) for flag in self._flags())

    def identity(self) -> str:
        """Kind, serial number and firmware."""
        kind, serial, version = (
            self._device_setting(setting) for setting in ("deviceid", "system.serial", "version")
        )
        return f"Zaber device {kind}, serial {serial}, firmware {version}, at {self._keys.device}"

    def serial(self) -> str:
        """The device's serial number, with the axis where it is not its first, and that of a stage
        that is not built in and tells it.
        """
        asked = f"get {STAGE_SERIAL}"
        reply = self._chain.ask(
            self._name, self._keys.device, self._keys.axis, asked, repeatable=True
        )
        stage = reply.data if reply.accepted and reply.data.strip("0") else ""
        return (
            self._device_setting("system.serial")
            + (f" axis {self._keys.axis}" if self._keys.axis > 1 else "")
            + (f" stage {stage}" if stage else "")
        )

    def close(self) -> None:
        """Nothing: the chain is closed by who opened it."""

    def _require_reference(self, homes_up: bool) -> None:
        """Refuse a device that will count its reference at the other end; firmware that does not
        say where is asked to home only.
        """
        asked = f"get {PRESET}"
        reply = self._chain.ask(
            self._name, self._keys.device, self._keys.axis, asked, repeatable=True
        )
        if not reply.accepted and reply.data == "BADCOMMAND":
            return
        reference = self._number(PRESET, _accepted(self._name, asked, reply)) * self.resolution
        if at_the_other_end(reference, self.travel, homes_up):
            found, due = ("low", "high") if homes_up else ("high", "low")
            raise DeviceError(
                f"{self._name}: the device counts its reference as {reference:g} mm, at the {found}"
                " end of its travel, where `home_towards` and `sign` of the bench file have the"
                f" {due} one; correct them, the rule of the gap relies on them; nothing moved"
            )

    def _setting(self, setting: str) -> int:
        return self._number(setting, self._command(f"get {setting}", repeatable=True))

    def _number(self, setting: str, reply: Reply) -> int:
        if (value := whole_number(reply.data)) is None:
            raise CommunicationError(
                f"{self._name}: asked for {setting}, got {shortened(reply.data)}, not a whole"
                " number; check model and firmware"
            )
        return value

    def _device_setting(self, setting: str) -> str:
        return self._command(f"get {setting}", repeatable=True, axis=0).data

    def _flags(self) -> list[str]:
        data = self._command("warnings", repeatable=True).data
        count, *flags = data.split() or [""]
        if whole_number(count) != len(flags) or any(
            not re.fullmatch(r"[A-Z]{2}", flag) for flag in flags
        ):
            raise CommunicationError(
                f"{self._name}: asked for its warnings, got {shortened(data)}, not a count and"
                " as many flags"
            )
        return flags

    def _command(self, text: str, *, repeatable: bool, axis: int | None = None) -> Reply:
        numbers = (self._keys.device, self._keys.axis if axis is None else axis)
        return _accepted(
            self._name, text, self._chain.ask(self._name, *numbers, text, repeatable=repeatable)
        )


def _accepted(name: str, text: str, reply: Reply) -> Reply:
    if not reply.accepted:
        raise (LimitError if reply.data == "BADDATA" and text.startswith("move") else DeviceError)(
            f"{name}: asked {text!r}, the device refuses ({reply.data}:"
            f" {REASONS.get(reply.data, 'a reason not known here')})"
        )
    return reply


def _phrase(flag: str) -> str:
    return f"{flag}: {FLAGS.get(flag, 'not known here')}"


def open_axis(name: str, axis: AxisDescription, keys: ZaberKeys, share: Share) -> ZaberAxis:
    """Open one axis; axes at one address share the chain."""
    chain = _chain(axis, keys, share, alone=True)
    return ZaberAxis(name, chain, keys, axis.speed, homes_up=axis.homes_up)


def stop_axis(
    name: str, axis: AxisDescription, keys: ZaberKeys, share: Share
) -> Callable[[], bool]:
    """Stop one axis, asked for nothing and told nothing before; what is returned tells whether it
    still moves.
    """
    chain = _chain(axis, keys, share, alone=False)
    numbers = keys.device, keys.axis
    chain.stop(name, *numbers)
    return lambda: _accepted(name, "", chain.ask(name, *numbers, "", repeatable=True)).busy


def _chain(axis: AxisDescription, keys: ZaberKeys, share: Share, *, alone: bool) -> ZaberChain:
    return share(
        axis.address,
        lambda: ZaberChain(
            lambda: open_serial(axis.address, keys.baud, alone=alone),
            keys.checksum == "required",
            keys.timeout,
        ),
    )

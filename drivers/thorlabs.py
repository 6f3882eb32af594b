# longer than 450 lines because a device is one file read downwards
"""Thorlabs motors by the APT protocol: a KDC101 controller with a PRM1-Z8 rotation stage, one on
each line.

What this file relies on, from Thorlabs' "Host-Controller Communications Protocol" (issue 37, 2023):

- A message is six bytes, little-endian: id, two parameters, destination, source. Where bit 7 of the
  destination is set the parameters are the length of data that follow. Host 0x01, a controller on
  USB 0x50; 115200 baud, RTS/CTS. Some controllers (a TDC001 was reported) name 0x00 as source and
  destination.
- Nothing acknowledges a move: it is over when a status says so (bits 4 to 7 moving, 9 homing, 10
  homed, 31 enabled), beside messages that come unasked when it ends. So a command that got lost is
  found by asking for the state until the motion shows.
- Answers come in order and carry no number. So every question is followed by a second one, for the
  enable state, and what was answered last before the answer to that counts: what comes late or
  twice is passed over.
- Positions are whole encoder counts. Speeds are counts/s * T * 65536, accelerations counts/s^2 *
  T^2 * 65536, T = 2048 / 6e6 s.
- Messages carry no checksum: what guards the bytes is USB's own.

A controller has a backlash correction, 1 degree at first, which overshoots the target from one
side: it is switched off, and asked whether it is, since a motion has to stay between its ends. Not
confirmed from the manual: within how many counts the servo comes to rest (``deadband``). On close
the motor holds its place.
"""

import math
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field

from drivers.line import Line, stop_surely
from drivers.transport import LONGEST_S, LostError, Wire, open_serial
from flflab.bench import AxisDescription
from flflab.description import Description
from flflab.errors import CommunicationError, DeviceError, LimitError, NotHomedError

HOST, CONTROLLER, WITH_DATA = 0x01, 0x50, 0x80
REQUEST_INFO, INFO = 0x0005, 0x0006
SET_ENABLED, REQUEST_ENABLED, ENABLE_STATE = 0x0210, 0x0211, 0x0212
SET_SPEED, REQUEST_SPEED, SPEED = 0x0413, 0x0414, 0x0415
SET_BACKLASH, REQUEST_BACKLASH, BACKLASH = 0x043A, 0x043B, 0x043C
HOME, HOMED = 0x0443, 0x0444
MOVE, COMPLETED = 0x0453, 0x0464
STOP = 0x0465
REQUEST_STATUS, STATUS = 0x0490, 0x0491
GENTLY = 2  # a stop with the set acceleration
SERVO_S = 2048 / 6e6
MOVING, HOMING, REFERENCE, ENABLED = 0xF0, 1 << 9, 1 << 10, 1 << 31
FAULTS = {
    14: "position error too large", 15: "instrument error", 16: "interlock open",
    17: "motor too hot", 18: "supply voltage low",
    19: "commutation error", 25: "encoder fault", 26: "overcurrent", 27: "supply current fault",
    30: "error",
}  # fmt: skip
STATES = {
    0: "at the forward limit switch",
    1: "at the reverse limit switch",
    24: "motor current at its limit",
}
MOST_MESSAGES = 100  # before the one that is waited for
START_S = 0.5  # until a motion shows
LONGEST = 255  # bytes of data, as the manual has it
MOST = 2**31 - 1  # a position or a speed in a message

Share = Callable[[str, Callable[[], "AptLink"]], "AptLink"]


class ThorlabsKeys(Description):
    """The keys of a Thorlabs axis in the bench file.

    ``counts_per_degree`` is of the stage: 1919.6418578623391 of a PRM1-Z8. ``deadband`` is how many
    counts from its target the servo may come to rest. ``handshake`` is RTS/CTS, which the
    controller's USB port wants.
    """

    counts_per_degree: Annotated[float, Field(gt=0)] = 1919.6418578623391
    channel: Annotated[int, Field(ge=1, le=4)] = 1
    deadband: Annotated[int, Field(ge=1)] = 2
    baud: Annotated[int, Field(ge=9600)] = 115200
    handshake: bool = True
    timeout: Annotated[float, Field(gt=0)] = 0.5


@dataclass(frozen=True)
class Message:
    """A message as read; ``data`` is empty where it is six bytes."""

    id: int
    parameters: tuple[int, int]
    data: bytes = b""


@dataclass(frozen=True)
class State:
    """A status: the encoder's counts and the status bits."""

    counts: int
    bits: int

    @property
    def busy(self) -> bool:
        """Whether it moves or looks for its reference."""
        return bool(self.bits & (MOVING | HOMING))


def encode(message_id: int, first: int = 0, second: int = 0, data: bytes = b"") -> bytes:
    """A message from the host to the controller."""
    if data:
        return struct.pack("<HHBB", message_id, len(data), CONTROLLER | WITH_DATA, HOST) + data
    return struct.pack("<HBBBB", message_id, first, second, CONTROLLER, HOST)


def read_message(take: Callable[[int], bytes]) -> Message:
    """Read the next message.

    Args:
        take: gives so many bytes.

    Raises:
        CommunicationError: what came does not begin a message to this host, or is too long to be
            one.
    """
    header = take(6)
    message_id, length, destination, source = struct.unpack("<HHBB", header)
    to_host = destination & ~WITH_DATA in (0, HOST) and source != HOST
    handed_back = (destination & ~WITH_DATA, source) == (CONTROLLER, HOST)  # by an adapter
    if not (to_host or handed_back) or not message_id:
        raise CommunicationError(
            f"got {header.hex(' ')}, which begins no message to this computer; check cable, port"
            " and protocol"
        )
    if not destination & WITH_DATA:
        return Message(message_id, (header[2], header[3]))
    if length > LONGEST:
        raise CommunicationError(
            f"got a message of {length} bytes, longer than any of this protocol; check cable and"
            " port"
        )
    return Message(message_id, (0, 0), take(length))


class AptLink:
    """The line to one controller: one exchange at a time; a stop is written at once, past whoever
    waits.

    Args:
        opener: opens the line.
        timeout: how long an answer may take, s.

    Raises:
        CommunicationError: the line cannot be opened.
    """

    def __init__(self, opener: Callable[[], Wire], timeout: float) -> None:
        self.heard: set[int] = set()
        self.line = Line(opener)
        self._timeout = timeout
        self._turn = threading.RLock()
        self._in_step = False

    def tell(self, name: str, message: bytes) -> None:
        """Write a message that nothing answers, at once.

        Raises:
            LostError: the line is gone.
        """
        wire = self.line.get(f"{name}: told {message.hex(' ')}, ")
        try:
            wire.write(message)
        except LostError as error:
            self.line.lose(wire)
            raise LostError(f"{name}: {error}") from error

    def ask(self, name: str, message: bytes, answer: int, size: int) -> bytes:
        """Write a request and return the data of its answer; asked once more when the first answer
        does not come.

        Args:
            name: the axis that asks, for messages.
            message: the request; never one that moves.
            answer: id of the answer; the ids of all that comes are kept in ``heard``.
            size: how many bytes of data the answer has.

        Raises:
            CommunicationError: no answer, or not the one to this request.
        """
        with self._turn:
            try:
                return self._exchange(name, message, answer, size)
            except CommunicationError:
                return self._exchange(name, message, answer, size)

    def state(self, name: str, channel: int) -> State:
        """The state of a channel.

        Raises:
            CommunicationError: no answer, or that of another channel.
        """
        told, counts, _, _, bits = struct.unpack(
            "<HlhHL", self.ask(name, encode(REQUEST_STATUS, channel), STATUS, 14)
        )
        if told != channel:
            raise CommunicationError(
                f"{name}: got the state of channel {told}, not of {channel}; check `channel`"
            )
        return State(counts, bits)

    def stop(self, name: str, channel: int) -> None:
        """Decelerate to rest; written at once, then the controller is asked for its state to know
        that it listens.

        Raises:
            CommunicationError: it does not answer, so that it may not have taken the stop.
        """
        stop_surely(
            self.line, name, encode(STOP, channel, GENTLY), lambda: self.state(name, channel)
        )

    def close(self) -> None:
        """Let go of the line."""
        self.line.close()

    def _exchange(self, name: str, message: bytes, answer: int, size: int) -> bytes:
        wire = self.line.get(f"{name}: asked {message.hex(' ')}, ")
        try:
            if not self._in_step:
                wire.drain()
                wire.write(encode(REQUEST_INFO))
                self._until(wire, INFO)
            self._in_step = False
            wire.write(message + encode(REQUEST_ENABLED, 1))
            data = self._until(wire, ENABLE_STATE).get(answer)
            if data is None or len(data) != size:
                came = (
                    "no answer to it"
                    if data is None
                    else f"{len(data)} bytes of data instead of {size}"
                )
                raise CommunicationError(
                    f"{wire.address}: got {came}; check cable, model and firmware"
                )
        except LostError as error:
            self._in_step = False
            self.line.lose(wire)
            raise LostError(f"{name}: asked {message.hex(' ')}, {error}") from error
        except CommunicationError as error:
            raise CommunicationError(f"{name}: asked {message.hex(' ')}, {error}") from error
        self._in_step = True
        return data

    def _until(self, wire: Wire, last: int) -> dict[int, bytes]:
        """Data by id of all messages up to one; of several with the same id the last counts."""
        came: dict[int, bytes] = {}
        ends = time.monotonic() + self._timeout + LONGEST_S
        for _ in range(MOST_MESSAGES):
            if time.monotonic() > ends:
                break
            message = read_message(lambda count: wire.read_exactly(count, self._timeout))
            came[message.id] = message.data
            self.heard.add(message.id)
            if message.id == last:
                return came
        raise CommunicationError(
            f"{wire.address}: other messages only, {len(came)} kinds of them; close other programs"
            " on this port"
        )


class ThorlabsAxis:
    """A rotation stage on a controller, in rad; satisfies ``AxisCommands``.

    Connecting enables the motor, sets the speed and switches the backlash correction off; nothing
    moves.

    Args:
        name: the axis's name in the bench file.
        link: the line to its controller.
        keys: its own keys of the bench file.
        speed: of moves, rad/s.

    Raises:
        CommunicationError: the controller does not answer, or not in this protocol.
        DeviceError: it does not take a setting.
    """

    travel = (-math.inf, math.inf)  # it turns for ever

    measured = True

    def __init__(self, name: str, link: AptLink, keys: ThorlabsKeys, speed: float) -> None:
        self._name = name
        self._link = link
        self._keys = keys
        self._count = math.pi / 180 / keys.counts_per_degree
        self.resolution = keys.deadband * self._count
        self._speed = round(speed / self._count * SERVO_S * 65536)
        if self._speed > MOST:
            raise DeviceError(
                f"{name}: asked for {math.degrees(speed):g} deg/s, more than the controller can be"
                " told; correct `speed`"
            )
        self._set_up()

    def start_home(self) -> None:
        """Start to look for the reference; a controller without one was off, and has forgotten what
        it was told.
        """
        if not (before := self._state()).bits & REFERENCE:
            self._set_up()
        self._start(
            encode(HOME, self._keys.channel),
            HOMED,
            lambda now: not before.bits & REFERENCE and bool(now.bits & REFERENCE),
        )

    def start_move(self, position: float) -> None:
        """Start towards a reading in rad, rounded to the count.

        Raises:
            DeviceError: the motor is off.
            LimitError: the reading is further than the controller can count.
            NotHomedError: it has just lost its reference.
            CommunicationError: the motion does not show.
        """
        counts = round(position / self._count)
        if abs(counts) > MOST:
            raise LimitError(
                f"{self._name}: {math.degrees(position):g} deg are {counts} counts, more than the"
                " controller can count; nothing moved"
            )
        message = encode(MOVE, data=struct.pack("<Hl", self._keys.channel, counts))
        self._start(message, COMPLETED, lambda now: abs(now.counts - counts) <= self._keys.deadband)

    def position(self) -> float:
        """The reading in rad."""
        return self._state().counts * self._count

    def reading(self) -> float | None:
        """The reading in rad, None without a reference; one answer tells both."""
        state = self._state()
        return state.counts * self._count if state.bits & REFERENCE else None

    def is_busy(self) -> bool:
        """Whether it moves or looks for its reference."""
        return self._state().busy

    def is_homed(self) -> bool:
        """Whether it found its reference since it was switched on."""
        return bool(self._state().bits & REFERENCE)

    def stop(self) -> None:
        """Decelerate to rest."""
        self._link.stop(self._name, self._keys.channel)

    def faults(self) -> tuple[str, ...]:
        """The status bits that spoil a motion."""
        return _phrases(self._state().bits, FAULTS)

    def warnings(self) -> tuple[str, ...]:
        """What the status bits say beside motion."""
        bits = self._state().bits
        reference = () if bits & REFERENCE else ("not homed",)
        power = () if bits & ENABLED else ("motor off",)
        return (*_phrases(bits, FAULTS | STATES), *reference, *power)

    def identity(self) -> str:
        """Model, serial number and firmware."""
        serial, model, _, minor, interim, major = self._info()
        kind = model.rstrip(b"\0 ").decode("ascii", "replace")
        return f"Thorlabs {kind}, serial {serial}, firmware {major}.{interim}.{minor}"

    def serial(self) -> str:
        """The controller's serial number, with the channel where it is not its first."""
        return str(self._info()[0]) + (
            f" channel {self._keys.channel}" if self._keys.channel > 1 else ""
        )

    def close(self) -> None:
        """Nothing: the line is closed by who opened it; the motor holds."""

    def _info(self) -> tuple[Any, ...]:
        return struct.unpack_from(
            "<L8sHBBB", self._link.ask(self._name, encode(REQUEST_INFO), INFO, 84)
        )

    def _set_up(self) -> None:
        channel, wanted = self._keys.channel, self._speed
        _, least, acceleration, most = self._speeds()
        if most != wanted:
            self._link.tell(
                self._name,
                encode(SET_SPEED, data=struct.pack("<Hlll", channel, least, acceleration, wanted)),
            )
            if (set_to := self._speeds()[3]) != wanted:
                raise DeviceError(
                    f"{self._name}: asked for the speed {wanted}, it keeps {set_to}; give a speed"
                    " the stage can reach"
                )
        if self._backlash() != 0:
            self._link.tell(self._name, encode(SET_BACKLASH, data=struct.pack("<Hl", channel, 0)))
            if kept := self._backlash():
                raise DeviceError(
                    f"{self._name}: asked to switch its backlash correction off, it keeps {kept}"
                    " counts; switch it off in the maker's software"
                )
        self._link.tell(self._name, encode(SET_ENABLED, channel, 1))

    def _backlash(self) -> int:
        return struct.unpack(
            "<Hl",
            self._link.ask(self._name, encode(REQUEST_BACKLASH, self._keys.channel), BACKLASH, 6),
        )[1]

    def _speeds(self) -> tuple[int, int, int, int]:
        data = self._link.ask(self._name, encode(REQUEST_SPEED, self._keys.channel), SPEED, 14)
        channel, least, acceleration, most = struct.unpack("<Hlll", data)
        return channel, least, acceleration, most

    def _state(self) -> State:
        return self._link.state(self._name, self._keys.channel)

    def _start(self, message: bytes, ended: int, arrived: Callable[[State], bool]) -> None:
        """Write what moves, once, and see that it moves, has ended or has arrived."""
        if not self._state().bits & ENABLED:
            raise DeviceError(
                f"{self._name}: its motor is switched off at the controller; enable it there,"
                " nothing moved"
            )
        self._link.heard.discard(ended)
        self._link.tell(self._name, message)
        deadline = time.monotonic() + START_S
        while True:
            state = self._state()
            if ended == COMPLETED and not state.bits & REFERENCE:
                self.stop()
                raise NotHomedError(
                    f"{self._name}: lost its reference as it was told to move (a reset?); told to"
                    " stop, home it"
                )
            if state.busy or arrived(state) or ended in self._link.heard:
                return
            if time.monotonic() > deadline:
                raise CommunicationError(
                    f"{self._name}: told {message.hex(' ')}, but no motion shows within {START_S:g}"
                    " s; told to stop, check cable and controller, then try again"
                )


def _phrases(bits: int, known: dict[int, str]) -> tuple[str, ...]:
    return tuple(phrase for bit, phrase in sorted(known.items()) if bits >> bit & 1)


def open_axis(name: str, axis: AxisDescription, keys: ThorlabsKeys, share: Share) -> ThorlabsAxis:
    """Open the axis of one controller, which has its line for itself."""
    return ThorlabsAxis(name, _link(axis, keys, share, alone=True), keys, axis.speed)


def stop_axis(
    name: str, axis: AxisDescription, keys: ThorlabsKeys, share: Share
) -> Callable[[], bool]:
    """Stop one axis, told nothing before; what is returned tells whether it still moves."""
    link = _link(axis, keys, share, alone=False)
    link.stop(name, keys.channel)
    return lambda: link.state(name, keys.channel).busy


def _link(axis: AxisDescription, keys: ThorlabsKeys, share: Share, *, alone: bool) -> AptLink:
    return share(
        axis.address,
        lambda: AptLink(
            lambda: open_serial(axis.address, keys.baud, handshake=keys.handshake, alone=alone),
            keys.timeout,
        ),
    )

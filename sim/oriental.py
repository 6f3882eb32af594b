"""Simulated Oriental Motor AZ drives: slaves of one Modbus RTU line, each with a motor that turns
something.

From the AZ series' operating manual HM-60262E and public drivers that cite it: 32-bit values in two
registers, the upper word first; direct data operation at 0x0058, inputs at 0x007D, outputs at
0x007F, monitors from 0x0080 on, parameters from 0x0380 on. What a drive cannot do now it
acknowledges and lets be. Not confirmed: when HOME-END goes off (here: with the next motion), and
that an absolute encoder makes ABSPEN last through a loss of power. Homing here finds a home sensor:
the drive's HOME is assigned to the home input.
"""

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sim.faults import JAM, Faults
from sim.stage import Stage

SILENCE = 0.05  # s after which what has come is no beginning of a message any more
LENGTHS = {0x03: 8, 0x06: 8, 0x08: 8}  # bytes of a request; 0x10 and 0x17 say theirs
MOST_REGISTERS = 125
FASTEST = 4_000_000  # Hz; more is taken and raises an alarm
OPERATION, TRIGGER = 0x0058, 0x0066
PULSES, INPUTS, OUTPUTS = 0x0078, 0x007C, 0x007E
ALARM_RESET = 0x0180
PARAMETERS = range(0x0380, 0x03A0, 2)
OVERTRAVEL, UPPER, LOWER, WRAP = 0x0386, 0x0388, 0x038A, 0x038E
ABSOLUTE, BY_COMMAND, BY_FEEDBACK, WRAP_TYPES = 1, 2, 3, (8, 9)
POSITION_DEVIATION, NO_REFERENCE, HARDWARE_LIMIT, SOFTWARE_LIMIT, BAD_DATA = (
    0x10,
    0x4A,
    0x66,
    0x67,
    0x70,
)


def crc(body: bytes) -> bytes:
    """The two bytes after a message: CRC-16 with polynomial 0xA001, low byte first."""
    rest = 0xFFFF
    for byte in body:
        rest ^= byte
        for _ in range(8):
            rest = rest >> 1 ^ (0xA001 if rest & 1 else 0)
    return rest.to_bytes(2, "little")


@dataclass(frozen=True)
class Wiring:
    """Which bit of the input and output words is what, as the drive was set up."""

    home_input: int = 4
    stop_input: int = 5
    reset_input: int = 7
    ready_output: int = 5
    alarm_output: int = 7
    moving_output: int = 13


class RefusedError(Exception):
    """A request that is answered with an exception; its code."""


class Drive:
    """One drive with its motor: what its registers say and do."""

    def __init__(
        self, stage: Stage, faults: Faults, wiring: Wiring, turn: float, *, wrap: bool = False
    ) -> None:
        """Power up for the first time, without a reference.

        Args:
            stage: its motor; microsteps are the drive's steps.
            faults: what goes wrong.
            wiring: the bits of its inputs and outputs.
            turn: steps of the wrap range, one turn of the table.
            wrap: whether positions count within the range only.
        """
        self.stage, self.faults, self.wiring = stage, faults, wiring
        stage.obstruct(faults.obstacle, math.radians(JAM))
        self._turn = turn
        self._parameters = dict.fromkeys(PARAMETERS, 0) | {
            OVERTRAVEL: -1 if wrap else 1,
            UPPER: stage.upper,
            LOWER: stage.lower,
            WRAP: int(wrap),
        }
        self._valid = False
        self._operation = dict.fromkeys(range(OPERATION, 0x006A, 2), 0)
        self._alarm = self._inputs = self._commanded = self._reset = 0
        self._at_home = self._homing = False
        self._monitors: Mapping[int, Callable[[], int]] = {
            INPUTS: lambda: self._inputs, OUTPUTS: self._outputs, 0x0080: lambda: self._alarm,
            0x00AC: lambda: 0,
            **dict.fromkeys(range(0x0082, 0x0096, 2), lambda: 0),  # past alarms
            0x00C6: self._command_position, 0x00C8: self._speed, 0x00CA: self._speed_hz,
            0x00CC: self._position, 0x00CE: self._speed, 0x00D0: self._speed_hz,
            0x00D4: lambda: 0, 0x00D6: lambda: 0,
            0x00F8: lambda: 305, 0x00FA: lambda: 312,  # 0.1 degrees C of drive and motor
            0x00FC: lambda: 0, 0x00FE: lambda: 0,  # turns in all and since a reset
            0x0120: self.stage.position, 0x0178: self._internal,
            ALARM_RESET: lambda: self._reset,
        }  # fmt: skip

    def power_up(self) -> None:
        """Lose power and get it back: the motor is at rest, the absolute encoder still knows its
        position.
        """
        position = self.stage.position()
        self.stage.power_up()
        if self._valid:
            self.stage.set_position(position)
        self._alarm = self._inputs = 0

    def memory(self) -> dict[str, Any]:
        """As its motor's; the absolute encoder keeps the reference."""
        return self.stage.memory() | {"homed": self._valid}

    def recall(self, place: float, counter: int, homed: bool) -> None:
        """Stand where it stood."""
        self.stage.recall(place, counter, homed)
        self._valid, self._commanded = homed, counter

    def read(self, pair: int) -> int:
        """The value of two registers at one instant; ``pair`` is the number of the first, an even
        one.

        Raises:
            RefusedError: there is none of this number (2).
        """
        self._settle()
        if pair in self._monitors:
            return self._monitors[pair]()
        if pair in self._operation:
            return self._operation[pair]
        if pair in self._parameters:
            return self._parameters[pair]
        raise RefusedError(2)

    def write(self, register: int, words: list[int]) -> None:
        """Registers one after the other; a pair that is complete takes effect.

        Raises:
            RefusedError: there is none of such a number (2).
        """
        self._settle()
        places = range(register, register + len(words))
        if any(
            place & ~1 not in (*self._operation, *self._parameters, PULSES, INPUTS, ALARM_RESET)
            for place in places
        ):
            raise RefusedError(2)
        for place, word in zip(places, words, strict=True):
            pair, old = place & ~1, self._value(place & ~1)
            new = (old & ~0xFFFF) | word if place & 1 else (old & 0xFFFF) | word << 16
            self._take(
                pair, new - (1 << 32) if new & (1 << 31) and new > 0 else new, lower=bool(place & 1)
            )

    def _value(self, pair: int) -> int:
        stored = self._operation.get(pair, self._parameters.get(pair))
        return (
            {PULSES: 0, INPUTS: self._inputs, ALARM_RESET: self._reset}.get(pair, 0)
            if stored is None
            else stored
        )

    def _take(self, pair: int, value: int, *, lower: bool) -> None:
        if pair in self._operation:
            self._operation[pair] = value
            if pair == TRIGGER and lower and value:
                self._start()
        elif pair in self._parameters:
            self._parameters[pair] = value
        elif lower and pair == INPUTS:
            risen = value & ~self._inputs
            self._inputs = value
            self._act(risen)
        elif lower and pair == PULSES:
            self._act(value)
        elif lower and pair == ALARM_RESET:
            if value and not self._reset:
                self._alarm = 0
            self._reset = value

    def _act(self, risen: int) -> None:
        """What inputs do that have just come on."""
        if risen >> self.wiring.stop_input & 1:
            self.stage.stop()
        if risen >> self.wiring.reset_input & 1:
            self._alarm = 0
        if (
            risen >> self.wiring.home_input & 1
            and self._ready()
            and not self.faults.ignores_motion()
        ):
            self.stage.raised.clear()
            self.stage.home()
            self._homing, self._commanded = True, 0

    def _start(self) -> None:
        """Carry out the direct data operation; when not ready it is let be, without a word."""
        kind, position, speed = (self._operation[OPERATION + offset] for offset in (2, 4, 6))
        rate = self._operation[OPERATION + 8]
        if not self._ready() or self.faults.ignores_motion():
            return
        wrap = bool(self._parameters[WRAP])
        if (
            not 0 < speed <= FASTEST
            or kind not in (ABSOLUTE, BY_COMMAND, BY_FEEDBACK, *WRAP_TYPES)
            or (kind in WRAP_TYPES) > wrap
        ):
            self._alarm = BAD_DATA
            return
        target = self._target(kind, position)
        if kind not in (BY_COMMAND, BY_FEEDBACK) and not self._valid:
            self._alarm = NO_REFERENCE
        elif (
            self._parameters[OVERTRAVEL] != -1
            and not self._parameters[LOWER] <= target <= self._parameters[UPPER]
        ):
            self._alarm = SOFTWARE_LIMIT
        elif self.stage.lower <= target <= self.stage.upper:
            self.stage.raised.clear()
            self._at_home = False
            self._commanded = target
            self.stage.move_to(target, speed, max(1, rate))

    def _target(self, kind: int, position: int) -> int:
        here = self.stage.position()
        if kind == BY_COMMAND:
            return self._commanded + position
        if kind == BY_FEEDBACK:
            return here + position
        if kind in WRAP_TYPES:
            within = here + self._wrapped(position) - self._wrapped(here)
            return (
                within + round(self._turn * round((here - within) / self._turn))
                if kind == 9
                else within
            )
        return position

    def _wrapped(self, position: int) -> int:
        """A position within half a turn to either side of zero, where positions are wrapped."""
        return (
            round(position - self._turn * math.floor(position / self._turn + 0.5))
            if self._parameters[WRAP]
            else position
        )

    def _settle(self) -> None:
        """Draw the consequences of what has ended since."""
        if self.stage.busy():
            return
        raised, here = self.stage.flags(), self.stage.position()
        if "FS" in raised:
            self._alarm = POSITION_DEVIATION
        if "WL" in raised:
            self._alarm = HARDWARE_LIMIT
        if raised & {"FS", "NI", "WL"}:
            self._commanded = here
            self.stage.raised.clear()
        if self._homing:
            self._homing = False
            self._valid = self._valid or self.stage.reference == "homed"
            self._at_home = self._valid and here == 0

    def _ready(self) -> bool:
        stopped = self._inputs >> self.wiring.stop_input & 1
        return not (self._alarm or self.stage.busy() or stopped) and self.stage.enabled

    def _position(self) -> int:
        return self._wrapped(self.stage.position())

    def _command_position(self) -> int:
        return (
            self._position()
            if self.stage.busy() or not self._valid
            else self._wrapped(self._commanded)
        )

    def _speed(self) -> int:
        return round(60 * self.stage.velocity() / self._turn)  # r/min of the table

    def _speed_hz(self) -> int:
        return round(self.stage.velocity())

    def _outputs(self) -> int:
        busy, wiring = self.stage.busy(), self.wiring
        bits = {
            4: self._at_home,
            wiring.ready_output: self._ready(),
            wiring.alarm_output: bool(self._alarm),
            wiring.moving_output: busy,
        }
        return sum(1 << bit for bit, on in (bits | {14: not busy}).items() if on)

    def _internal(self) -> int:
        """Internal outputs by function code: 144 HOME-END and 145 ABSPEN in the upper word, 129
        ALM-A, 132 READY, 134 MOVE in the lower.
        """
        upper = self._at_home | self._valid << 1
        return (
            upper << 16
            | bool(self._alarm) << 1
            | self._ready() << 4
            | self.stage.busy() << 6
            | (not self.stage.busy()) << 10
        )


class Line:
    """Drives on one RS-485 line by slave number; slave 0 is everyone and is not answered, an absent
    slave is silence.
    """

    def __init__(self, drives: Mapping[int, Drive], lock: threading.RLock) -> None:
        """Join drives; ``lock`` is the world's."""
        self.drives, self.lock = drives, lock

    def answer(self, message: bytes) -> bytes:
        """What comes back to a message with its CRC; nothing where that is wrong."""
        if crc(message[:-2]) != message[-2:]:
            return b""
        if message[0] == 0:
            for drive in self.drives.values():
                _reply(drive, message)
            return b""
        drive = self.drives.get(message[0])
        if drive is None:
            return b""
        if not drive.faults.before(drive):
            return b""
        return drive.faults.reply(_reply(drive, message), _wrong_crc, _strangers) or b""


def _reply(drive: Drive, message: bytes) -> bytes:
    slave, function = message[:2]
    try:
        body = bytes((slave, function)) + _do(drive, function, message[2:-2])
    except RefusedError as refusal:
        body = bytes((slave, function | 0x80, refusal.args[0]))
    return body + crc(body)


def _do(drive: Drive, function: int, data: bytes) -> bytes:
    if function == 0x08:
        return data
    words = [
        int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data) - len(data) % 2, 2)
    ]
    if function == 0x03:
        return _registers(drive, *words[:2])
    if function == 0x06:
        drive.write(words[0], words[1:2])
        return data
    if function == 0x10:
        _write_block(drive, words[0], words[1], data[4], data[5:])
        return data[:4]
    if function == 0x17:
        _write_block(drive, words[2], words[3], data[8], data[9:])
        return _registers(drive, *words[:2])
    raise RefusedError(1)


def _registers(drive: Drive, register: int, count: int) -> bytes:
    if not 1 <= count <= MOST_REGISTERS:
        raise RefusedError(3)
    pairs = {pair: drive.read(pair) for pair in range(register & ~1, register + count, 2)}
    words = [
        (pairs[place & ~1] >> (0 if place & 1 else 16)) & 0xFFFF
        for place in range(register, register + count)
    ]
    return bytes((2 * count,)) + b"".join(word.to_bytes(2, "big") for word in words)


def _write_block(drive: Drive, register: int, count: int, length: int, values: bytes) -> None:
    if not 1 <= count <= MOST_REGISTERS or length != 2 * count or len(values) != length:
        raise RefusedError(3)
    drive.write(
        register, [int.from_bytes(values[at : at + 2], "big") for at in range(0, length, 2)]
    )


def _wrong_crc(answer: bytes) -> bytes:
    return answer[:-1] + bytes((answer[-1] ^ 0x01,))


def _strangers(answer: bytes) -> bytes:
    """The answer in the name of slave 77."""
    return bytes((77,)) + answer[1:-2] + crc(bytes((77,)) + answer[1:-2])


class LineSession:
    """Cuts a client's bytes into messages by their function codes; a pause ends what was left
    incomplete.
    """

    def __init__(self, line: Line) -> None:
        """Begin with nothing heard."""
        self._line = line
        self._heard = b""
        self._last = 0.0

    def receive(self, data: bytes) -> bytes:
        """Answer every complete message; one of unknown length is taken as all that has come."""
        now = time.monotonic()
        self._heard = (self._heard if now - self._last < SILENCE else b"") + data
        self._last = now
        answers: list[bytes] = []
        while len(self._heard) >= 4 and (length := _length(self._heard)) <= len(self._heard):
            message, self._heard = self._heard[:length], self._heard[length:]
            with self._line.lock:
                answers.append(self._line.answer(message))
        return b"".join(answers)

    def unasked(self) -> bytes:
        """Answers that come late; else slaves speak when spoken to."""
        with self._line.lock:
            return b"".join(drive.faults.late_answer() for drive in self._line.drives.values())


def _length(heard: bytes) -> int:
    """Bytes of the message that begins here, more than there are where it does not say yet."""
    function = heard[1]
    if function in LENGTHS:
        return LENGTHS[function]
    if function in (0x10, 0x17):
        place = 6 if function == 0x10 else 10
        return place + 3 + heard[place] if len(heard) > place else len(heard) + 1
    return len(heard)

"""Oriental Motor AZ drives by Modbus RTU: several slaves on one RS-485 line, such as a goniometer
and a hollow rotary table.

What this file relies on, from the AZ series' operating manual HM-60262E and public drivers that
cite it:

- Values are 32 bits in two registers, the upper word first. Eight of them from 0x0058 on are one
  operation: data number, type, position in steps, speed in Hz, starting and stopping rate in Hz/s,
  current in 0.1 %, trigger. Type 1 goes to an absolute position, type 8 to one within the wrap
  range.
- Speeds go to 4,000,000 Hz and rates to 1,000,000,000 Hz/s; more is acknowledged and raises alarm
  70 when it is to be carried out.
- 0x007D takes inputs, 0x007F gives outputs, one bit each; which bit is what is a setting of the
  drive. By default inputs are 4 ZHOME, 5 STOP, 7 ALM-RST; outputs 5 READY, 7 ALM-A, 13 MOVE.
- 0x0080 is the present alarm, 0x00C6 and 0x00CC are the commanded and the measured position, bit 1
  of 0x0178 (ABSPEN) says that the position has a reference, 0x0386 to 0x038B are the software
  limits.
- A command that a drive cannot do now is acknowledged all the same, and then nothing happens,
  without an alarm. So every start is watched until the drive moves or has arrived.

Not confirmed from the manual: that a wrapped position never crosses the end of the wrap range on
its way (type 8), and that a drive whose home sensor was never found refuses ZHOME: where the
reference has to be searched for, assign HOME to an input and give its bit as ``home_input``. On
close the motor stays excited and holds.
"""

import math
import time
from collections.abc import Callable
from typing import Annotated, Literal

from pydantic import Field, model_validator

from drivers.modbus import ModbusLine, make_client
from flflab.bench import AxisDescription
from flflab.description import Description, Ratio, Time
from flflab.errors import CommunicationError, DeviceError, LimitError

OPERATION = 0x0058
INPUTS, OUTPUTS = 0x007C, 0x007E
ALARM, COMMANDED, MEASURED, INTERNAL = 0x0080, 0x00C6, 0x00CC, 0x0178
ALARM_RESET = 0x0180  # on the edge from 0 to 1
OVERTRAVEL, UPPER_LIMIT, LOWER_LIMIT = 0x0386, 0x0388, 0x038A
ABSOLUTE, WITHIN_WRAP, ALL_AT_ONCE = 1, 8, 1
HAS_REFERENCE = 1 << 17  # ABSPEN, bit 1 of the upper word
START_S = 0.5  # until a motion shows
FASTEST, STEEPEST = 4_000_000, 10**9  # Hz and Hz/s; more is acknowledged, and ends in alarm 70
ALARMS = {
    0x10: "position deviation: the load is too heavy or blocked; free it, then reset",
    0x20: "overcurrent: check the motor cable, then switch the drive off and on",
    0x21: "drive too hot; let it cool",
    0x22: "overvoltage; check the supply and the load",
    0x23: "main power off; switch it on",
    0x25: "undervoltage; check the supply",
    0x26: "motor too hot; let it cool",
    0x28: "sensor error; check the motor cable, then switch the drive off and on",
    0x2A: (
        "no connection to the absolute encoder; check the cable, then switch the drive off and on"
    ),
    0x30: "overload; free the axis, then reset",
    0x31: "overspeed; give a lower speed",
    0x33: "the absolute position is lost; home it again after switching the drive off and on",
    0x34: "too fast a pulse input",
    0x41: "memory error; have the drive repaired",
    0x45: "another motor than the drive was set up for; connect the right one",
    0x4A: "an absolute move before it has a reference; home it",
    0x60: "both limit sensors are on; check their wiring",
    0x61: "limit sensors swapped; check their wiring",
    0x62: "homing failed; look at the home sensor",
    0x63: "no home sensor found; look at it and its wiring",
    0x64: "a signal that homing waits for did not come; look at its sensor",
    0x66: "at a limit sensor; look what brought it there, then home it again",
    0x67: "at its software limit; ask for a position inside",
    0x68: "motor power cut by the safety input; release it",
    0x6A: "a limit sensor lies on the way from the home sensor to home; correct the home offset",
    0x6D: "at the end of its mechanism; look what brought it there, then home it again",
    0x70: "operation data it cannot carry out; check speed and `wrap`",
    0x71: "wrong electronic gear; correct it by the maker's software",
    0x72: "wrong wrap setting; correct it by the maker's software",
    0x81: "network bus error; check cables",
    0x83: "a switch is set wrong; correct it and switch the drive off and on",
    0x84: "errors on the RS-485 line; check cable, parity and termination",
    0x85: "nobody spoke on the RS-485 line for too long; reset",
    0xF0: "processor error; switch the drive off and on",
}
Share = Callable[[str, Callable[[], ModbusLine]], ModbusLine]
Bit = Annotated[int, Field(ge=0, le=15)]


class OrientalKeys(Description):
    """The keys of an Oriental Motor axis in the bench file.

    ``device`` is the slave number at the drive's switch. ``steps_per_degree`` counts the drive's
    steps, after its electronic gear, to one degree of the table. ``ramp`` is the time to reach the
    speed, ``current`` a share of the rated one, ``deadband`` how many steps from its target it may
    rest. ``home_input`` to ``moving_output`` are bits of the drive's input and output words.
    """

    device: Annotated[int, Field(ge=1, le=31)]
    steps_per_degree: Annotated[float, Field(gt=0)]
    wrap: bool = False
    ramp: Annotated[Time, Field(gt=0)] = 0.2
    current: Annotated[Ratio, Field(gt=0, le=1)] = 1.0
    deadband: Annotated[int, Field(ge=1)] = 2
    home_input: Bit = 4
    stop_input: Bit = 5
    ready_output: Bit = 5
    alarm_output: Bit = 7
    moving_output: Bit = 13
    baud: Annotated[int, Field(ge=9600)] = 115200
    parity: Literal["E", "N", "O"] = "E"
    timeout: Annotated[float, Field(gt=0)] = 0.5

    @model_validator(mode="after")
    def _bits_differ(self) -> "OrientalKeys":
        for signals in (
            ("home_input", "stop_input"),
            ("ready_output", "alarm_output", "moving_output"),
        ):
            bits = [getattr(self, signal) for signal in signals]
            if len(set(bits)) < len(bits):
                raise ValueError(
                    f"{', '.join(signals)} are bits {', '.join(map(str, bits))}; give each a bit of"
                    " its own"
                )
        return self


class OrientalAxis:
    """One drive of a line, in rad; satisfies ``AxisCommands``. Connecting reads its software
    limits; nothing moves.

    Args:
        name: the axis's name in the bench file.
        line: the line it is on.
        keys: its own keys of the bench file.
        speed: of moves, rad/s.

    Raises:
        CommunicationError: the drive does not answer, or not in this protocol.
        DeviceError: it refuses.
    """

    measured = True

    def __init__(self, name: str, line: ModbusLine, keys: OrientalKeys, speed: float) -> None:
        self._name = name
        self._line = line
        self._keys = keys
        self._step = math.pi / 180 / keys.steps_per_degree
        self._speed, self._rate = round(speed / self._step), round(speed / self._step / keys.ramp)
        if not 1 <= self._speed <= FASTEST:
            raise DeviceError(
                f"{name}: asked for {math.degrees(speed):g} deg/s, {self._speed} steps/s of a drive"
                f" that does 1 to {FASTEST}; correct `speed` or `steps_per_degree`"
            )
        if not 1 <= self._rate <= STEEPEST:
            raise DeviceError(
                f"{name}: asked to reach its speed in {keys.ramp:g} s, {self._rate} steps/s^2 of a"
                f" drive that does 1 to {STEEPEST}; correct `ramp`"
            )
        self.resolution = keys.deadband * self._step
        limited = self._read(OVERTRAVEL) != -1
        self.travel = (
            (self._read(LOWER_LIMIT) * self._step, self._read(UPPER_LIMIT) * self._step)
            if limited
            else (-math.inf, math.inf)
        )

    def start_home(self) -> None:
        """Start to look for the reference; an alarm that can be reset is.

        Raises:
            DeviceError: the drive is not ready, or takes the command and does nothing.
        """
        if self.faults():
            for level in (1, 0):
                self._line.write(self._name, self._keys.device, ALARM_RESET, (level,))
        self._require_ready("look for its reference")
        had_reference = self.is_homed()
        _pulse(self._line, self._name, self._keys.device, self._keys.home_input)
        self._see_it_start(
            "look for its reference",
            lambda: (not had_reference or self._read(COMMANDED) == 0) and self.is_homed(),
        )

    def start_move(self, position: float) -> None:
        """Start towards a reading in rad, rounded to the step.

        Raises:
            DeviceError: the drive is not ready, or takes the command and does nothing.
            LimitError: the reading is further than the drive can count.
        """
        steps = round(position / self._step)
        if not -(2**31) <= steps < 2**31:
            raise LimitError(
                f"{self._name}: {math.degrees(position):g} deg are {steps} steps, more than the"
                " drive can count; nothing moved"
            )
        task = f"move to {math.degrees(position):.6f} deg"
        self._require_ready(task)
        kind = WITHIN_WRAP if self._keys.wrap else ABSOLUTE
        operation = (
            0,
            kind,
            steps,
            self._speed,
            self._rate,
            self._rate,
            round(1000 * self._keys.current),
            ALL_AT_ONCE,
        )
        self._line.write(self._name, self._keys.device, OPERATION, operation)
        self._see_it_start(task, lambda: self._read(COMMANDED) == steps)

    def position(self) -> float:
        """The measured reading in rad."""
        return self._read(MEASURED) * self._step

    def reading(self) -> float | None:
        """The measured reading in rad, None without a reference; an absolute encoder that has one
        keeps it.
        """
        return self.position() if self.is_homed() else None

    def is_busy(self) -> bool:
        """Whether it moves."""
        return self._output(self._read(OUTPUTS), self._keys.moving_output)

    def is_homed(self) -> bool:
        """Whether its position has a reference; an absolute encoder keeps it while switched off."""
        return bool(self._read(INTERNAL) & HAS_REFERENCE)

    def stop(self) -> None:
        """Decelerate to rest."""
        _stop(self._line, self._name, self._keys)

    def faults(self) -> tuple[str, ...]:
        """The alarm, if there is one."""
        alarm = self._read(ALARM)
        return (f"alarm {alarm:02X}, {ALARMS.get(alarm, 'see the manual')}",) if alarm else ()

    def warnings(self) -> tuple[str, ...]:
        """The alarm, whether it lacks a reference, and whether it is not ready though it rests."""
        outputs = self._read(OUTPUTS)
        idle = not self._output(outputs, self._keys.moving_output)
        not_ready = ("not ready",) * (idle and not self._output(outputs, self._keys.ready_output))
        return (*self.faults(), *(() if self.is_homed() else ("not homed",)), *not_ready)

    def identity(self) -> str:
        """What the bench file says it is: the protocol tells neither model nor serial number."""
        return f"Oriental Motor AZ drive, slave {self._keys.device}"

    def serial(self) -> str:
        """None that the protocol tells."""
        return ""

    def close(self) -> None:
        """Nothing: the line is closed by who opened it; the motor holds."""

    def _read(self, register: int) -> int:
        return self._line.read(self._name, self._keys.device, register)

    @staticmethod
    def _output(outputs: int, bit: int) -> bool:
        return bool(outputs >> bit & 1)

    def _require_ready(self, task: str) -> None:
        outputs = self._read(OUTPUTS)
        if self._output(outputs, self._keys.alarm_output):
            raise DeviceError(
                f"{self._name}: asked to {task}, but it has"
                f" {'; '.join(self.faults()) or 'an alarm'}; nothing moved"
            )
        ready, moving = self._keys.ready_output, self._keys.moving_output
        if not (self._output(outputs, ready) or self._output(outputs, moving)):
            # a stop whose end the drive did not hear left its input on
            self._line.write(self._name, self._keys.device, INPUTS, (0,))
            outputs = self._read(OUTPUTS)
        if not self._output(outputs, ready):
            raise DeviceError(
                f"{self._name}: asked to {task}, but its drive is not ready; end what else drives"
                " it, check excitation and stop input, nothing moved"
            )

    def _see_it_start(self, task: str, arrived: Callable[[], bool]) -> None:
        """Watch a drive that has acknowledged a command until it moves or has arrived; where it
        does neither it is stopped.
        """
        deadline = time.monotonic() + START_S
        while True:
            if self.is_busy() or arrived():
                return
            alarm = self.faults()
            if alarm or time.monotonic() > deadline:
                self.stop()
                why = (
                    f"raised {alarm[0]}"
                    if alarm
                    else (
                        f"did nothing for {START_S:g} s; told to stop, see that no other master"
                        " drives it"
                    )
                )
                raise DeviceError(
                    f"{self._name}: asked to {task}, the drive acknowledged and {why}"
                )


def open_axis(name: str, axis: AxisDescription, keys: OrientalKeys, share: Share) -> OrientalAxis:
    """Open one drive; drives at one address share the line."""
    return OrientalAxis(name, _line(axis, keys, share, alone=True), keys, axis.speed)


def stop_axis(
    name: str, axis: AxisDescription, keys: OrientalKeys, share: Share
) -> Callable[[], bool]:
    """Stop one drive, asked for nothing before; what is returned tells whether it still moves."""
    line = _line(axis, keys, share, alone=False)
    _stop(line, name, keys)
    return lambda: bool(line.read(name, keys.device, OUTPUTS) >> keys.moving_output & 1)


def _line(axis: AxisDescription, keys: OrientalKeys, share: Share, *, alone: bool) -> ModbusLine:
    return share(
        axis.address,
        lambda: ModbusLine(
            lambda: make_client(axis.address, keys.baud, keys.parity, keys.timeout, alone=alone),
            axis.address,
            keys.timeout,
        ),
    )


def _pulse(line: ModbusLine, name: str, device: int, bit: int, *, urgent: bool = False) -> None:
    """A drive's input on and off again: drives act on the edge."""
    for level in (1 << bit, 0):
        line.write(name, device, INPUTS, (level,), urgent=urgent)


def _stop(line: ModbusLine, name: str, keys: OrientalKeys) -> None:
    """Decelerate a drive to rest: goes before all who wait for the line, and the drive confirms
    it.
    """
    try:
        _pulse(line, name, keys.device, keys.stop_input, urgent=True)
    except CommunicationError:
        _pulse(line, name, keys.device, keys.stop_input, urgent=True)

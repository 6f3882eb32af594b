"""Standa stages on 8SMC4 and 8SMC5 controllers by libximc, the maker's library (the extra
``standa``); one controller an address.

What this file relies on, from the library's header ``ximc.h`` (3.0.4) and as seen on the emulated
controller it comes with (``xi-emu:///file``):

- Positions are whole motor steps and parts of a step, 1/2^(mode - 1) in microstep mode ``mode``,
  both with the same sign; here one integer. Speeds likewise.
- The last motion command is in ``MvCmdSts`` (bits 0 to 5 which one, 6 ended with an error, 7
  running); 0 is none since it was switched on. STATE_IS_HOMED says that positions are counted from
  a sensor; the controller drops it where steps may have been lost.
- ``home`` goes where the controller's own home settings send it (HOME_DIR_FIRST: to higher readings
  first); ``zero`` declares the place it ends at to be 0. ``sstp`` stops with the set deceleration.
- With BORDER_IS_ENCODER the controller keeps within LeftBorder and RightBorder.
- In its alarm state a controller passes over most commands.

Play compensation overshoots the target from one side: it is switched off, since a motion has to
stay between its ends. Not confirmed on a real controller: that STATE_IS_HOMED stays through
``zero``. The emulated controller never sets it, so a homing that this program has seen to its end
counts as well, until the controller shows that it was switched off. On close the motor holds as its
power settings say.
"""

import contextlib
import math
import re
import threading
import time
from collections.abc import Callable
from operator import methodcaller
from typing import Annotated, Any, TypeVar

from pydantic import Field

from drivers.line import Line
from drivers.transport import LostError, serial_place
from flflab.bench import AxisDescription
from flflab.description import Description, Length
from flflab.errors import CommunicationError, DeviceError, NotHomedError

POWER_OFF_AT_REST = 2
STEPPER, ENCODERS = 3, (1, 6)  # kind of motor; feedbacks whose positions are counts of an encoder
RUNNING, FAILED, COMMAND, HOME = 0x80, 0x40, 0x3F, 6
HOMED, ALARM, LEFT_SWITCH, RIGHT_SWITCH = 0x20, 0x40, 0x2, 0x1
ENDS_ARE_SET, ANTIPLAY, HOMES_UP = 0x01, 0x08, 0x001
START_S = 0.5  # until a motion shows
FLAGS = {
    ALARM: "alarm: it takes no command until the cause is gone and the alarm is cleared in the maker's software",  # noqa: E501
    0x80: "steps and encoder are too far apart", 0x100: "power stage too hot",
    0x200: "controller too hot",
    0x400: "supply voltage too high",
    0x800: "supply current too high", 0x1000: "USB voltage too high", 0x2000: "USB voltage too low",
    0x4000: "USB current too high",
    0x8000: "limit switches swapped", 0x10000: "supply voltage too low", 0x20000: "bridge fault",
    0x100000: "windings do not match",
    0x200000: "encoder fault", 0x800000: "the motor does not respond", 0x1000000: "external alarm",
}  # fmt: skip

Answer = TypeVar("Answer")
Share = Callable[[str, Callable[[], "StandaController"]], "StandaController"]


class StandaKeys(Description):
    """The keys of a Standa axis in the bench file: ``step`` is the travel of one full motor step,
    2.5 um of an 8MT175.
    """

    step: Annotated[Length, Field(gt=0)]


class Device:
    """A controller as the library has it, open."""

    def __init__(self, uri: str) -> None:
        try:
            import libximc.highlevel as ximc
        except (ImportError, RuntimeError) as error:
            raise DeviceError(
                f"{uri}: the maker's library does not load ({error}); pip install 'flflab[standa]'"
            ) from error
        self.axis: Any = ximc.Axis(uri)
        try:
            self.axis.open_device()
        except ConnectionError as error:
            raise CommunicationError(
                f"{uri}: cannot be opened; check the address, power, and who else holds it"
            ) from error

    def close(self) -> None:
        """Let go of it; raises nothing."""
        with contextlib.suppress(ConnectionError, RuntimeError):
            self.axis.close_device()


class StandaController:
    """One controller: one command at a time, each a few milliseconds; opened anew after it was
    lost.

    Args:
        address: a port (``COM3``, ``/dev/ttyACM0``) or the library's own ``xi-com:``, ``xi-net:``,
            ``xi-emu:`` addresses.

    Raises:
        CommunicationError: it does not answer.
        DeviceError: the library is missing.
    """

    def __init__(self, address: str) -> None:
        port = address if address.startswith("/") else "\\\\.\\" + address  # as Windows names ports
        uri = address if address.startswith("xi-") else f"xi-com:{port}"
        self._line = Line(lambda: Device(uri))
        self._turn = threading.Lock()

    def ask(self, name: str, task: str, ask: Callable[[Any], Answer]) -> Answer:
        """Call the library.

        Raises:
            LostError: the controller is gone.
            DeviceError: it refuses.
        """
        with self._turn:
            device = self._line.get(f"{name}: asked to {task}, ")
            try:
                return ask(device.axis)
            except ConnectionError as error:
                self._line.lose(device)
                raise LostError(
                    f"{name}: asked to {task}, the controller is gone; check its cable and power"
                ) from error
            # the library's own words for a refusal; the last for a command that the controller's
            # firmware does not have
            except (RuntimeError, ValueError, NotImplementedError) as error:
                reason = str(error).partition(".")[0]
                raise DeviceError(
                    f"{name}: asked to {task}, the controller refuses ({reason}); check model and"
                    " firmware"
                ) from error

    def stop(self, name: str) -> None:
        """Decelerate to rest; errors as ``ask``."""
        try:
            self.ask(name, "stop", lambda axis: axis.command_sstp())
        except LostError:
            self.ask(name, "stop", lambda axis: axis.command_sstp())

    def close(self) -> None:
        """Let go of it."""
        self._line.close()


class StandaAxis:
    """A linear stage on a controller, in mm; satisfies ``AxisCommands``.

    Connecting sets the speed and switches play compensation off; nothing moves.

    Args:
        name: the axis's name in the bench file.
        controller: its controller.
        keys: its own keys of the bench file.
        speed: of moves, mm/s.
        homes_up: whether it is to look for its reference towards higher readings.

    Raises:
        CommunicationError: the controller does not answer.
        DeviceError: it counts encoder pulses, homes the other way, or does not take a setting.
    """

    measured = False

    def __init__(
        self,
        name: str,
        controller: StandaController,
        keys: StandaKeys,
        speed: float,
        *,
        homes_up: bool,
    ) -> None:
        self._name = name
        self._controller = controller
        self._referenced = self._homing = False
        motor, feedback = self._ask(
            "say what motor it has",
            lambda axis: (axis.get_entype_settings(), axis.get_feedback_settings()),
        )
        if int(motor.EngineType) != STEPPER or int(feedback.FeedbackType) in ENCODERS:
            raise DeviceError(
                f"{name}: its controller counts an encoder, this driver counts motor steps; set it"
                " to a stepper without encoder"
            )
        engine = self._ask("say how it drives", lambda axis: axis.get_engine_settings())
        self._parts = 1 << (int(engine.MicrostepMode) - 1)
        self.resolution = keys.step / self._parts
        self.travel = self._read_travel(keys.step)
        self._speed, self._homes_up = round(speed / self.resolution), homes_up
        self._set_up()

    def _set_up(self) -> None:
        """Play compensation off, the speed as wanted, and a look at the way home; a controller that
        was off has forgotten the first two.
        """
        self._switch_play_compensation_off()
        self._set_speed(self._speed)
        home = self._ask("say how it homes", lambda axis: axis.get_home_settings())
        if bool(int(home.HomeFlags) & HOMES_UP) != self._homes_up:
            where = "higher" if not self._homes_up else "lower"
            raise DeviceError(
                f"{self._name}: its controller homes towards {where} readings; correct"
                " `home_towards` or the controller's settings"
            )

    def start_home(self) -> None:
        """Start to look for the reference; a controller without one may have been off.

        Raises:
            DeviceError: the controller is in alarm, homes the other way, does not take a setting,
                or takes the command and does nothing.
        """
        self._require_no_alarm("look for its reference")
        if not self.is_homed():
            self._set_up()
        self._referenced = False
        for command in (
            "command_sstp",
            "command_home",
        ):  # a stop first, so that the homing seen is this one
            self._ask("look for its reference", methodcaller(command))
        self._see_it(
            "look for its reference", lambda status: int(status.MvCmdSts) & COMMAND == HOME
        )
        self._homing = True

    def start_move(self, position: float) -> None:
        """Start towards a reading in mm, rounded to the microstep.

        Raises:
            NotHomedError: it has just lost its reference.
            DeviceError: the controller is in alarm, or takes the command and does nothing.
        """
        count = round(position / self.resolution)
        task = f"move to {position:.6f} mm"
        self._require_no_alarm(task)
        if self.reading() is None:
            raise NotHomedError(
                f"{self._name}: asked to {task}, but it just lost its reference (switched off?);"
                " home it, nothing moved"
            )
        self._homing = False
        self._ask(task, lambda axis: axis.command_move(*self._steps(count)))
        self._see_it(
            task,
            lambda status: bool(int(status.MvCmdSts) & RUNNING) or self._count(status) == count,
        )

    def position(self) -> float:
        """The reading in mm."""
        return self._count(self._status()) * self.resolution

    def is_busy(self) -> bool:
        """Whether it moves; a homing that has come to its end is declared zero here."""
        status = self._status()
        if int(status.MvCmdSts) & RUNNING or int(status.MoveSts):
            return True
        if self._homing:
            self._homing = False
            if int(status.MvCmdSts) == HOME and not int(status.Flags) & ALARM:
                self._ask("count from here", lambda axis: axis.command_zero())
                self._referenced = True
        return False

    def reading(self) -> float | None:
        """The reading in mm, None without a reference; one status tells both."""
        status = self._status()
        return self._count(status) * self.resolution if self._has_reference(status) else None

    def is_homed(self) -> bool:
        """Whether its position is counted from its sensor."""
        return self._has_reference(self._status())

    def stop(self) -> None:
        """Decelerate to rest; a homing that is stopped found nothing."""
        self._homing = False
        self._controller.stop(self._name)

    def faults(self) -> tuple[str, ...]:
        """What the status says is wrong, and whether the last motion ended with an error."""
        status = self._status()
        failed = ("the last motion ended with an error",) if int(status.MvCmdSts) & FAILED else ()
        return (*(phrase for flag, phrase in FLAGS.items() if int(status.Flags) & flag), *failed)

    def warnings(self) -> tuple[str, ...]:
        """Faults, limit switches, and whether it lacks a reference."""
        switches = int(self._status().GPIOFlags)
        at_ends = {
            LEFT_SWITCH: "at its left limit switch",
            RIGHT_SWITCH: "at its right limit switch",
        }
        pressed = tuple(phrase for flag, phrase in at_ends.items() if switches & flag)
        return (*self.faults(), *pressed, *(() if self.is_homed() else ("not homed",)))

    def identity(self) -> str:
        """Maker, model, serial number and firmware."""
        about, serial, firmware = self._ask(
            "say what it is",
            lambda axis: (
                axis.get_device_information(),
                axis.get_serial_number(),
                axis.get_firmware_version(),
            ),
        )
        return (
            f"{about.Manufacturer} {about.ProductDescription}, serial {serial}, firmware"
            f" {'.'.join(map(str, firmware))}"
        )

    def serial(self) -> str:
        """The controller's serial number; an emulated one has none and says 0."""
        serial = self._ask("say its serial number", lambda axis: axis.get_serial_number())
        return str(serial) if serial else ""

    def close(self) -> None:
        """Nothing: the controller is closed by who opened it; the motor holds."""

    def _ask(self, task: str, ask: Callable[[Any], Answer]) -> Answer:
        return self._controller.ask(self._name, task, ask)

    def _status(self) -> Any:
        return self._ask("say its state", lambda axis: axis.get_status())

    def _has_reference(self, status: Any) -> bool:
        self._referenced = self._referenced and bool(
            int(status.MvCmdSts) & COMMAND
        )  # none since it was switched on: it was off
        return bool(int(status.Flags) & HOMED) or self._referenced

    def _steps(self, count: int) -> tuple[int, int]:
        """Whole steps and parts of a step, with one sign."""
        steps, parts = divmod(abs(count), self._parts)
        return (steps, parts) if count >= 0 else (-steps, -parts)

    def _count(self, status: Any) -> int:
        return status.CurPosition * self._parts + status.uCurPosition

    def _require_no_alarm(self, task: str) -> None:
        if int(self._status().Flags) & ALARM:
            raise DeviceError(
                f"{self._name}: asked to {task}, but it has {'; '.join(self.faults())}; nothing"
                " moved"
            )

    def _see_it(self, task: str, begun: Callable[[Any], bool]) -> None:
        deadline = time.monotonic() + START_S
        while not begun(self._status()):
            if time.monotonic() > deadline:
                self.stop()
                raise DeviceError(
                    f"{self._name}: asked to {task}, the controller took it and did nothing for"
                    f" {START_S:g} s; look at its state"
                )

    def _switch_play_compensation_off(self) -> None:
        engine = self._ask("say how it drives", lambda axis: axis.get_engine_settings())
        if int(engine.EngineFlags) & ANTIPLAY:
            engine.EngineFlags = type(engine.EngineFlags)(int(engine.EngineFlags) & ~ANTIPLAY)
            self._ask("switch play compensation off", lambda axis: axis.set_engine_settings(engine))

    def _read_travel(self, step: float) -> tuple[float, float]:
        edges = self._ask("say its limits", lambda axis: axis.get_edges_settings())
        if not int(edges.BorderFlags) & ENDS_ARE_SET:
            return -math.inf, math.inf  # its limit switches end it
        left, right = (
            whole + part / self._parts
            for whole, part in (
                (edges.LeftBorder, edges.uLeftBorder),
                (edges.RightBorder, edges.uRightBorder),
            )
        )
        return left * step, right * step

    def _set_speed(self, count: int) -> None:
        wanted = divmod(count, self._parts)
        moving = self._ask("say its speed", lambda axis: axis.get_move_settings())
        if (moving.Speed, moving.uSpeed) == wanted:
            return
        moving.Speed, moving.uSpeed = wanted
        self._ask("take its speed", lambda axis: axis.set_move_settings(moving))
        kept = self._ask("say its speed", lambda axis: axis.get_move_settings())
        if (kept.Speed, kept.uSpeed) != wanted:
            raise DeviceError(
                f"{self._name}: asked for {wanted[0]} steps/s, it keeps {kept.Speed}; give a speed"
                " the stage can reach"
            )


def place(address: str) -> str:
    """An address spelt one way; the library's own as they are, but for ports.

    Raises:
        InputError: it is neither a port nor one of the library's.
    """
    port = address.removeprefix("xi-com:")
    return port if re.match(r"xi-(emu|net|tcp|udp):", port) else serial_place(port)


def open_axis(name: str, axis: AxisDescription, keys: StandaKeys, share: Share) -> StandaAxis:
    """Open the axis of one controller.

    Raises:
        DeviceError: a vertical axis would fall at rest.
    """
    controller = _controller(axis, share)
    if axis.vertical:
        power = controller.ask(name, "say its power", lambda device: device.get_power_settings())
        if int(power.PowerFlags) & POWER_OFF_AT_REST:
            raise DeviceError(
                f"{name}: it is vertical, and its controller switches the motor's current off at"
                " rest, so it would fall; switch that off in the maker's XILab"
            )
    return StandaAxis(name, controller, keys, axis.speed, homes_up=axis.homes_up)


def stop_axis(
    name: str, axis: AxisDescription, keys: StandaKeys, share: Share
) -> Callable[[], bool]:
    """Stop one axis, told nothing before; what is returned tells whether it still moves."""
    controller = _controller(axis, share)
    controller.stop(name)

    def moves(device: Any) -> bool:
        status = device.get_status()
        return bool(int(status.MvCmdSts) & RUNNING or int(status.MoveSts))

    return lambda: controller.ask(name, "say whether it moves", moves)


def _controller(axis: AxisDescription, share: Share) -> StandaController:
    return share(axis.address, lambda: StandaController(axis.address))

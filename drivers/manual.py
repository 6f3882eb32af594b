"""What a person turns by hand: a stage with a scale, an iris, a target holder. The terminal asks,
the person confirms.

Without a terminal a step fails at once with an error that names it. No thread waits for the
keyboard: it is looked at whenever the device is asked whether it is busy.
"""

import os
import select
import sys
from collections import deque
from collections.abc import Callable
from typing import Annotated, Generic

from pydantic import Field

from drivers.commands import Value
from flflab.bench import LENGTH, AxisDescription, Coordinate
from flflab.description import Description
from flflab.errors import DeviceError, MotionError

Share = Callable[[str, Callable[[], "Terminal"]], "Terminal"]


class ManualAxisKeys(Description):
    """A manual axis has no keys of its own."""


class ManualIrisKeys(Description):
    """``f_numbers``: the least and the largest f-number of the lens."""

    f_numbers: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1.0, 64.0)


class ManualTargetKeys(Description):
    """``names``: the targets at hand."""

    names: tuple[str, ...] = ("four-dot", "bars", "chirp", "edge", "texture", "white", "black")


class Question:
    """A step a person was asked for."""

    def __init__(self, step: str, terminal: "Terminal") -> None:
        self.step = step
        self._terminal = terminal

    def open(self) -> bool:
        """Whether the person has still to do it.

        Raises:
            MotionError: the person gave it up.
        """
        return self._terminal.look(self)

    def withdraw(self) -> None:
        """Ask no longer."""
        self._terminal.withdraw(self)


class Terminal:
    """The terminal of this process: one question at a time, the others in line."""

    def __init__(self) -> None:
        self._line: deque[Question] = deque()

    def ask(self, step: str) -> Question:
        """Ask a person for a step.

        Raises:
            DeviceError: there is no terminal to ask on.
        """
        if not (sys.stdin and sys.stdin.isatty()):
            raise DeviceError(
                f"a person has to do this: {step}; there is no terminal to ask on, run this in one"
                " or use a motorised device"
            )
        question = Question(step, self)
        self._line.append(question)
        if self._line[0] is question:
            self._pose(question)
        return question

    def look(self, question: Question) -> bool:
        """Whether a question is open; looks at the keyboard where it is the one posed."""
        if question not in self._line:
            return False
        if self._line[0] is question and (typed := _typed()):
            self.withdraw(question)
            if typed.strip().lower() in ("q", "quit"):
                raise MotionError(f"{question.step}: given up by the person at the terminal")
        return question in self._line

    def withdraw(self, question: Question) -> None:
        """Take a question back and pose the next."""
        if question in self._line:
            posed = self._line[0] is question
            self._line.remove(question)
            if posed and self._line:
                self._pose(self._line[0])

    def close(self) -> None:
        """Ask nothing more."""
        self._line.clear()

    def _pose(self, question: Question) -> None:
        _typed()  # a key pressed before the question is no answer to it
        print(
            f"\a{question.step}, then press Enter (q and Enter to give up): ",
            end="",
            file=sys.stderr,
            flush=True,
        )


def _typed() -> str:
    """What was typed since last looked, up to an Enter; empty without one."""
    if sys.platform == "win32":
        import msvcrt

        keys = ""
        while msvcrt.kbhit():
            keys += msvcrt.getwche()
        return keys.replace("\r", "\n")
    ready, _, _ = select.select([sys.stdin], [], [], 0)
    return os.read(sys.stdin.fileno(), 4096).decode(errors="replace") if ready else ""


class ManualAxis:
    """A stage moved by hand to a reading on its scale; satisfies ``AxisCommands``. Its position is
    the last one confirmed.

    Args:
        name: the axis's name in the bench file.
        limits: readings.
        terminal: where the person is asked.
        coordinate: whether it counts lengths or angles.
        home: the reading asked for in place of a reference.
    """

    resolution = 1e-6

    measured = True  # a person reads its scale

    def __init__(
        self,
        name: str,
        limits: tuple[float, float],
        terminal: Terminal,
        coordinate: Coordinate,
        home: float,
    ) -> None:
        self.travel = limits
        self._name = name
        self._terminal = terminal
        self._coordinate = coordinate
        self._home = home
        self._question: Question | None = None
        self._target = self._position = home
        self._known = False

    def start_home(self) -> None:
        """Ask for the reading that stands for a reference."""
        self.start_move(self._home)

    def start_move(self, position: float) -> None:
        """Ask for a reading."""
        self._question = self._terminal.ask(
            f"set {self._name} to {self._coordinate.show(position, '.3f')}"
        )
        self._target, self._known = position, False

    def position(self) -> float:
        """The reading last confirmed."""
        return self._position

    def reading(self) -> float | None:
        """The reading last confirmed, None while one is asked for or none was."""
        return self._position if self._known else None

    def is_busy(self) -> bool:
        """Whether the person has still to do it."""
        if self._question is not None and not self._question.open():
            self._question = None
            self._position, self._known = self._target, True
        return self._question is not None

    def is_homed(self) -> bool:
        """Whether a reading was confirmed and none is asked for."""
        return self._known

    def stop(self) -> None:
        """Ask no longer; where the stage stands is then not known."""
        if self._question is not None:
            self._question.withdraw()
            self._question = None

    def faults(self) -> tuple[str, ...]:
        """None: the person is believed."""
        return ()

    def warnings(self) -> tuple[str, ...]:
        """Whether a reading has been confirmed."""
        return () if self._known else ("no reading confirmed",)

    def identity(self) -> str:
        """What it is."""
        return "moved by hand"

    def serial(self) -> str:
        """None: a person knows which stage it is."""
        return ""

    def close(self) -> None:
        """Ask no longer."""
        self.stop()


class ManualSetting(Generic[Value]):
    """An iris or a target holder turned by hand; satisfies ``SettingCommands``. Its value is the
    last one confirmed.
    """

    def __init__(self, step: str, allowed: tuple[Value, ...], terminal: Terminal) -> None:
        self.allowed = allowed
        self._step = step
        self._terminal = terminal
        self._question: Question | None = None
        self._asked: Value | None = None
        self._value: Value | None = None

    def start(self, value: Value) -> None:
        """Ask for a value; one that is confirmed to be there is not asked for again."""
        if value == self._value:
            return
        self._question = self._terminal.ask(self._step.format(value))
        self._asked, self._value = value, None

    def is_busy(self) -> bool:
        """Whether the person has still to do it."""
        if self._question is not None and not self._question.open():
            self._question, self._value = None, self._asked
        return self._question is not None

    def value(self) -> Value:
        """The value last confirmed.

        Raises:
            DeviceError: none was.
        """
        if self._value is None:
            raise DeviceError(
                f"{self._step.format('...')}: not confirmed yet, so its value is not known; do it"
                " and confirm it first"
            )
        return self._value

    def fault(self) -> str:
        """None: the person is believed."""
        return ""

    def stop(self) -> None:
        """Ask no longer."""
        if self._question is not None:
            self._question.withdraw()
            self._question = None

    def identity(self) -> str:
        """What it is."""
        return "set by hand"

    def close(self) -> None:
        """Ask no longer."""
        self.stop()


def open_axis(name: str, axis: AxisDescription, keys: ManualAxisKeys, share: Share) -> ManualAxis:
    """A stage moved by hand; all manual devices share the terminal.

    What shifts homes to the limit towards which it homes, as the rule of the gap has it; what turns
    to 0, or the limit nearest to it.
    """
    low, high = axis.limits
    home = (
        (high if axis.homes_up else low) if axis.coordinate is LENGTH else min(max(0.0, low), high)
    )
    return ManualAxis(name, axis.limits, share("terminal", Terminal), axis.coordinate, home)


def stop_axis(
    name: str, axis: AxisDescription, keys: ManualAxisKeys, share: Share
) -> Callable[[], bool]:
    """Nothing: who is not asked any more moves nothing."""
    return lambda: False


def open_iris(address: str, keys: ManualIrisKeys, share: Share) -> ManualSetting[float]:
    """An iris turned by hand."""
    return ManualSetting("set the iris to f/{}", keys.f_numbers, share("terminal", Terminal))


def open_target(address: str, keys: ManualTargetKeys, share: Share) -> ManualSetting[str]:
    """A target holder changed by hand."""
    return ManualSetting("put the target {} in place", keys.names, share("terminal", Terminal))

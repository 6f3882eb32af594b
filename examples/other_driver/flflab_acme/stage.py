"""The driver. The protocol is made up: one stage on a TCP port, one line for a question and one for
its answer, ``NN words:SS``, NN the question's number, SS the sum of the bytes before the colon.

    01 STATUS:..        01 OK 24000 homed busy - :..     counts, reference, motion, what went wrong
    02 MOVE -1200:..    02 OK:..                         by counts from where it stands
"""

import itertools
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from drivers.line import Line, stop_surely
from drivers.registry import AxisDriver, Share
from drivers.transport import LostError, Wire, open_tcp, show, tcp_place
from drivers.turns import Turns
from flflab.bench import LENGTH, AxisDescription
from flflab.description import Description
from flflab.errors import CommunicationError, DeviceError, NotHomedError

STOP_NUMBER = 99  # its answer is passed over by whoever reads
ANSWER = re.compile(rb"(\d\d) (OK|NO) ?(.*):([0-9A-F]{2})")
WRONG = {"stall": "it stalled", "switch": "it ran onto a limit switch", "stopped": "it was stopped"}


class Keys(Description):
    """The keys of such an axis in a bench file, beside those that every axis has."""

    counts_per_mm: Annotated[float, Field(gt=0)] = 2000.0
    timeout: Annotated[float, Field(gt=0)] = 0.5


@dataclass(frozen=True)
class Status:
    """All that the stage says of itself, of one instant."""

    counts: int
    homed: bool
    busy: bool
    wrong: tuple[str, ...]


class StageLine:
    """The line to one stage: one question at a time, a stop past whoever waits."""

    def __init__(self, address: str, timeout: float) -> None:
        self._line = Line(lambda: open_tcp(address))
        self._timeout = timeout
        self._turns, self._numbers = Turns(), itertools.cycle(range(STOP_NUMBER))
        self._in_step = True

    def ask(self, name: str, text: str, *, again: bool) -> str:
        """Ask once, or, where nothing moves by it, a second time when the answer is lost."""
        try:
            with self._turns.take():
                return self._exchange(name, text)
        except CommunicationError:
            if not again:
                raise
        with self._turns.take():
            return self._exchange(name, text)

    def status(self, name: str, *, again: bool = True) -> Status:
        """All that the stage says of itself."""
        words = self.ask(name, "STATUS", again=again).split()
        if len(words) != 4:
            raise CommunicationError(f"{name}: asked for its status, got {words}; check it")
        counts, homed, busy, wrong = words
        return Status(
            number_in(name, counts), homed == "homed", busy == "busy",
            () if wrong == "-" else tuple(wrong.split(",")),
        )  # fmt: skip

    def stop(self, name: str) -> None:
        """Write a stop at once and see that the stage listens."""
        message = encode(STOP_NUMBER, "STOP")
        stop_surely(self._line, name, message, lambda: self.status(name, again=False))

    def close(self) -> None:
        """Let go of it."""
        self._line.close()

    def _exchange(self, name: str, text: str) -> str:
        number, asked = next(self._numbers), f"{name}: asked {text!r}, "
        wire = self._line.get(asked)
        try:
            if not self._in_step:
                wire.drain()
            self._in_step = False
            wire.write(encode(number, text))
            accepted, words = self._answer_to(number, wire)
        except LostError as error:
            self._line.lose(wire)
            raise LostError(asked + str(error)) from error
        except CommunicationError as error:
            raise CommunicationError(asked + str(error)) from error
        self._in_step = True
        if not accepted:
            raise DeviceError(f"{asked}the stage refuses ({words}); look at it")
        return words

    def _answer_to(self, number: int, wire: Wire) -> tuple[bool, str]:
        """The answer of this number; answers of others come late, or are a stop's."""
        ends = time.monotonic() + self._timeout
        while (left := ends - time.monotonic()) > 0:
            line = wire.read_until(b"\n", left)
            found = ANSWER.fullmatch(line)
            if found is None or found[4] != total(line[: found.start(4) - 1]):
                raise CommunicationError(f"got {show(line)}, no answer of such a stage; check it")
            if int(found[1]) == number:
                return found[2] == b"OK", found[3].decode("ascii", "replace")
        raise CommunicationError(f"{wire.address}: no answer in time; check cable and power")


class Stage:
    """One stage; satisfies ``drivers.base.AxisCommands``, which says what each method promises."""

    measured = False

    def __init__(self, name: str, keys: Keys, line: StageLine, speed: float) -> None:
        self._name, self._keys, self._line = name, keys, line
        self.resolution = 1 / keys.counts_per_mm
        low, high = (number_in(name, end) for end in self._ask("LIMITS", again=True).split())
        self.travel = (low * self.resolution, high * self.resolution)
        self._ask(f"SPEED {round(speed * keys.counts_per_mm)}", again=True)

    def start_home(self) -> None:
        """Start to look for the reference."""
        self._ask("CLEAR", again=True)
        self._ask("HOME", again=False)

    def start_move(self, position: float) -> None:
        """Start towards a reading, mm."""
        self._ask("CLEAR", again=True)
        here = self._line.status(self._name)
        if not here.homed:
            raise NotHomedError(
                f"{self._name}: asked to move, but it has just lost its reference; home it,"
                " nothing moved"
            )
        # by how far, not where to: a stage that loses its counter now stays on the free way
        self._ask(f"MOVE {round(position * self._keys.counts_per_mm) - here.counts}", again=False)

    def position(self) -> float:
        """What it counts, mm, reference or not."""
        return self._line.status(self._name).counts * self.resolution

    def reading(self) -> float | None:
        """The reading, mm; None without a reference."""
        now = self._line.status(self._name)
        return now.counts * self.resolution if now.homed else None

    def is_busy(self) -> bool:
        """Whether it moves."""
        return self._line.status(self._name).busy

    def is_homed(self) -> bool:
        """Whether its counter means anything."""
        return self._line.status(self._name).homed

    def stop(self) -> None:
        """Stop now, past whoever waits."""
        self._line.stop(self._name)

    def faults(self) -> tuple[str, ...]:
        """Why the last motion did not end as asked."""
        return tuple(WRONG.get(word, word) for word in self._line.status(self._name).wrong)

    def warnings(self) -> tuple[str, ...]:
        """Everything it wants to be known."""
        now = self._line.status(self._name)
        lasting = () if now.homed else ("it has no reference",)
        return (*lasting, *(WRONG.get(word, word) for word in now.wrong))

    def identity(self) -> str:
        """Maker, model and serial number."""
        return f"ACME {self._ask('NAME', again=True)}"

    def serial(self) -> str:
        """Its serial number."""
        return self._ask("NAME", again=True).rpartition(" ")[2]

    def close(self) -> None:
        """Nothing: the line is closed by who opened it."""

    def _ask(self, text: str, *, again: bool) -> str:
        return self._line.ask(self._name, text, again=again)


def number_in(name: str, word: str) -> int:
    """A whole number that the stage said."""
    if not re.fullmatch(r"-?[0-9]{1,12}", word):
        raise CommunicationError(f"{name}: asked for a number, got {word!r}; check it")
    return int(word)


def total(body: bytes) -> bytes:
    """The sum of all bytes, two hexadecimal digits."""
    return b"%02X" % (sum(body) % 256)


def encode(number: int, text: str) -> bytes:
    """A question as it goes over the line."""
    body = b"%02d %s" % (number, text.encode("ascii"))
    return body + b":" + total(body) + b"\n"


def open_axis(name: str, axis: AxisDescription, keys: Keys, share: Share) -> Stage:
    """Open one axis; nothing moves."""
    line = share(axis.address, lambda: StageLine(axis.address, keys.timeout))
    return Stage(name, keys, line, axis.speed)


def stop_axis(name: str, axis: AxisDescription, keys: Keys, share: Share) -> Callable[[], bool]:
    """Stop one axis beside whoever drives it, and ask nothing of it before; what is returned tells
    whether it still moves.
    """
    line = share(axis.address, lambda: StageLine(axis.address, keys.timeout))
    line.stop(name)
    return lambda: line.status(name).busy


AXIS = AxisDriver("stage", "Keys", LENGTH, (), package="flflab_acme", spells=tcp_place)

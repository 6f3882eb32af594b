"""The grammar of docs/scpi-camera.md: lines, headers, parameters and the error queue, for any set
of instruments at one address.
"""

import itertools
import math
import re
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from sim.clock import Clock
from sim.faults import Faults

LONGEST = 1024  # bytes of a line
QUEUE = 16  # errors
TEXTS = {
    0: "No error", -101: "Invalid character", -104: "Data type error",
    -108: "Parameter not allowed", -109: "Missing parameter",
    -113: "Undefined header", -200: "Execution error", -213: "Init ignored",
    -214: "Trigger deadlock", -221: "Settings conflict",
    -222: "Data out of range", -223: "Too much data", -224: "Illegal parameter value",
    -230: "Data corrupt or stale",
    -350: "Queue overflow",
}  # fmt: skip
IDENTITY = "flflab,simulated bench,0,1"


class ScpiError(Exception):
    """A command that failed: SCPI's number, and what was asked and what is allowed."""

    def __init__(self, number: int, detail: str = "") -> None:
        """Keep both."""
        super().__init__(number, detail)
        self.number, self.detail = number, detail


class BlockError(ScpiError):
    """A failed ``FETC?``: it is answered all the same."""

    def __init__(self, number: int, detail: str, answer: bytes) -> None:
        """Keep what goes over the wire."""
        super().__init__(number, detail)
        self.answer = answer


Handler = Callable[[Sequence[str], threading.Event], str | bytes]


class Instrument(Protocol):
    """What stands behind an address; commands map a header such as ``LENS:FNUMber?`` to what it
    does and answers.
    """

    faults: Faults

    @property
    def failures(self) -> Sequence[str]:
        """Sentences for every slow operation that ended without arriving."""
        ...

    @property
    def commands(self) -> Mapping[str, Handler]:
        """The instrument's own headers."""
        ...

    def idle_at(self) -> float:
        """The instant from which nothing slow is under way, s."""
        ...

    def reset(self) -> None:
        """``*RST``."""
        ...

    def power_up(self) -> None:
        """Power was lost."""
        ...


class Address:
    """Instruments that share an address; every client has its own error queue."""

    def __init__(self, instruments: Sequence[Instrument], clock: Clock) -> None:
        """Join instruments; on a line without a command of any one's own the first one speaks."""
        self.instruments = list(instruments)
        self.clock = clock
        self.ended = threading.Event()
        self.handlers: dict[str, tuple[Handler, Instrument]] = {}
        for instrument in self.instruments:
            for pattern, handler in instrument.commands.items():
                self.handlers |= dict.fromkeys(spellings(pattern), (handler, instrument))

    def open_session(self) -> "Conversation":
        """A client's conversation."""
        return Conversation(self)

    def idle_at(self) -> float:
        """The instant from which nothing slow is under way at this address."""
        return max(instrument.idle_at() for instrument in self.instruments)


class Conversation:
    """One client: its unfinished line and its errors."""

    def __init__(self, address: Address) -> None:
        """Begin with an empty queue."""
        self._address = address
        self._heard = b""
        self._errors: deque[str] = deque()
        self._withheld: list[Instrument] = []
        self._told = [len(instrument.failures) for instrument in address.instruments]
        self._common: dict[str, Handler] = {}
        for pattern, handler in {
            "*IDN?": self._identity, "*RST": self._reset, "*CLS": self._clear,
            "*OPC?": self._complete,
            "SYSTem:BUSY?": self._busy, "SYSTem:ERRor?": self._error,
        }.items():  # fmt: skip
            self._common |= dict.fromkeys(spellings(pattern), handler)

    def receive(self, data: bytes) -> bytes:
        """Answer every complete line."""
        *lines, self._heard = (self._heard + data).split(b"\n")
        return b"".join(self._line(line.removesuffix(b"\r")) for line in lines)

    def unasked(self) -> bytes:
        """An answer that was held back."""
        return b"".join(instrument.faults.late_answer() for instrument in self._withheld)

    def _line(self, line: bytes) -> bytes:
        if len(line) > LONGEST:
            self._queue(-223, f"{len(line)} bytes, allowed {LONGEST}")
            return b""
        if any(not 0x20 <= byte < 0x7F for byte in line):
            self._queue(-101, "printable ASCII is allowed")
            return b""
        commands = [
            command
            for part in split(line.decode("ascii"), ";")
            if (command := part.strip().removeprefix(":"))
        ]
        if len(commands) > 1 and any(
            command.upper() in spellings("FETCh?") for command in commands
        ):
            self._queue(-221, "FETC? must be alone on its line")
            return b""
        owners = [
            owner for command in commands if (owner := self._owner(command))
        ] or self._address.instruments[:1]
        speakers = list({id(owner): owner for owner in owners}.values()) if commands else []
        for speaker in speakers:
            speaker.faults.before(speaker)
        answers = [answer for command in commands if (answer := self._do(command)) is not None]
        whole: bytes | None = b";".join(answers) + b"\n" if answers else b""
        for speaker in speakers:
            due, whole = whole, speaker.faults.reply(whole) if whole else whole
            if due and not whole:
                self._withheld = [speaker]
        return whole or b""

    def _owner(self, command: str) -> Instrument | None:
        """Whose command it is; None for those of all instruments, which speak for whoever else is
        on the line.
        """
        _, owner = self._address.handlers.get(command.partition(" ")[0].upper(), (None, None))
        return owner

    def _do(self, command: str) -> bytes | None:
        """One command: its answer, or None."""
        for place, instrument in enumerate(self._address.instruments):
            for failure in instrument.failures[self._told[place] :]:
                self._queue(-200, failure)
            self._told[place] = len(instrument.failures)
        header, _, rest = command.partition(" ")
        parameters = [word.strip() for word in split(rest, ",")] if rest.strip() else []
        name = header.upper()
        handler, _ = self._address.handlers.get(name, (self._common.get(name), None))
        if handler is None:
            self._queue(-113, header)
            return None
        try:
            answer = handler(parameters, self._address.ended)
        except BlockError as error:
            self._queue(error.number, error.detail)
            return error.answer
        except ScpiError as error:
            self._queue(error.number, error.detail or command)
            return None
        return (
            (answer if isinstance(answer, bytes) else answer.encode("ascii"))
            if header.endswith("?")
            else None
        )

    def _queue(self, number: int, detail: str) -> None:
        if len(self._errors) < QUEUE:
            text = f"{TEXTS[number]};{detail}".replace('"', "'")
            self._errors.append(f'{number},"{text}"')
        else:
            self._errors[-1] = f'-350,"{TEXTS[-350]}"'

    def _identity(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return IDENTITY

    def _reset(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        for instrument in self._address.instruments:
            instrument.reset()
        return ""

    def _clear(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        self._errors.clear()
        return ""

    def _complete(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        while (instant := self._address.idle_at()) > self._address.clock.now():
            if not self._address.clock.wait_until(instant, ended):
                break
        return "1"

    def _busy(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return str(int(self._address.idle_at() > self._address.clock.now()))

    def _error(self, parameters: Sequence[str], ended: threading.Event) -> str:
        no_parameters(parameters)
        return self._errors.popleft() if self._errors else f'0,"{TEXTS[0]}"'


def spellings(pattern: str) -> list[str]:
    """Every spelling in capitals of a header such as ``SENSor:SIZE?``: each word short or long."""
    words = pattern.rstrip("?").split(":")
    choices = [sorted({re.sub("[a-z]", "", word), word.upper()}) for word in words]
    return [
        ":".join(spelling) + ("?" if pattern.endswith("?") else "")
        for spelling in itertools.product(*choices)
    ]


def split(text: str, separator: str) -> list[str]:
    """Split at a separator that is not inside double quotes."""
    parts, quoted = [""], False
    for character in text:
        quoted ^= character == '"'
        if character == separator and not quoted:
            parts.append("")
        else:
            parts[-1] += character
    return parts


def no_parameters(parameters: Sequence[str]) -> None:
    """Refuse any parameter."""
    if parameters:
        raise ScpiError(-108, f"{','.join(parameters)}; none is allowed")


def one_parameter(parameters: Sequence[str]) -> str:
    """The only parameter."""
    if not parameters:
        raise ScpiError(-109, "one parameter is due")
    no_parameters(parameters[1:])
    return parameters[0]


def number_within(parameters: Sequence[str], name: str, low: float, high: float) -> float:
    """The only parameter as a number within limits."""
    word = one_parameter(parameters)
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ScpiError(-104, f"{name} {word}, a number is due")
    if not low <= number <= high:
        raise ScpiError(-222, f"{name} {word}, allowed {low:g} to {high:g}")
    return number


def name_among(parameters: Sequence[str], what: str, names: Sequence[str]) -> str:
    """The only parameter as one of some names, quoted or not."""
    word = one_parameter(parameters)
    name = word[1:-1].replace('""', '"') if len(word) > 1 and word[0] == word[-1] == '"' else word
    if name not in names:
        raise ScpiError(-224, f"{what} {name}, allowed {' '.join(names)}")
    return name


def limits_or(parameters: Sequence[str], present: float, low: float, high: float) -> str:
    """The answer to ``HEADER?``, ``HEADER? MINimum`` or ``HEADER? MAXimum``."""
    if not parameters:
        return decimal(present)
    word = one_parameter(parameters).upper()
    chosen = {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high}.get(word)
    if chosen is None:
        raise ScpiError(-224, f"{word}, allowed MINimum MAXimum")
    return decimal(chosen)


def decimal(number: float) -> str:
    """The shortest decimal that reads back to the same double; a whole number without a point."""
    return repr(float(number)).removesuffix(".0")

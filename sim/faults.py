"""Faults that an instrument shows on purpose, by name, from a given command on."""

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from flflab.errors import InputError
from sim.server import HangUpError

KINDS = {
    "silence": "answers nothing any more",
    "unheard": "does not hear one command",
    "drop": "loses one answer",
    "garbage": "answers bytes that mean nothing",
    "cut": "answers half a line without its end",
    "lost-byte": "loses one byte of one answer",
    "doubled-byte": "gives one byte of one answer twice",
    "double": "gives one answer twice",
    "late": "gives one answer LATE_S after it was due",
    "flip": "flips one bit of one answer",
    "wrong-checksum": "answers with a checksum that is one off",
    "stranger": "gives one answer in the name of a device that was not asked",
    "deaf": "acknowledges one motion and does not make it",
    "hang-up": "closes the line",
    "unplug": "is pulled out once, and put back AWAY_S later",
    "reset": "loses power once: settings and reference are gone",
    "stall": "is stuck once, JAM further on its way",
    "limit-switch": "runs onto a limit switch once, JAM further on its way",
    "lost-frame": "loses one frame",
}
LATE_S = 0.7  # real seconds
AWAY_S = 0.3  # real seconds
# mm or degrees of travel (f-numbers of an iris, places of a wheel) that what is stuck still makes
JAM = 0.5
Spoil = Callable[[bytes], bytes]


@dataclass(frozen=True)
class Fault:
    """One kind of fault, shown from the command after the first ``after`` ones."""

    kind: str
    after: int = 0


class Drive(Protocol):
    """What can lose power."""

    def power_up(self) -> None:
        """Start again."""
        ...


class Faults:
    """The faults of one instrument and how many commands it has heard."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        """Arm faults.

        Raises:
            InputError: there is no fault of that name.
        """
        self._faults = list(faults)  # each shown once, or from its time on
        self.shown: list[str] = []
        self._heard = 0
        self._late: tuple[float, bytes] | None = None
        self._shown: set[Fault] = set()
        self._lock = threading.Lock()
        for fault in self._faults:
            _require_known(fault.kind)

    def plant(self, kind: str, after: int = 0) -> None:
        """Arm one more fault, to be shown so many commands from now.

        Raises:
            InputError: there is no fault of that name.
        """
        _require_known(kind)
        with self._lock:
            self._faults.append(Fault(kind, self._heard + after))

    def clear(self) -> None:
        """No fault is shown any more."""
        with self._lock:
            self._faults.clear()
            self._late = None

    def before(self, drive: Drive) -> bool:
        """Count a command; reset the drive where its time has come. False where the command is not
        heard.
        """
        with self._lock:
            self._heard += 1
        if self._first("reset"):
            drive.power_up()
        return not self._first("unheard")

    def obstacle(self) -> str:
        """What the motion that starts now runs onto: FS where it gets stuck, WL for a limit switch,
        empty for nothing.
        """
        return "FS" if self._first("stall") else "WL" if self._first("limit-switch") else ""

    def reply(
        self, answer: bytes, one_off: Spoil | None = None, stranger: Spoil | None = None
    ) -> bytes | None:
        """What goes over the wire instead of an answer; None for nothing.

        Args:
            answer: what is due.
            one_off: makes its checksum wrong; by default two hex digits after a colon.
            stranger: puts another device's name to it.

        Raises:
            HangUpError: the line is to be closed.
        """
        if self._first("unplug"):
            raise HangUpError(AWAY_S)
        if self._due("hang-up"):
            raise HangUpError
        if self._due("silence") or self._first("drop"):
            return None
        if self._first("late"):
            self._late = (time.monotonic() + LATE_S, answer)
            return None
        if self._first("double"):
            return answer + answer
        place = len(answer) // 2
        if self._first("flip"):
            return answer[:place] + bytes((answer[place] ^ 0x04,)) + answer[place + 1 :]
        if self._first("lost-byte"):
            return answer[:place] + answer[place + 1 :]
        if self._first("doubled-byte"):
            return answer[: place + 1] + answer[place:]
        if stranger is not None and self._first("stranger"):
            return stranger(answer)
        if self._due("garbage"):
            return b"\x7fK#?\xfe@@!\r\n"
        if self._due("cut"):
            return answer[: len(answer) // 2]
        if self._due("wrong-checksum"):
            return (one_off or one_off_hex)(answer)
        return answer

    def late_answer(self) -> bytes:
        """The answer that was held back, once its time has come."""
        with self._lock:
            if self._late is None or time.monotonic() < self._late[0]:
                return b""
            answer, self._late = self._late[1], None
        return answer

    def ignores_motion(self) -> bool:
        """Whether the motion just asked for is not made."""
        return self._first("deaf")

    def loses_frame(self) -> bool:
        """Whether the frame that ends now is lost."""
        return self._first("lost-frame")

    def _due(self, kind: str) -> bool:
        """Whether the time of a fault of a kind has come."""
        self._first(kind)
        return any(fault.kind == kind and self._heard > fault.after for fault in self._faults)

    def _first(self, kind: str) -> bool:
        """True once for each fault of a kind whose time has come."""
        if not self._faults:
            return False
        with self._lock:
            due = [
                fault
                for fault in self._faults
                if fault.kind == kind and self._heard > fault.after and fault not in self._shown
            ]
            self._shown.update(due)
            self.shown += [fault.kind for fault in due]
        return bool(due)


def _require_known(kind: str) -> None:
    if kind not in KINDS:
        raise InputError(f"simulated fault '{kind}' is not known; allowed: {', '.join(KINDS)}")


def one_off_hex(answer: bytes) -> bytes:
    """The line with a checksum that does not fit."""
    body = answer.rstrip(b"\r\n")
    if body[-3:-2] == b":":
        body = body[:-3]
    return body + b":%02X\r\n" % ((1 - sum(body[1:])) % 256)

"""A simulated chain of single-axis Zaber devices that speak the ASCII protocol.

From Zaber's ASCII protocol manual: messages ``/[device [axis]] [id] command[:CC]``, replies ``@DD A
[id] OK|RJ BUSY|IDLE WF data``, alerts ``!DD A IDLE WF``; device 0 is everyone; a message with a bad
checksum is ignored. Not confirmed by a source at hand: that ``stop`` raises NI, that a stage
without a reference takes ``move abs``, and what ``estop`` leaves behind (here: a stage at rest,
still enabled).
"""

import re
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sim.faults import JAM, Faults
from sim.stage import RefusedError, Stage
from sim.zaber_settings import ACCELERATION, SETTINGS, SPEED, TOP_SPEED, Communication, whole

LONGEST = 256  # bytes of a message that is listened to
PRIORITY = ("FF", "FO", "FS", "FE", "WL", "WR", "WH", "NC", "NI")
DEVICE_SCOPE = ("renumber", "system")
_MESSAGE = re.compile(r"/\s*(?:(\d+)(?:\s+(\d+)(?:\s+(\d+|--))?)?)?(?:\s+|$)(.*)", re.DOTALL)


def checksum(body: bytes) -> bytes:
    """Two upper-case hex digits that make the sum of all bytes 0 modulo 256; ``body`` is without
    the first character.
    """
    return b"%02X" % (-sum(body) % 256)


@dataclass(frozen=True)
class Message:
    """One command as it was understood."""

    device: int
    axis: int
    number: str
    words: tuple[str, ...]
    signed: bool


def read_message(line: bytes) -> Message | None:
    """Understand a line without its end; None where a device would not listen.

    A first word that is not a number belongs to the command: ``/home`` goes to everyone.
    """
    if not line.startswith(b"/") or len(line) > LONGEST or not line.isascii():
        return None
    signed = re.search(rb":([0-9A-Fa-f]{2})\s*$", line)
    if signed:
        if signed[1].upper() != checksum(line[1 : signed.start()]):
            return None
        line = line[: signed.start()]
    found = _MESSAGE.fullmatch(line.decode("ascii")) or re.fullmatch(
        r"/()()()(.*)", line.decode("ascii"), re.DOTALL
    )
    if not found:
        return None
    device, axis, number, command = found.groups()
    return Message(
        int(device or 0), int(axis or 0), number or "", tuple(command.split()), bool(signed)
    )


class Device:
    """One controller with its stage; answers messages that are for it."""

    def __init__(self, number: int, stage: Stage, faults: Faults, serial: int) -> None:
        """Power up under a device number."""
        self.line = Communication(number, serial)
        self.stage = stage
        self.faults = faults
        stage.obstruct(faults.obstacle, JAM)
        self._was_busy = False

    def answer(self, message: Message) -> bytes | None:
        """Do a command and answer it; None where a fault keeps the device silent."""
        if not self.faults.before(self.stage):
            return None
        verdict, data = "OK", "0"
        try:
            data = self._do(message)
        except RefusedError as refusal:
            verdict, data = "RJ", str(refusal)
        self._was_busy = self._was_busy or self.stage.busy()
        number = f" {message.number}" if message.number else ""
        reply = f"{self.line.number:02d} {message.axis}{number} {verdict} {self._status()} {data}"
        if message.words[:2] == ("system", "reset") and verdict == "OK":
            self.stage.power_up()
        silent = message.number == "--"
        return (
            None
            if silent
            else self.faults.reply(self._sealed(b"@", reply, message.signed), stranger=_strangers)
        )

    def alert(self) -> bytes:
        """The alert for a motion that has ended since the last look, where alerts are on."""
        if not self._was_busy or self.stage.busy():
            return b""
        self._was_busy = False
        if not self.line.alert:
            return b""
        return self._sealed(b"!", f"{self.line.number:02d} 1 {self._status()}", False)

    def _sealed(self, kind: bytes, text: str, signed: bool) -> bytes:
        body = text.encode("ascii")
        return (
            kind + body + (b":" + checksum(body) if signed or self.line.checksum else b"") + b"\r\n"
        )

    def _status(self) -> str:
        flags = self._flags()
        return f"{'BUSY' if self.stage.busy() else 'IDLE'} {flags[0] if flags else '--'}"

    def _flags(self) -> list[str]:
        return sorted(
            self.stage.flags(),
            key=lambda flag: PRIORITY.index(flag) if flag in PRIORITY else len(PRIORITY),
        )

    def _do(self, message: Message) -> str:
        """Carry out a command; the data of the reply."""
        if message.number not in ("", "--") and len(message.number) > 2:
            raise RefusedError("BADMESSAGEID")
        if message.axis > 1:
            raise RefusedError("BADAXIS")
        if not message.words:
            return "0"
        command, *rest = message.words
        if command in DEVICE_SCOPE and message.axis:
            raise RefusedError("DEVICEONLY")
        if command in ("get", "set"):
            return self._setting(command, rest, message.axis)
        doing: dict[str, Callable[[Sequence[str]], str]] = {
            "home": self._home, "move": self._move, "stop": self._stop, "estop": self._estop,
            "warnings": self._warnings,
            "renumber": self._renumber, "system": self._system, "tools": self._tools,
            "driver": self._driver,
        }  # fmt: skip
        if command not in doing:
            raise RefusedError("BADCOMMAND")
        return doing[command](rest)

    def _setting(self, command: str, words: Sequence[str], axis: int) -> str:
        setting = SETTINGS.get(words[0]) if words else None
        if setting is None or len(words) != (1 if command == "get" else 2):
            raise RefusedError("BADCOMMAND")
        if axis and not setting.axis:
            raise RefusedError("DEVICEONLY")
        if command == "get":
            return setting.read(self.line, self.stage)
        if setting.write is None:
            raise RefusedError("BADCOMMAND")
        setting.write(self.line, self.stage, words[1])
        return "0"

    def _home(self, words: Sequence[str]) -> str:
        _nothing_after(words)
        self.stage.home()
        return "0"

    def _move(self, words: Sequence[str]) -> str:
        kind, *numbers = words or [""]
        counts = {"abs": (1, 3), "rel": (1, 3), "vel": (1, 2), "min": (0, 2), "max": (0, 2)}
        if kind not in counts:
            raise RefusedError("BADCOMMAND")
        if not counts[kind][0] <= len(numbers) <= counts[kind][1]:
            raise RefusedError("BADDATA")
        if kind == "vel":
            velocity = whole(numbers[0], -TOP_SPEED, TOP_SPEED) / SPEED
            self.stage.run(velocity, _acceleration(numbers[1:]))
            return "0"
        count = whole(numbers[0], -(10**9), 10**9) if kind in ("abs", "rel") else 0
        limits = numbers[1:] if kind in ("abs", "rel") else numbers
        target = {
            "abs": count,
            "rel": self.stage.position() + count,
            "min": self.stage.lower,
            "max": self.stage.upper,
        }[kind]
        speed = whole(limits[0], 1, TOP_SPEED) / SPEED if limits else None
        self.stage.move_to(target, speed, _acceleration(limits[1:]))
        return "0"

    def _stop(self, words: Sequence[str]) -> str:
        _nothing_after(words)
        self.stage.stop()
        return "0"

    def _estop(self, words: Sequence[str]) -> str:
        _nothing_after(words)
        self.stage.halt()
        return "0"

    def _warnings(self, words: Sequence[str]) -> str:
        if list(words) not in ([], ["clear"]):
            raise RefusedError("BADCOMMAND")
        flags = self._flags()
        if words:
            self.stage.raised.clear()
        return " ".join([f"{len(flags):02d}", *flags])

    def _renumber(self, words: Sequence[str]) -> str:
        self.line.number = whole(words[0] if len(words) == 1 else "", 1, 99)
        return "0"

    def _system(self, words: Sequence[str]) -> str:
        if list(words) not in (["reset"], ["restore"]):
            raise RefusedError("BADCOMMAND")
        if words[0] == "restore":
            self.line.alert = self.line.checksum = False
        return "0"

    def _tools(self, words: Sequence[str]) -> str:
        if words[:1] == ["echo"]:
            return " ".join(words[1:]) or "0"
        if list(words) not in (["parking", "park"], ["parking", "unpark"]):
            raise RefusedError("BADCOMMAND")
        if self.stage.busy():
            raise RefusedError("STATUSBUSY")
        self.stage.parked = words[1] == "park"
        return "0"

    def _driver(self, words: Sequence[str]) -> str:
        if list(words) not in (["enable"], ["disable"]):
            raise RefusedError("BADCOMMAND")
        self.stage.halt()
        self.stage.enabled = words[0] == "enable"
        return "0"


def _strangers(reply: bytes) -> bytes:
    """The reply in the name of device 77."""
    body = b"77" + reply[3:].rstrip(b"\r\n").partition(b":")[0]
    return b"@" + body + (b":" + checksum(body) if b":" in reply else b"") + b"\r\n"


def _nothing_after(words: Sequence[str]) -> None:
    if words:
        raise RefusedError("BADDATA")


def _acceleration(words: Sequence[str]) -> float | None:
    return whole(words[0], 0, 2**31 - 1) / ACCELERATION if words else None


class Chain:
    """Devices one after the other on one line; every client of the line hears the replies to its
    own messages and all alerts.
    """

    def __init__(self, devices: Sequence[Device], lock: threading.RLock) -> None:
        """Join devices; ``lock`` is the world's."""
        self.devices = list(devices)
        self.lock = lock

    def open_session(self) -> "ChainSession":
        """A client's conversation."""
        return ChainSession(self)

    def answer(self, line: bytes) -> bytes:
        """The replies of all devices that a line concerns, in the order of the chain."""
        message = read_message(line)
        if message is None:
            return b""
        if message.words == ("renumber",) and message.device == 0 and message.axis == 0:
            for place, device in enumerate(self.devices, start=1):
                device.line.number = place
            message = Message(0, 0, message.number, (), message.signed)
        concerned = [device for device in self.devices if message.device in (0, device.line.number)]
        return b"".join(
            reply for device in concerned if (reply := device.answer(message)) is not None
        )


class ChainSession:
    """Cuts a client's bytes into lines."""

    def __init__(self, chain: Chain) -> None:
        """Begin with nothing heard."""
        self._chain = chain
        self._heard = bytearray()

    def receive(self, data: bytes) -> bytes:
        """Answer every complete line; backspace takes back a character, DEL the line."""
        answers: list[bytes] = []
        for byte in data:
            if byte in b"\r\n":
                line, self._heard = bytes(self._heard), bytearray()
                with self._chain.lock:
                    answers.append(self._chain.answer(line))
            elif byte == 0x7F:
                self._heard.clear()
            elif byte == 0x08:
                del self._heard[-1:]
            else:
                self._heard.append(byte)
        return b"".join(answers)

    def unasked(self) -> bytes:
        """Alerts of motions that have ended, and answers that come late."""
        with self._chain.lock:
            return b"".join(
                device.faults.late_answer() + device.alert() for device in self._chain.devices
            )

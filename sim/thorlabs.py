"""A simulated KDC101 controller with a PRM1-Z8 rotation stage that speaks the APT protocol.

From Thorlabs' "Host-Controller Communications Protocol": six-byte messages, data after those with
bit 7 of the destination set, no checksum and no acknowledgement; ends of motion are told unasked.
Start-up values as the maker's software sends them for a PRM1-Z8. What the protocol calls forward
(0x0457 with 1, status bit 4) lowers the counts, as public clients of TDC001 and KDC101 have it. Not
confirmed from the manual: what becomes of a move without a reference (here: it is done, counted
from where the motor was switched on) and of a message of unknown id (here: nothing). The backlash
correction is kept as a number and not made.
"""

import math
import struct
import threading
from collections.abc import Callable

from sim.faults import JAM, Faults
from sim.stage import Stage

HOST, CONTROLLER, WITH_DATA = 0x01, 0x50, 0x80
COUNTS_PER_DEGREE = 1919.6418578623391  # of a PRM1-Z8
COUNT = math.pi / 180 / COUNTS_PER_DEGREE  # rad
SERVO = 2048 / 6e6  # s
SPEED = SERVO * 65536  # setting for one count/s
ACCELERATION = SERVO**2 * 65536  # setting for one count/s^2
TOP_SPEED, TOP_ACCELERATION = 25.0, 50.0  # degrees/s, degrees/s^2
PRM1_Z8 = 6  # the stage's number in the controller's own list
LONGEST = 255
BACKLASH, JOG, HOME_PARAMETERS, LIMIT_SWITCHES = "<Hl", "<HHllllH", "<HHHll", "<HHHllH"
PANEL, TRIGGERS, POSITION_TRIGGERS = "<HHllHll3H", "<6H", "<H8l"  # of a K-cube alone


def encode(message_id: int, data: bytes = b"", first: int = 0, second: int = 0) -> bytes:
    """A message from the controller to the host."""
    if data:
        return struct.pack("<HHBB", message_id, len(data), HOST | WITH_DATA, CONTROLLER) + data
    return struct.pack("<HBBBB", message_id, first, second, HOST, CONTROLLER)


class Controller:
    """One controller with its stage: what it answers to each message, and what it tells unasked."""

    def __init__(self, stage: Stage, faults: Faults, serial: int, lock: threading.RLock) -> None:
        """Power up; ``lock`` is the world's."""
        self.stage, self.faults, self.lock = stage, faults, lock
        self.serial = serial
        stage.obstruct(faults.obstacle, math.radians(JAM))
        self._doing: dict[int, Callable[[bytes], bytes]] = {
            0x0005: self._info, 0x0210: self._enable, 0x0211: self._enabled,
            0x0410: self._set_counter, 0x0411: self._counter,
            0x040A: self._encoder, 0x0413: self._set_speed, 0x0414: self._speed, 0x0429: self._bits,
            0x0443: self._home,
            0x0448: self._move_by, 0x0453: self._move_to, 0x0457: self._run, 0x0465: self._stop,
            0x0480: self._stepper_status,
            0x0490: self._status, 0x046B: self._suspend, 0x046C: self._resume,
            **self._kept("backlash", 0x043A), **self._kept("jog", 0x0416),
            **self._kept("home", 0x0440),
            **self._kept("limit switches", 0x0423), **self._kept("panel", 0x0520),
            **self._kept("triggers", 0x0523), **self._kept("position triggers", 0x0526),
        }  # fmt: skip
        self.power_up()

    def power_up(self) -> None:
        """Start-up settings, no reference."""
        self.stage.power_up()
        self._parameters = {
            "backlash": struct.pack(BACKLASH, 1, round(COUNTS_PER_DEGREE)),
            "jog": struct.pack(JOG, 1, 2, _counts(5), 0, _acceleration(15), _speed(15), 2),
            "home": struct.pack(HOME_PARAMETERS, 1, 2, 1, _speed(10), _counts(4)),
            "limit switches": struct.pack(LIMIT_SWITCHES, 1, 4, 1, 1920, 1920, 1),
            "panel": struct.pack(
                PANEL, 1, 1, _speed(10), _acceleration(10), 1, _counts(0), _counts(10), 60, 5, 2
            ),
            "triggers": struct.pack(TRIGGERS, 1, 0, 1, 0, 1, 0),
            "position triggers": struct.pack(
                POSITION_TRIGGERS, 1, 0, _counts(1), 1, 0, _counts(1), 1, 50_000, 1
            ),
        }
        self._tells_ends = True
        self._ending = 0

    def answer(self, message: bytes) -> bytes | None:
        """Do a command; None where nothing is answered."""
        if not self.faults.before(self):
            return None
        doing = self._doing.get(int.from_bytes(message[:2], "little"))
        answer = doing(message) if doing and len(message) >= 6 else b""
        return self.faults.reply(answer, stranger=_strangers) if answer else None

    def unasked(self) -> bytes:
        """The end of a motion since the last look."""
        if not self._ending or self.stage.busy():
            return b""
        ended, self._ending = self._ending, 0
        if not self._tells_ends:
            return b""
        return encode(ended, first=1) if ended == 0x0444 else encode(ended, self._state())

    def _kept(self, name: str, set_id: int) -> dict[int, Callable[[bytes], bytes]]:
        """Parameters that are set, asked for with the next id, and answered with the one after."""

        def keep(message: bytes) -> bytes:
            if len(message) - 6 == len(self._parameters[name]):
                self._parameters[name] = message[6:]
            return b""

        return {
            set_id: keep,
            set_id + 1: lambda message: encode(set_id + 2, self._parameters[name]),
        }

    def _info(self, message: bytes) -> bytes:
        notes = b"simulated KDC101"
        data = struct.pack(
            "<L8sHBBBx48s10xHHHH", self.serial, b"KDC101", 44, 9, 0, 2, notes, PRM1_Z8, 1, 0, 1
        )
        return encode(0x0006, data)

    def _enable(self, message: bytes) -> bytes:
        self.stage.enabled = message[3] == 1
        if not self.stage.enabled:
            self.stage.halt()
        return b""

    def _enabled(self, message: bytes) -> bytes:
        return encode(0x0212, first=1, second=1 if self.stage.enabled else 2)

    def _counter(self, message: bytes) -> bytes:
        return encode(0x0412, struct.pack("<Hl", 1, self.stage.position()))

    def _encoder(self, message: bytes) -> bytes:
        return encode(0x040B, struct.pack("<Hl", 1, self.stage.position()))

    def _set_counter(self, message: bytes) -> bytes:
        if len(message) == 12 and not self.stage.busy():
            self.stage.set_position(struct.unpack("<Hl", message[6:])[1])
        return b""

    def _set_speed(self, message: bytes) -> bytes:
        if len(message) == 20:
            _, _, acceleration, speed = struct.unpack("<Hlll", message[6:])
            self.stage.speed = min(max(speed, 1) / SPEED, TOP_SPEED * COUNTS_PER_DEGREE)
            self.stage.acceleration = min(
                max(acceleration, 1) / ACCELERATION, TOP_ACCELERATION * COUNTS_PER_DEGREE
            )
        return b""

    def _speed(self, message: bytes) -> bytes:
        settings = (round(self.stage.acceleration * ACCELERATION), round(self.stage.speed * SPEED))
        return encode(0x0415, struct.pack("<Hlll", 1, 0, *settings))

    def _home(self, message: bytes) -> bytes:
        if self.stage.enabled:
            self.stage.raised.clear()
            self.stage.home()
            self._ending = 0x0444
        return b""

    def _move_to(self, message: bytes) -> bytes:
        if len(message) == 12:
            self._go(struct.unpack("<Hl", message[6:])[1])
        return b""

    def _move_by(self, message: bytes) -> bytes:
        if len(message) == 12:
            self._go(self.stage.position() + struct.unpack("<Hl", message[6:])[1])
        return b""

    def _run(self, message: bytes) -> bytes:
        self._go(self.stage.lower if message[3] == 1 else self.stage.upper)
        return b""

    def _go(self, counts: int) -> None:
        """Move; what is out of the counter's range, or asked of a motor that is off, is passed over
        in silence.
        """
        if self.stage.enabled and self.stage.lower <= counts <= self.stage.upper:
            self.stage.raised.clear()
            self.stage.move_to(counts)
            self._ending = 0x0464

    def _stop(self, message: bytes) -> bytes:
        if self.stage.busy():
            if message[3] == 1:
                self.stage.halt()
            else:
                self.stage.stop()
            self._ending = 0x0466
        return b""

    def _status(self, message: bytes) -> bytes:
        return encode(0x0491, self._state())

    def _stepper_status(self, message: bytes) -> bytes:
        counts = self.stage.position()
        return encode(0x0481, struct.pack("<HllL", 1, counts, counts, self._status_bits()))

    def _bits(self, message: bytes) -> bytes:
        return encode(0x042A, struct.pack("<HL", 1, self._status_bits()))

    def _suspend(self, message: bytes) -> bytes:
        self._tells_ends = False
        return b""

    def _resume(self, message: bytes) -> bytes:
        self._tells_ends = True
        return b""

    def _state(self) -> bytes:
        velocity = max(-32768, min(32767, round(self.stage.velocity() * SERVO)))
        return struct.pack("<HlhHL", 1, self.stage.position(), velocity, 0, self._status_bits())

    def _status_bits(self) -> int:
        """Bits 0 on a switch, 4 moving to lower counts and 5 to higher ones, 8 connected, 9
        homing, 10 homed, 13 settled, 14 motion error, 31 enabled.
        """
        flags, velocity = self.stage.flags(), self.stage.velocity()
        busy = self.stage.busy()
        bits = {
            0: "WL" in flags,
            4: busy and velocity < 0, 5: busy and velocity >= 0, 8: True, 9: self.stage.homing(),
            10: self.stage.reference == "homed",
            13: not busy, 14: "FS" in flags, 31: self.stage.enabled,
        }  # fmt: skip
        return sum(1 << bit for bit, on in bits.items() if on)


def _strangers(answer: bytes) -> bytes:
    """The answer to another computer."""
    return answer[:4] + bytes((answer[4] ^ 0x02,)) + answer[5:]


def _counts(degrees: float) -> int:
    return round(degrees * COUNTS_PER_DEGREE)


def _speed(degrees_per_second: float) -> int:
    return round(degrees_per_second * COUNTS_PER_DEGREE * SPEED)


def _acceleration(degrees_per_second_squared: float) -> int:
    return round(degrees_per_second_squared * COUNTS_PER_DEGREE * ACCELERATION)


class ControllerSession:
    """Cuts a client's bytes into messages; bytes that begin none are passed over one by one."""

    def __init__(self, controller: Controller) -> None:
        """Begin with nothing heard."""
        self._controller = controller
        self._heard = bytearray()

    def receive(self, data: bytes) -> bytes:
        """Answer every complete message."""
        self._heard += data
        answers: list[bytes] = []
        while len(self._heard) >= 6:
            length = int.from_bytes(self._heard[2:4], "little") if self._heard[4] & WITH_DATA else 0
            if (
                self._heard[4] & ~WITH_DATA not in (CONTROLLER, 0x11, 0x21)
                or self._heard[5] != HOST
                or length > LONGEST
            ):
                del self._heard[0]
                continue
            if len(self._heard) < 6 + length:
                break
            message = bytes(self._heard[: 6 + length])
            del self._heard[: 6 + length]
            with self._controller.lock:
                answers.append(self._controller.answer(message) or b"")
        return b"".join(answers)

    def unasked(self) -> bytes:
        """Ends of motions, and answers that come late."""
        with self._controller.lock:
            return self._controller.faults.late_answer() + self._controller.unasked()

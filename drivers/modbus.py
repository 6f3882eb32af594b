"""Modbus RTU on a line that several drives share, by pymodbus: one exchange at a time, 32-bit
values in pairs of registers.
"""

import itertools
import logging
import select
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from pymodbus import FramerType, ModbusException
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from drivers.forked import close_in_children
from drivers.line import Line
from drivers.transport import open_port, serial_place
from drivers.turns import Turns
from flflab.errors import CommunicationError, DeviceError

EXCEPTIONS = {
    1: "function not known",
    2: "no such register",
    3: "impossible value",
    4: "it cannot do this now",
}

READ, WRITE = 0x03, 0x10
MONITORS, MARKS = 0x00C6, range(3, 13)  # values in a row, of which no other question has so many
MOST_LATE = 4  # answers to earlier questions

LOG = logging.getLogger(__name__)
logging.getLogger("pymodbus").addHandler(
    logging.NullHandler()
)  # what no handler takes Python prints, beside our own sentence

Client: TypeAlias = ModbusSerialClient | ModbusTcpClient


def to_words(values: Sequence[int]) -> list[int]:
    """Signed 32-bit values as registers, the upper word first."""
    return [word for value in values for word in ((value >> 16) & 0xFFFF, value & 0xFFFF)]


def from_words(upper: int, lower: int) -> int:
    """The signed 32-bit value of two registers."""
    value = upper << 16 | lower
    return value - (1 << 32) if value >> 31 else value


class ModbusLine:
    """An RS-485 line that several drives share: one exchange at a time; a stop goes before all
    others that wait.

    An answer carries no number, and a late one must not pass for the next. So after a failed
    exchange the line is opened anew and kept quiet for a while, and the drive is asked for a number
    of registers that nothing else asks for before it is asked anything else.

    Args:
        make_client: makes a pymodbus client, not yet connected.
        address: for messages.
        quiet: how long to keep the line quiet after a failure, s.

    Raises:
        CommunicationError: the line cannot be opened.
    """

    def __init__(self, make_client: Callable[[], Client], address: str, quiet: float) -> None:
        self._make_client = make_client
        self._address = address
        self._quiet = quiet
        self._turns = Turns()
        self._failed = False
        self._out_of_step: set[int] = set()
        self._marks = itertools.cycle(MARKS)
        self._line = Line(self._connect)

    def read(self, name: str, device: int, register: int) -> int:
        """The signed 32-bit value at a register and the next; asked a second time when the first
        answer does not come.

        Raises:
            CommunicationError: no answer, or not a right one.
            DeviceError: the drive refuses.
        """
        with self._turns.take():
            try:
                return self._pair(name, device, register)
            except CommunicationError:
                return self._pair(name, device, register)

    def write(
        self, name: str, device: int, register: int, values: Sequence[int], *, urgent: bool = False
    ) -> None:
        """Write 32-bit values from a register on, once.

        Raises:
            CommunicationError: no answer, or not a right one; the drive may have taken the values
                all the same.
            DeviceError: the drive refuses.
        """
        with self._turns.take(urgent=urgent):
            asked = (
                f"{name} (slave {device}): wrote {len(values)} values from register {register:#06x}"
                " on, "
            )
            self._exchange(
                asked,
                device,
                WRITE,
                lambda client: client.write_registers(register, to_words(values), device_id=device),
                urgent=urgent,
            )

    def close(self) -> None:
        """Let go of the line."""
        self._line.close()

    def _connect(self) -> Client:
        client = self._make_client()
        if not client.connect():
            if isinstance(client, ModbusTcpClient):
                raise CommunicationError(
                    f"{self._address}: cannot be reached; check power, network and address"
                )
            raise CommunicationError(
                f"{self._address}: cannot be opened; check the address, and who else holds it"
            )
        close_in_children(client)
        if self._failed:
            time.sleep(self._quiet)
            self._failed = False
        return client

    def _pair(self, name: str, device: int, register: int) -> int:
        asked = f"{name} (slave {device}): asked for register {register:#06x}, "
        reply = self._exchange(
            asked,
            device,
            READ,
            lambda client: client.read_holding_registers(register, count=2, device_id=device),
        )
        if len(reply.registers) != 2:
            self._out_of_step.add(device)
            raise CommunicationError(
                f"{asked}got {len(reply.registers)} registers instead of 2; check cable and parity"
            )
        return from_words(*reply.registers)

    def _exchange(
        self,
        asked: str,
        device: int,
        function: int,
        ask: Callable[[Client], Any],
        *,
        urgent: bool = False,
    ) -> Any:
        client = self._line.get(asked)
        try:
            _pass_over_what_waits(client)
            if device in self._out_of_step and not urgent:
                self._get_in_step(client, device)
            reply = ask(client)
            if reply.function_code & 0x7F != function:
                raise ModbusException("the answer to another question came")
        except (ModbusException, OSError) as error:
            self._line.lose(client)
            self._failed = True
            self._out_of_step.add(device)
            raise CommunicationError(
                f"{asked}no right answer ({_first_line(error)}); check cable, parity, slave number"
                " and power"
            ) from error
        if reply.isError():
            code = reply.exception_code
            raise DeviceError(
                f"{asked}the drive refuses: {EXCEPTIONS.get(code, f'exception {code}')}; check"
                " model and settings"
            )
        return reply

    def _get_in_step(self, client: Client, device: int) -> None:
        """Ask a drive for so many registers until so many come: what it answers before was asked
        earlier.

        Raises:
            ModbusException: it answers something else again and again, or nothing.
        """
        for _ in range(MOST_LATE):
            mark = next(self._marks)
            reply: Any = client.read_holding_registers(MONITORS, count=mark, device_id=device)
            if reply.isError() or len(getattr(reply, "registers", ())) == mark:
                self._out_of_step.discard(device)
                return
            time.sleep(self._quiet)
            _pass_over_what_waits(client)
        raise ModbusException("answers to other questions only")


def _pass_over_what_waits(client: Client) -> None:
    """Throw away what came after the last answer, such as that answer a second time; on serial
    lines pymodbus does so itself.

    Raises:
        OSError: the connection is closed.
    """
    if isinstance(client, ModbusTcpClient) and client.socket is not None:
        while select.select([client.socket], [], [], 0)[0]:
            if not client.socket.recv(4096):
                raise ConnectionError("closed by the other side")


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


class TcpClient(ModbusTcpClient):
    """A client that once it was closed opens nothing anew, as pymodbus's own would."""

    over = False

    def connect(self) -> bool:
        """Open the connection; whether it is."""
        return not self.over and bool(super().connect())

    def close(self) -> None:
        """Let go of it for good."""
        self.over = True
        super().close()


class PortClient(ModbusSerialClient):
    """The same on a serial port that is this program's own as long as it is open."""

    alone, over = True, False

    def connect(self) -> bool:
        """Open the port; whether it is."""
        if self.over:
            return False
        how = self.comm_params
        try:
            self.socket = self.socket or open_port(
                str(how.host), alone=self.alone, baudrate=how.baudrate, bytesize=how.bytesize,
                parity=how.parity, stopbits=how.stopbits, timeout=how.timeout_connect,
                write_timeout=how.timeout_connect, inter_byte_timeout=self.inter_byte_timeout,
            )  # fmt: skip
        except (OSError, ValueError):
            self.close()
        return self.socket is not None

    def close(self) -> None:
        """Let go of it for good."""
        self.over = True
        super().close()


class BesideOthers(PortClient):
    """The same beside another program that may have the port for itself."""

    alone = False


def make_client(
    address: str, baud: int, parity: str, timeout: float, *, alone: bool = True
) -> Client:
    """A client for a serial port, or for a line behind a network (``socket://host:port``,
    ``host:port``), RTU frames on both.

    Raises:
        InputError: the address is none.
    """
    serial_place(address)
    passed = Echo(address).pass_over
    host, _, port = address.removeprefix("socket://").rpartition(":")
    if host and port.isdigit() and "/" not in host:
        return TcpClient(
            host, port=int(port), framer=FramerType.RTU, timeout=timeout, retries=0,
            trace_packet=passed,
        )  # fmt: skip
    kind = PortClient if alone else BesideOthers
    return kind(
        address, baudrate=baud, parity=parity, timeout=timeout, retries=0, trace_packet=passed
    )


class Echo:
    """Passes over what an adapter hands back: two-wire RS-485 adapters hear what they send.

    No answer begins as its question does: that to a reading tells fewer bytes than were asked for,
    that to a writing is shorter.

    Args:
        address: for the operator.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._sent = b""
        self._said = False

    def pass_over(self, sending: bool, packet: bytes) -> bytes:
        """What was sent as it is; what came, without what was sent last."""
        if sending:
            self._sent = packet
            return packet
        if packet and self._sent.startswith(packet):
            return b""  # the rest of it is still to come
        if self._sent and packet.startswith(self._sent):
            if not self._said:
                words = (
                    f"{self._address}: its adapter hands back what is sent, which is passed over"
                )
                LOG.info(words)
                sys.stderr.write(f"flflab: {words}\n")
                self._said = True
            return packet[len(self._sent) :]
        return packet

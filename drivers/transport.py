"""Bytes to and from an instrument: a serial line (tty, pty, ``socket://``) or a TCP connection,
read with deadlines.
"""

import contextlib
import errno
import functools
import ipaddress
import math
import os
import re
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from drivers.forked import close_in_children
from flflab.errors import CommunicationError, InputError, reason

SLICE_S = 0.02
LONGEST_S = 10.0  # more than a silence, for a whole line that comes byte by byte
_OPTION = r"(ign_set_control|poll_modem|timeout=\d+)"
URL = re.compile(  # the one of pyserial's that leads to an instrument: others write files
    rf"rfc2217://([^\s/?:@]+:\d+)(\?{_OPTION}(&{_OPTION})*)?", re.IGNORECASE
)
LOOPBACK = "127.0.0.1"
MOST_UNREAD = 1 << 16
LET_GO_S = 0.5  # a child of this program's holds its locks until it runs a program of its own


def what_to_check(address: str) -> str:
    """What an operator looks at where nobody answers: no cable leads to what is served on this
    machine.
    """
    if address == "simulated" or address.removeprefix("socket://").startswith(
        ("127.", "localhost:", "[::1]")
    ):
        return (
            "is `flflab sim` still running? On a busy machine, or while a defocused picture is"
            " simulated, wait and try again"
        )
    return "check cable, power and address"


class LostError(CommunicationError):
    """The connection itself is gone; only opening it anew can help."""


class Wire:
    """A connection: writes whole messages, reads up to an end mark or a count of bytes, each by a
    deadline.

    Args:
        address: where it leads, for messages.
        send: writes bytes.
        receive: returns what has come, waiting a short while; empty when nothing has.
        shut: lets go of it.
    """

    def __init__(
        self,
        address: str,
        send: Callable[[bytes], object],
        receive: Callable[[], bytes],
        shut: Callable[[], None],
    ) -> None:
        self.address = address
        self._send = send
        self._receive = receive
        self._shut = shut
        self._come = bytearray()
        self._writing = threading.Lock()
        close_in_children(self)

    def write(self, message: bytes) -> None:
        """Write a whole message; may be called from any thread at any time.

        Raises:
            LostError: the connection is gone.
        """
        try:
            with self._writing:
                self._send(message)
        except (OSError, TypeError) as error:
            raise LostError(
                f"{self.address}: cannot write ({reason(error)}); {what_to_check(self.address)}"
            ) from error

    def read_until(self, end: bytes, timeout: float) -> bytes:
        """What comes up to an end mark, without it; the time counts from the last byte that came.

        Raises:
            CommunicationError: it did not come in time, far too much came without it, or the
                connection is gone.
        """
        deadline, seen = time.monotonic() + timeout, 0
        ends = deadline + LONGEST_S
        while (at := self._come.find(end, seen)) < 0:
            have = len(self._come)
            seen = max(0, len(self._come) - len(end) + 1)
            if len(self._come) > MOST_UNREAD:
                raise CommunicationError(
                    f"{self.address}: endless {show(self._come)} without an end of line; check the"
                    " baud rate"
                )
            self._wait_for_more(deadline, timeout)
            if len(self._come) > have:
                deadline = time.monotonic() + timeout
            if time.monotonic() > ends:
                raise CommunicationError(
                    f"{self.address}: {show(self._come)} came within {timeout + LONGEST_S:g} s,"
                    f" and no end of it; {what_to_check(self.address)}"
                )
        line = bytes(self._come[:at])
        del self._come[: at + len(end)]
        return line

    def read_exactly(self, count: int, timeout: float) -> bytes:
        """A number of bytes; the time counts from the last byte that came.

        Raises:
            CommunicationError: no more came for that long, or the connection is gone.
        """
        have = len(self._come)
        deadline = time.monotonic() + timeout
        while len(self._come) < count:
            self._wait_for_more(deadline, timeout, f", after {len(self._come)} of {count} bytes")
            if len(self._come) > have:
                have, deadline = len(self._come), time.monotonic() + timeout
        block = bytes(self._come[:count])
        del self._come[:count]
        return block

    def drain(self, quiet: float = 0.05, longest: float = 1.0) -> None:
        """Throw away what has come, until nothing comes for a while (s), or for longest (s)."""
        end = time.monotonic() + longest
        calm = time.monotonic() + quiet
        self._come.clear()
        while time.monotonic() < min(calm, end):
            if self._take():
                calm = time.monotonic() + quiet
            self._come.clear()

    def close(self) -> None:
        """Let go of the connection; raises nothing."""
        with contextlib.suppress(OSError):
            self._shut()

    def _wait_for_more(self, deadline: float, timeout: float, progress: str = "") -> None:
        if not self._take() and time.monotonic() > deadline:
            rest = (
                f"; {show(self._come)} came without its end" if self._come and not progress else ""
            )
            raise CommunicationError(
                f"{self.address}: no answer within {timeout:g} s{progress}{rest};"
                f" {what_to_check(self.address)}"
            )

    def _take(self) -> bool:
        try:
            more = self._receive()
        except (OSError, TypeError) as error:
            raise LostError(
                f"{self.address}: the connection is gone ({reason(error)});"
                f" {what_to_check(self.address)}"
            ) from error
        self._come += more
        return bool(more)


def show(message: bytes | bytearray, most: int = 60) -> str:
    """Bytes for a message to people, cut when long."""
    return repr(bytes(message[:most])) + ("..." if len(message) > most else "")


def open_serial(
    address: str, baud: int, *, parity: str = "N", handshake: bool = False, alone: bool = True
) -> Wire:
    """Open a serial line.

    Args:
        address: as ``serial_place`` takes it: a port (``COM3``, ``/dev/ttyUSB0``, a pty's path), a
            URL of pyserial, or one behind a network: ``host:port`` and ``socket://host:port`` are
            TCP without pyserial, which reads them byte by byte and takes 0.3 s to close.
        baud: bits per second; TCP has none.
        parity: N, E or O.
        handshake: RTS and CTS say when to send.
        alone: keep others from the port by an advisory lock, which they may pass over: so does who
            only stops.

    Raises:
        InputError: the address is none.
        CommunicationError: there is no such port, or it is in use.
    """
    serial_place(address)
    if address.startswith("socket://") or _is_host_and_port(address):
        return open_tcp(address)
    try:
        port = open_port(
            address,
            alone=alone,
            baudrate=baud,
            parity=parity,
            rtscts=handshake,
            timeout=SLICE_S,
            write_timeout=2.0,
        )
    except (OSError, ValueError) as error:
        raise CommunicationError(
            f"{address}: cannot be opened ({reason(error)}); check the address, and who else holds"
            " it"
        ) from error
    return Wire(address, port.write, lambda: port.read(max(1, port.in_waiting)), port.close)


def open_port(address: str, *, alone: bool, **settings: Any) -> Any:
    """Open a port or a URL by pyserial, locked for this program or beside others (``alone``).

    Raises:
        OSError, ValueError: there is no such port, or it is in use.
    """
    import serial

    own = {"exclusive": True} if alone and "://" not in address else {}
    deadline = time.monotonic() + LET_GO_S
    while True:
        try:
            return serial.serial_for_url(address, **own, **settings)
        except OSError as error:
            if error.errno != errno.EAGAIN or time.monotonic() > deadline:
                raise
        time.sleep(SLICE_S)


def open_tcp(address: str, timeout: float = 5.0) -> Wire:
    """Open a TCP connection to ``host:port`` (``socket://host:port`` is the same).

    Raises:
        InputError: the address is not one.
        CommunicationError: nobody listens there.
    """
    try:
        link = socket.create_connection(_host_and_port(address), timeout)
    except (OSError, OverflowError) as error:
        raise CommunicationError(
            f"{address}: cannot be reached ({reason(error)}); check power, network and address"
        ) from error
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.settimeout(SLICE_S)

    def receive() -> bytes:
        try:
            more = link.recv(1 << 18)
        except TimeoutError:
            return b""
        if not more:
            raise ConnectionError("closed by the instrument")
        return more

    sender = link.dup()  # with its own timeout: one thread may write while another waits to read
    sender.settimeout(timeout)

    def shut() -> None:
        sender.close()
        link.close()

    return Wire(address, sender.sendall, receive, shut)


def tcp_place(address: str) -> str:
    """A network address spelt one way, ``host:port``: the number of the host, and one for this
    machine whatever it is called; a name that nobody knows as it is.

    Raises:
        InputError: it is none.
    """
    host, port = _host_and_port(address)
    return f"{one_host(host)}:{port}"


def _host_and_port(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix("socket://").rpartition(":")
    host = host.strip("[]").lower()
    if not host or not re.fullmatch("[0-9]{1,9}", port) or not 0 < int(port) < 65536:
        raise InputError(
            f"{address!r} is not an address; give host:port, such as 127.0.0.1:5025, with a port"
            " from 1 to 65535"
        )
    return host, int(port)


@functools.lru_cache(maxsize=256)
def one_host(host: str) -> str:
    """The number of a host, one for this machine whatever it is called; a name that nobody knows as
    it is.
    """
    try:
        found = {str(info[4][0]) for info in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return host
    numbers = sorted(
        (ipaddress.ip_address(number.partition("%")[0]) for number in found),
        key=lambda number: (number.version, number),
    )
    return LOOPBACK if any(map(_is_here, numbers)) else str(numbers[0])


def _is_here(number: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    """Whether it is a number of this machine: a socket can be bound to no other."""
    if isinstance(number, ipaddress.IPv6Address) and number.ipv4_mapped:
        number = number.ipv4_mapped
    if number.is_loopback or number.is_unspecified:
        return True
    family = socket.AF_INET if number.version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((str(number), 0))
    except OSError:
        return False
    return True


def serial_place(address: str) -> str:
    """The address of a serial line spelt one way: links followed to the port they lead to; of
    the URLs of pyserial a network's (``rfc2217://``) is allowed, which is its host and port
    whatever options it has.

    macOS has two files for a port, /dev/tty.X that waits for a carrier and /dev/cu.X that does not:
    the second stands for both.

    Raises:
        InputError: it is none.
    """
    if address.startswith("socket://") or _is_host_and_port(address):
        return tcp_place(address)
    if port := re.fullmatch(r"(?:\\\\\.\\)?(COM\d+)", address, re.IGNORECASE):
        return port[1].upper()
    if remote := URL.fullmatch(address):
        return tcp_place(remote[1])
    if address.startswith("/"):
        return re.sub(r"^/dev/tty\.", "/dev/cu.", os.path.realpath(address))
    raise InputError(
        f"{address!r} is not an address; give a serial port, such as /dev/ttyUSB0 or COM3,"
        " socket://host:port, or rfc2217://host:port"
    )


def _is_host_and_port(address: str) -> bool:
    host, colon, number = address.rpartition(":")
    return bool(colon and host and number.isdigit()) and "/" not in address


def whole_number(said: str) -> int | None:
    """The whole number that a device said; None where it said none, or one with more digits than
    any device counts.
    """
    return int(said) if re.fullmatch(r"[+-]?[0-9]{1,18}", said) else None


def real_number(said: str) -> float | None:
    """The finite number that a device said; None where it said none."""
    if not re.fullmatch(r"\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*", said[:60]):
        return None
    value = float(said) if len(said) <= 60 else math.inf
    return value if math.isfinite(value) else None

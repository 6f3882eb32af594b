"""One line of SCPI to an instrument: commands whose failure is asked for in the same line, queries,
and blocks of bytes.
"""

import re
import threading
from collections.abc import Callable
from typing import TypeVar

from drivers.transport import Wire, open_tcp, real_number, show
from flflab.errors import CommunicationError, DeviceError
from flflab.printable import shortened

Device = TypeVar("Device")
MOST_CHARACTERS = 200  # of an error
AGAIN = "check the line, then ask again"
ERROR = re.compile(r'(-?[0-9]{1,9}),"((?:[^"]|"")*)"')


class ScpiLink:
    """A connection to the instruments at one address (docs/scpi-camera.md); any thread may ask, one
    at a time.

    After a fault the connection is dropped, since nobody knows what is still to come on it; the
    next question connects anew.

    Args:
        name: the device on the bench, for messages.
        address: ``host:port``.
        timeout: how long an answer may take, s.
    """

    def __init__(self, name: str, address: str, timeout: float = 2.0) -> None:
        self.connections = 0
        self._name = name
        self._address = address
        self._timeout = timeout
        self._turn = threading.RLock()
        self._wire: Wire | None = None

    def __str__(self) -> str:
        return f"{self._name} at {self._address}"

    def query(self, *queries: str, timeout: float | None = None) -> list[str]:
        """The answers to queries asked in one line; errors kept from before are forgotten.

        Raises:
            CommunicationError: no answer, or not as many as were asked for.
            DeviceError: the instrument reports an error.
        """
        answers = split(self._exchange(";".join(("*CLS", *queries, "SYST:ERR?")), timeout))
        self._refuse_error(answers[-1], "; ".join(queries))
        if len(answers) != len(queries) + 1:
            self.drop()
            raise CommunicationError(
                f"{self._says(queries)}, got {len(answers) - 1} answers, {shortened(answers)};"
                " check model and firmware"
            )
        return answers[:-1]

    def command(self, *commands: str) -> None:
        """Send commands in one line and learn whether they were taken.

        Raises:
            CommunicationError: no answer.
            DeviceError: the instrument refuses one.
        """
        self._refuse_error(
            self._exchange(";".join(("*CLS", *commands, "SYST:ERR?"))), "; ".join(commands)
        )

    def poll(self, query: str) -> str:
        """The answer to one query that cannot fail; leaves the kept errors where they are.

        Raises:
            CommunicationError: no answer.
        """
        return self._exchange(query)

    def error(self) -> str:
        """The oldest error the instrument keeps for us; empty where there is none."""
        return self._read_error(self._exchange("SYST:ERR?"))

    def numbers(self, *queries: str) -> list[float]:
        """Answers that have to be numbers; errors as ``query``."""
        answers = self.query(*queries)
        numbers = [one for answer in answers if (one := real_number(answer)) is not None]
        if len(numbers) == len(answers):
            return numbers
        self.drop()
        raise CommunicationError(
            f"{self._says(queries)}, got {shortened(answers)}, not finite numbers; check model and"
            " firmware"
        )

    def block(self, query: str, fields: int, most: int, timeout: float) -> tuple[list[str], bytes]:
        """Ask for numbers followed by one IEEE 488.2 definite-length block.

        Args:
            query: the only query of its line.
            fields: how many comma-separated fields stand before the block.
            most: the largest block that makes sense, bytes.
            timeout: how long its beginning may take, s; once it runs, 5 s without a byte is the
                end.

        Returns:
            The fields and the bytes.

        Raises:
            CommunicationError: late, torn, or not such an answer.
        """
        with self._turn:
            try:
                wire = self._connect()
                wire.write(query.encode("ascii") + b"\n")
                head = wire.read_until(b"#", timeout)
                digits = wire.read_exactly(1, 5.0)
                length = wire.read_exactly(int(digits), 5.0) if b"1" <= digits <= b"9" else b""
                if not length.isdigit() or int(length) > most:
                    raise CommunicationError(
                        f"got a block {show(b'#' + digits + length)}, not one of at most {most}"
                        f" bytes; {AGAIN}"
                    )
                bytes_ = wire.read_exactly(int(length), 5.0)
                if (end := wire.read_exactly(1, 5.0)) != b"\n":
                    raise CommunicationError(
                        f"got {show(end)} after a block of {int(length)} bytes where its end is"
                        f" due; {AGAIN}"
                    )
                found = head.decode("ascii", "replace").split(",")
                if len(found) != fields + 1 or found[-1]:
                    raise CommunicationError(
                        f"got {show(head)} before the block where {fields} fields are due; {AGAIN}"
                    )
            except CommunicationError as error:
                self.drop()
                raise CommunicationError(f"{self._says((query,))}: {error}") from error
        return found[:-1], bytes_

    def drop(self) -> None:
        """Drop the connection; the next question connects anew."""
        with self._turn:
            if self._wire is not None:
                self._wire.close()
                self._wire = None

    close = drop

    def _connect(self) -> Wire:
        if self._wire is None:
            self._wire = open_tcp(self._address)
            self.connections += 1
        return self._wire

    def _exchange(self, line: str, timeout: float | None = None) -> str:
        with self._turn:
            try:
                wire = self._connect()
                wire.write(line.encode("ascii") + b"\n")
                answer = wire.read_until(
                    b"\n", self._timeout if timeout is None else timeout
                ).rstrip(b"\r")
                if not answer.isascii():
                    raise CommunicationError(
                        f"got {show(answer)}, which is no text; check what stands at this address"
                    )
                return answer.decode("ascii")
            except CommunicationError as error:
                self.drop()
                raise CommunicationError(f"{self._says((line,))}: {error}") from error

    def _read_error(self, answer: str) -> str:
        found = ERROR.fullmatch(answer)
        if found is None:
            self.drop()
            raise CommunicationError(
                f"{self._says(('SYST:ERR?',))}, got {answer[:80]!r}, not an error's number and text"
            )
        number, text = found.groups()
        text = text.replace(2 * chr(34), chr(34))[:MOST_CHARACTERS]
        return "" if int(number) == 0 else f"{number} {text}"

    def _refuse_error(self, answer: str, asked: str) -> None:
        if fault := self._read_error(answer):
            raise DeviceError(f"{self}: the instrument refuses {asked!r}: {fault}")

    def _says(self, queries: tuple[str, ...]) -> str:
        return f"{self}: asked {'; '.join(queries)!r}"


def on_link(link: ScpiLink, device: Callable[[ScpiLink], Device]) -> Device:
    """Make a device on a link; where that fails, nothing stays open."""
    try:
        return device(link)
    except DeviceError:
        link.close()
        raise


def split(line: str) -> list[str]:
    """The answers of a line: parts between semicolons that are not inside double quotes."""
    return re.findall(r'(?:^|;)((?:"(?:[^"]|"")*"|[^;"])*)', line)


def unquote(answer: str) -> str:
    """A string without its double quotes."""
    inside = answer[1:-1] if len(answer) >= 2 and answer[0] == answer[-1] == '"' else answer
    return inside.replace('""', '"')


def quote(text: str) -> str:
    """A string in double quotes."""
    return '"' + text.replace('"', '""') + '"'

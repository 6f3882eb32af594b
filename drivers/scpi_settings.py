"""An iris and a target wheel on SCPI, as docs/scpi-camera.md has them."""

import re
from typing import Annotated

from pydantic import Field

from drivers.scpi_link import ScpiLink, on_link, quote, unquote
from flflab.description import Description
from flflab.errors import CommunicationError
from flflab.printable import shortened


def busy(link: ScpiLink, query: str) -> bool:
    """What a busy query answers.

    Raises:
        CommunicationError: neither 1 nor 0.
    """
    answer = link.poll(query)
    if answer not in ("0", "1"):
        link.drop()
        raise CommunicationError(
            f"asked {query!r}, got {answer[:80]!r}, neither 0 nor 1; check what stands at this"
            " address"
        )
    return answer == "1"


class ScpiIris:
    """The f-number of a motorised iris; satisfies ``SettingCommands[float]``. Connecting moves
    nothing.

    Raises:
        CommunicationError: it does not answer, or not as an iris.
    """

    def __init__(self, link: ScpiLink) -> None:
        self._link = link
        least, most = link.numbers("LENS:FNUM? MIN", "LENS:FNUM? MAX")
        if not 0 < least <= most:
            raise CommunicationError(
                f"iris: says that its f-numbers go from {least:g} to {most:g}; check model and"
                " firmware"
            )
        self.allowed = (least, most)

    def start(self, value: float) -> None:
        """Start towards an f-number."""
        self._link.command(f"LENS:FNUM {value!r}")

    def is_busy(self) -> bool:
        """Whether it moves."""
        return busy(self._link, "LENS:BUSY?")

    def value(self) -> float:
        """Where it believes to be."""
        return self._link.numbers("LENS:FNUM?")[0]

    def fault(self) -> str:
        """Why the last change did not arrive; empty where it did."""
        return self._link.error()

    def stop(self) -> None:
        """Turn back to where it is now; the instrument has no stop of its own."""
        self.start(self.value())

    def identity(self) -> str:
        """What ``*IDN?`` answers."""
        return self._link.query("*IDN?")[0]

    def close(self) -> None:
        """Drop the connection."""
        self._link.close()


class ScpiTarget:
    """The name of the target in place on a wheel; satisfies ``SettingCommands[str]``. Connecting
    turns nothing.

    Raises:
        CommunicationError: it does not answer, or not as a wheel.
    """

    def __init__(self, link: ScpiLink) -> None:
        self._link = link
        catalogue = link.query("TARG:CAT?")[0]
        self.allowed = tuple(unquote(name) for name in re.findall(r'"(?:[^"]|"")*"', catalogue))
        if not self.allowed:
            raise CommunicationError(
                f"target: asked for its names, got {shortened(catalogue)}; check what stands"
                " at this address"
            )

    def start(self, value: str) -> None:
        """Start to turn."""
        self._link.command(f"TARG:KIND {quote(value)}")

    def is_busy(self) -> bool:
        """Whether it turns."""
        return busy(self._link, "TARG:BUSY?")

    def value(self) -> str:
        """The name in place; empty while it turns."""
        return unquote(self._link.query("TARG:KIND?")[0])

    def fault(self) -> str:
        """Why the last change did not arrive; empty where it did."""
        return self._link.error()

    def stop(self) -> None:
        """Nothing: a wheel that turns ends at a name and harms nobody on the way."""

    def identity(self) -> str:
        """What ``*IDN?`` answers."""
        return self._link.query("*IDN?")[0]

    def close(self) -> None:
        """Drop the connection."""
        self._link.close()


class ScpiSettingKeys(Description):
    """The keys of an iris or a target wheel in the bench file; ``timeout``: how long an answer may
    take, s.
    """

    timeout: Annotated[float, Field(gt=0)] = 2.0


def open_iris(address: str, keys: ScpiSettingKeys, share: object) -> ScpiIris:
    """Open an iris; each instrument has its own connection, since errors are kept for each."""
    return on_link(ScpiLink("iris", address, keys.timeout), ScpiIris)


def open_target(address: str, keys: ScpiSettingKeys, share: object) -> ScpiTarget:
    """Open a target wheel, on its own connection."""
    return on_link(ScpiLink("target", address, keys.timeout), ScpiTarget)

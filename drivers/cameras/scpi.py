"""A camera on SCPI with IEEE 488.2 blocks, as docs/scpi-camera.md has it: no frame lost, doubled or
torn without an error.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.camera_commands import Setup, Taken
from drivers.scpi_link import ScpiLink, on_link, unquote
from drivers.transport import real_number, whole_number
from flflab.description import Description
from flflab.errors import CommunicationError
from flflab.printable import shortened

SLACK_S = 60.0
MOST_PIXELS = 500_000_000  # of a frame, 1 GB


class ScpiCamera:
    """A camera; satisfies ``CameraCommands``.

    Opening it resets it (``*RST``: start-up exposure and gain, frames counted from 1; nothing
    moves). After a fault on the line the next call connects anew, resets it again and prepares what
    was prepared before.

    Args:
        link: the connection.
        slack: how long a frame may come after exposure and readout, s.

    Raises:
        CommunicationError: it does not answer, or not as a camera.
    """

    offered_exposures: tuple[float, ...] = ()

    def __init__(self, link: ScpiLink, slack: float = SLACK_S) -> None:
        self._link = link
        self._slack = slack
        self._connection = 0
        self._number = 0
        self._prepared: tuple[float, float] | None = None
        self._begin()

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Set exposure time in s and gain, and read back what became of them."""
        self._prepared = (exposure_s, gain)
        self._in_touch()
        self._apply()

    def arm(self) -> None:
        """Learn whether the connection is still the one that was begun on, else begin anew."""
        self._in_touch()

    def trigger(self) -> None:
        """Start one exposure."""
        self._link.command("INIT")

    def exposing(self) -> bool:
        """Whether its light is still being collected."""
        answer = self._link.poll("EXP:BUSY?")
        if answer not in ("0", "1"):
            raise CommunicationError(
                f"{self._link}: asked whether it exposes, got {answer[:80]!r}, neither 0 nor 1;"
                " check its firmware"
            )
        return answer == "1"

    def fetch(self) -> Taken:
        """Wait for its frame.

        Raises:
            CommunicationError: the frame came late, torn, lost or out of turn.
        """
        expected = self.setup.exposure_s
        fields, block = self._link.block(
            "FETC?", 7, 2 * self.columns * self.rows, expected + self._readout + self._slack
        )
        numbers = [one for field in fields if (one := real_number(field)) is not None]
        if len(numbers) != len(fields):
            raise CommunicationError(
                f"{self._link}: {shortened(fields)} before a frame, seven finite numbers are due;"
                " take the picture again"
            )
        number, timestamp, exposure, gain, columns, rows, dropped = numbers
        if not block:
            reason = self._link.error()
            raise CommunicationError(
                f"{self._link}: the camera gave no frame ({reason or 'it does not say why'}); take"
                " the picture again"
            )
        wrong = [
            f"{what} {came:g} instead of {due:g}"
            for what, came, due in (
                ("frame number", number, self._number + 1), ("dropped frames", dropped, 0),
                ("exposure", exposure, expected),
                ("gain", gain, self.setup.gain), ("columns", columns, self.columns),
                ("rows", rows, self.rows),
                ("bytes", len(block), 2 * self.columns * self.rows),
            )
            if came != due
        ]  # fmt: skip
        if wrong:
            raise CommunicationError(
                f"{self._link}: the frame is not the one asked for: {', '.join(wrong)}; "
                "see that no other program uses the camera, then take it again"
            )
        self._number += 1
        picture = (
            np.frombuffer(block, dtype="<u2").reshape(self.rows, self.columns).astype(np.uint16)
        )
        return Taken(picture, exposure, gain, timestamp, self.setup.pixel_format)

    def reset(self) -> None:
        """Drop the connection: nobody knows what is still to come on it."""
        self._link.drop()

    def identity(self) -> str:
        """What ``*IDN?`` answers."""
        return self._link.query("*IDN?")[0]

    def close(self) -> None:
        """Drop the connection."""
        self._link.close()

    def _in_touch(self) -> None:
        """Learn whether the connection is still the one that was begun on, else begin anew."""
        self._link.poll("SYST:BUSY?")
        if self._link.connections != self._connection:
            self._begin()

    def _begin(self) -> None:
        self._link.command("ABOR", "*RST")
        self._connection = self._link.connections
        self._number = 0
        numbers = self._link.numbers(
            "SENS:FULL?",
            "SENS:OFFS?",
            "SENS:READ?",
            "EXP? MIN",
            "EXP? MAX",
            "GAIN? MIN",
            "GAIN? MAX",
        )
        self._full_scale, self._offset, self._readout = int(numbers[0]), numbers[1], numbers[2]
        self.exposure_limits = (numbers[3], numbers[4])
        self.gain_limits = (numbers[5], numbers[6])
        self._refuse_impossible()
        size, pixel_format = self._link.query("SENS:SIZE?", "FORM?")
        self._pixel_format = unquote(pixel_format).capitalize()
        columns, rows = (whole_number(one) or 0 for one in (*size.split(",", 1), "")[:2])
        if min(columns, rows) < 1 or columns * rows > MOST_PIXELS:
            raise CommunicationError(
                f"{self._link}: asked for its size, got {shortened(size)}, not columns,rows of at"
                f" least 1,1 and at most {MOST_PIXELS / 1e6:g} megapixels; check what stands at"
                " this address"
            )
        self.columns, self.rows = columns, rows
        if self._prepared is None:
            self._read_back()
        else:
            self._apply()

    def _refuse_impossible(self) -> None:
        """Refuse a camera whose numbers no camera has.

        Raises:
            CommunicationError: they are named.
        """
        (shortest, longest), (least, most) = self.exposure_limits, self.gain_limits
        wrong = [
            words
            for words, holds in (
                (f"full scale {self._full_scale} DN", 1 <= self._full_scale <= 65535),
                (f"exposures of {shortest:g} s to {longest:g} s", 0 < shortest <= longest),
                (f"gains of {least:g} to {most:g}", 0 < least <= most),
                (f"a read-out of {self._readout:g} s", self._readout >= 0),
            )
            if not holds
        ]
        if wrong:
            raise CommunicationError(
                f"{self._link}: the camera says of itself {', '.join(wrong)}, which no camera has;"
                " check model and firmware"
            )

    def _apply(self) -> None:
        if self._prepared is not None:
            self._link.command(f"EXP {self._prepared[0]!r}", f"GAIN {self._prepared[1]!r}")
        self._read_back()

    def _read_back(self) -> None:
        """What the camera made of exposure and gain, and the facts of its noise at that gain."""
        exposure, gain, electrons_per_dn, noise = self._link.numbers(
            "EXP?", "GAIN?", "SENS:CONV?", "SENS:NOIS?"
        )
        if not electrons_per_dn > 0:
            raise CommunicationError(
                f"{self._link}: says that a DN is {electrons_per_dn:g} electrons; a number above 0"
                " is due"
            )
        if noise < 0:
            raise CommunicationError(
                f"{self._link}: says that its noise is {noise:g} electrons; 0 or more is due"
            )
        per_electron = 1 / electrons_per_dn
        self.setup = Setup(
            exposure,
            gain,
            self._pixel_format,
            self._full_scale,
            self._offset,
            per_electron,
            noise * per_electron,
        )


class ScpiCameraKeys(Description):
    """The keys of the camera in the bench file; ``timeout``: how long an answer may take, s; a
    frame may take 60 s more.
    """

    timeout: Annotated[float, Field(gt=0)] = 2.0


def open_camera(address: str, keys: ScpiCameraKeys, share: object) -> ScpiCamera:
    """Open a camera."""
    return on_link(ScpiLink("camera", address, keys.timeout), ScpiCamera)

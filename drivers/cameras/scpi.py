"""A camera on SCPI with IEEE 488.2 blocks, as docs/scpi-camera.md has it: no frame lost, doubled or torn without an error."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.camera import Frame
from drivers.scpi_link import ScpiLink, on_link
from flflab.description import Description
from flflab.errors import CommunicationError, LimitError

SLACK_S = 60.0


class ScpiCamera:
    """A camera; satisfies ``CameraDevice``.

    Opening it resets it (``*RST``: start-up exposure and gain, frames counted from 1; nothing moves). After a fault on the line
    the next call connects anew, resets it again and prepares what was prepared before.

    Args:
        name: the name on the bench.
        link: the connection.
        slack: how long a frame may come after exposure and readout, s.

    Raises:
        CommunicationError: it does not answer, or not as a camera.
    """

    def __init__(self, name: str, link: ScpiLink, slack: float = SLACK_S) -> None:
        self.name = name
        self._link = link
        self._slack = slack
        self._connection = 0
        self._number = 0
        self._prepared: tuple[float, float] | None = None
        self._begin()

    def prepare(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure time in s and gain.

        Raises:
            LimitError: outside what the camera can do.
            CommunicationError: it does not answer.
        """
        for what, value, (least, most), unit in (
            ("exposure", exposure_s, self.exposure_limits, " s"),
            ("gain", gain, self.gain_limits, ""),
        ):
            if not math.isfinite(value) or not least <= value <= most:
                raise LimitError(f"{self.name}: asked for {what} {value:g}{unit}; allowed is {least:g}{unit} to {most:g}{unit}")
        self._prepared = (float(exposure_s), float(gain))
        self._in_touch()
        self._apply()

    def grab(self) -> Frame:
        """Take one picture now.

        Raises:
            CommunicationError: the frame came late, torn, lost or out of turn.
            DeviceError: the camera refuses to expose.
        """
        self._in_touch()
        self._link.command("INIT")
        fields, block = self._link.block("FETC?", 7, 2 * self.columns * self.rows, self._exposure + self._readout + self._slack)
        try:
            number, timestamp, exposure, gain, columns, rows, dropped = (float(field) for field in fields)
        except ValueError as error:
            self._link.drop()
            raise CommunicationError(f"{self.name}: {fields} before a frame where seven numbers are due; take the picture again") from error
        if not block:
            reason = self._link.error()
            self._link.drop()
            raise CommunicationError(f"{self.name}: the camera gave no frame ({reason or 'it does not say why'}); take the picture again")
        wrong = [
            f"{what} {came:g} instead of {due:g}"
            for what, came, due in (
                ("frame number", number, self._number + 1), ("dropped frames", dropped, 0), ("exposure", exposure, self._exposure),
                ("gain", gain, self._gain), ("columns", columns, self.columns), ("rows", rows, self.rows),
                ("bytes", len(block), 2 * self.columns * self.rows),
            )
            if came != due
        ]  # fmt: skip
        if wrong:
            self._link.drop()
            raise CommunicationError(
                f"{self.name}: the frame is not the one asked for: {', '.join(wrong)}; "
                "see that no other program uses the camera, then take it again"
            )
        self._number += 1
        picture = np.frombuffer(block, dtype="<u2").reshape(self.rows, self.columns).astype(np.uint16)
        return Frame(picture, exposure, gain, timestamp, self._number, int(dropped))

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
        numbers = self._link.numbers("SENS:FULL?", "SENS:OFFS?", "SENS:READ?", "EXP? MIN", "EXP? MAX", "GAIN? MIN", "GAIN? MAX")
        self.full_scale = int(numbers[0])
        self.offset_dn, self._readout = numbers[1:3]
        self.exposure_limits = (numbers[3], numbers[4])
        self.gain_limits = (numbers[5], numbers[6])
        size = self._link.query("SENS:SIZE?")[0]
        columns, comma, rows = size.partition(",")
        if not (comma and columns.isdigit() and rows.isdigit()):
            raise CommunicationError(f"{self.name}: asked for its size, got {size!r}, not columns,rows; check what stands at this address")
        self.columns, self.rows = int(columns), int(rows)
        if self._prepared is None:
            self._read_back()
        else:
            self._apply()

    def _apply(self) -> None:
        if self._prepared is not None:
            self._link.command(f"EXP {self._prepared[0]!r}", f"GAIN {self._prepared[1]!r}")
        self._read_back()

    def _read_back(self) -> None:
        """What the camera made of exposure and gain, and the facts of its noise at that gain."""
        self._exposure, self._gain, electrons_per_dn, noise = self._link.numbers("EXP?", "GAIN?", "SENS:CONV?", "SENS:NOIS?")
        if not electrons_per_dn > 0:
            raise CommunicationError(f"{self.name}: says that a DN is {electrons_per_dn:g} electrons; a number above 0 is due")
        self.dn_per_electron = 1 / electrons_per_dn
        self.read_noise_dn = noise / electrons_per_dn


class ScpiCameraKeys(Description):
    """The keys of the camera in the bench file; ``timeout``: how long an answer may take, s; a frame may take 60 s more."""

    timeout: Annotated[float, Field(gt=0)] = 2.0


def open_camera(address: str, keys: ScpiCameraKeys, share: object) -> ScpiCamera:
    """Open a camera."""
    return on_link(ScpiLink("camera", address, keys.timeout), lambda link: ScpiCamera("camera", link))

"""A watched folder in which raw, TIFF or PNG files appear (docs/folder-camera.md): none read half,
none taken twice, none lost silently.
"""

import contextlib
import json
import re
import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.camera_commands import SensorKeys, Setup, Taken
from drivers.raw_file import taken_from
from flflab.description import Time
from flflab.errors import CommunicationError, DeviceError, InputError, reason
from flflab.files.image import read_picture
from flflab.files.raw import RAW, RawPicture, read_raw

ENDINGS = (*RAW, ".tif", ".tiff", ".png")
REQUEST = "request.json"
POLL_S = 0.02
Positive = Annotated[float, Field(gt=0)]
Stamp = tuple[int, int]  # size and time of a file: both stand still once it is whole


class FolderKeys(SensorKeys):
    """The keys of a folder camera.

    ``full_scale``: what a saturated pixel reads, DN. ``exposures``, ``gains``: from least to most.
    ``iso_at_gain_1``: the speed that counts as gain 1. ``timeout``: how long a file may come after
    the exposure; ``settle``: how long it must not change, both with unit.
    """

    full_scale: Annotated[int, Field(gt=0, le=65535)]
    released_by: Literal["person", "program"] = "person"
    exposures: tuple[Annotated[Time, Field(gt=0)], Annotated[Time, Field(gt=0)]]
    gains: tuple[Positive, Positive] = (1.0, 1.0)
    iso_at_gain_1: Positive = 100.0
    timeout: Annotated[Time, Field(gt=0)] = 60.0
    settle: Annotated[Time, Field(gt=0)] = 0.3


class FolderCamera:
    """A camera known by its files; satisfies ``CameraCommands``.

    Args:
        folder: where they appear.
        keys: what the bench file says of it.

    Raises:
        CommunicationError: there is no such folder.
    """

    offered_exposures: tuple[float, ...] = ()

    def __init__(self, folder: Path, keys: FolderKeys) -> None:
        self._folder = folder
        self._keys = keys
        self._who = f"camera in {folder}"
        self._known = set(self._files())
        self._number = max((_number(name) for name in self._known), default=0)
        self._given_up = 0
        self.exposure_limits = keys.exposures
        self.gain_limits = keys.gains
        self.prepare(keys.exposures[0], keys.gains[0])

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Remember what to ask for."""
        self.setup: Setup = self._keys.setup(exposure_s, gain, "", self._keys.full_scale)

    def arm(self) -> None:
        """Pass over files that came too late.

        Raises:
            CommunicationError: there are files nobody asked for.
        """
        new = self._new()
        self._known.update(new)
        if self._keys.released_by == "program":
            unasked = [name for name in new if _number(name) > self._number or not _number(name)]
        else:
            unasked = new[self._given_up :]
            self._given_up = max(0, self._given_up - len(new))
        if unasked:
            raise CommunicationError(
                f"{self._who}: {', '.join(unasked)} came unasked and is no frame; see who else"
                " releases the shutter"
            )

    def trigger(self) -> None:
        """Ask the program or the person for one picture."""
        self._number += 1
        exposure_s, gain = self.setup.exposure_s, self.setup.gain
        if self._keys.released_by == "person":
            awaited = (
                f"a file is awaited in {self._folder} for {exposure_s + self._keys.timeout:g} s"
            )
            print(
                f"\acamera: take one picture now, {exposure_s:g} s at gain {gain:g}; {awaited}",
                file=sys.stderr,
                flush=True,
            )
            return
        request = {"number": self._number, "exposure_s": exposure_s, "gain": gain}
        try:
            (self._folder / ".request").write_text(json.dumps(request), encoding="utf-8")
            (self._folder / ".request").replace(self._folder / REQUEST)
        except OSError as error:
            raise CommunicationError(
                f"{self._who}: {REQUEST} cannot be written ({reason(error)}); check the folder"
            ) from error

    def exposing(self) -> None:
        """Only its picture can tell."""

    def fetch(self) -> Taken:
        """Wait for the file and read it whole.

        Raises:
            CommunicationError: it did not come, stayed incomplete, or is not what was asked for.
        """
        patience = self.setup.exposure_s + self._keys.timeout
        deadline = time.monotonic() + patience
        before: Stamp | None = None
        since, reason = time.monotonic(), ""
        try:
            while time.monotonic() < deadline:
                name = self._answer()
                stamp = self._stamp(name) if name else None
                if stamp != before:
                    before, since = stamp, time.monotonic()
                elif name and stamp and time.monotonic() - since >= self._keys.settle:
                    try:
                        taken = self._read(name, stamp)
                    except InputError as error:
                        reason, since = f"; {error}", time.monotonic()
                    else:
                        if taken is not None:
                            self._known.add(name)
                            return taken
                time.sleep(POLL_S)
        except CommunicationError:
            self._known.update(self._new())  # they are told; none of them is the next frame
            raise
        came = self._new()
        self._known.update(came)
        if not came:
            self._given_up += 1
            waits = f"{REQUEST} still lies there, so see that the program beside the camera runs"
            advice = (
                waits if (self._folder / REQUEST).exists() else "see that the shutter is released"
            )
            raise CommunicationError(
                f"{self._who}: no file came within {patience:g} s; {advice}, then take the picture"
                " again"
            )
        raise CommunicationError(
            f"{self._who}: {', '.join(came)} is no whole picture after {patience:g} s{reason}; take"
            " the picture again"
        )

    def reset(self) -> None:
        """Take back a request that nobody took."""
        with contextlib.suppress(OSError):
            (self._folder / REQUEST).unlink(missing_ok=True)

    def identity(self) -> str:
        """What is watched; the camera itself tells nothing."""
        return f"watched folder, {self._keys.released_by} releases"

    def close(self) -> None:
        """Nothing is open."""

    def _answer(self) -> str:
        """The name of the file that answers the last request; empty while there is none.

        Raises:
            CommunicationError: there are several.
        """
        new = self._new()
        if self._keys.released_by == "program":
            new = [name for name in new if _number(name) == self._number]
        if len(new) > 1:
            raise CommunicationError(
                f"{self._who}: {', '.join(new)} came for one exposure, and nobody knows which is"
                " its frame; let one file come for each, then take the picture again"
            )
        return new[0] if new else ""

    def _read(self, name: str, stamp: Stamp) -> Taken | None:
        """A picture that has stood still; None where it changed while it was read.

        Raises:
            InputError: it does not decode.
            CommunicationError: it is not what was asked for.
        """
        file, timestamp = self._folder / name, stamp[1] / 1e9
        read = read_raw(file) if file.suffix.lower() in RAW else read_picture(file)
        if self._stamp(name) != stamp:
            return None
        if isinstance(read, RawPicture):
            return taken_from(
                read, f"{self._who}: {name}", self.setup, self._keys.iso_at_gain_1, timestamp
            )
        if read.dtype.kind != "u":
            raise CommunicationError(
                f"{self._who}: {name} holds {read.dtype} numbers; whole ones of 8 or 16 bits"
                " are due"
            )
        pixel_format = f"Mono{self._keys.full_scale.bit_length()}"
        return Taken(
            read.astype(np.uint16), self.setup.exposure_s, self.setup.gain, timestamp, pixel_format
        )

    def _new(self) -> list[str]:
        """Names of the files not seen before, the oldest first."""
        times = {
            name: stamp[1]
            for name in self._files()
            if name not in self._known and (stamp := self._stamp(name))
        }
        return sorted(times, key=lambda name: (times[name], name))

    def _files(self) -> list[str]:
        try:
            names = [path.name for path in self._folder.iterdir()]
        except OSError as error:
            raise CommunicationError(
                f"{self._who}: the folder cannot be read ({reason(error)}); check path, network"
                " and card reader"
            ) from error
        return [
            name
            for name in names
            if not name.startswith(".") and Path(name).suffix.lower() in ENDINGS
        ]

    def _stamp(self, name: str) -> Stamp | None:
        try:
            status = (self._folder / name).stat()
        except OSError:
            return None
        return status.st_size, status.st_mtime_ns


def _number(name: str) -> int:
    """The number a name ends in before its dot; 0 without one."""
    found = re.search(r"(\d+)$", Path(name).stem)
    return int(found[1]) if found else 0


def open_camera(address: str, keys: FolderKeys, share: object) -> FolderCamera:
    """Watch a folder.

    Raises:
        DeviceError: limits that fall.
        CommunicationError: there is no such folder.
    """
    for what, (least, most) in (("exposures", keys.exposures), ("gains", keys.gains)):
        if least > most:
            raise DeviceError(
                f"camera: {what} run from {least:g} to {most:g}; the first must not be above the"
                " second"
            )
    return FolderCamera(Path(address), keys)

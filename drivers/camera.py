"""What a camera promises: armed, triggered, one frame or one error for every exposure, and the
facts of its noise.
"""

import logging
import math
import sys
import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from drivers.camera_commands import CameraCommands, Taken
from flflab.errors import CommunicationError, DeviceError, LimitError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

LOG = logging.getLogger(__name__)
LOOK_S = 0.005
NOISY_DN = 0.5  # from here on no two frames are alike


def nothing() -> None:
    """Nobody waits."""


@dataclass(frozen=True)
class Frame:
    """One picture as the sensor gave it.

    ``picture`` is [row, column] in DN: columns rise with world x, rows with world y. ``timestamp``
    is the camera's own clock, s since 1970. ``number`` rises by one with every exposure;
    ``dropped`` counts the exposures since the camera was opened that gave no frame.
    ``pixel_format`` is a name of GenICam's Pixel Format Naming Convention: ``Mono12``,
    ``BayerRG12``.
    """

    picture: "npt.NDArray[np.uint16]"
    exposure_s: float
    gain: float
    timestamp: float
    number: int
    dropped: int
    pixel_format: str = "Mono16"


class CameraDevice(Protocol):
    """What a procedure asks of a camera. The facts in DN are those at the gain last prepared."""

    name: str

    @property
    def full_scale(self) -> int:
        """What a saturated pixel reads, DN."""
        ...

    @property
    def dn_per_electron(self) -> float:
        """DN that an electron makes."""
        ...

    @property
    def read_noise_dn(self) -> float:
        """Standard deviation of a pixel in the dark, DN."""
        ...

    @property
    def offset_dn(self) -> float:
        """Mean of a pixel in the dark, DN."""
        ...

    @property
    def exposure_limits(self) -> tuple[float, float]:
        """Shortest and longest exposure, s."""
        ...

    @property
    def offered_exposures(self) -> tuple[float, ...]:
        """The only exposures there are, rising, s; empty where anything within the limits can be
        asked for.
        """
        ...

    def prepare(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure time in s and gain.

        Raises:
            LimitError: outside what the camera can do.
            CommunicationError: it does not answer.
        """
        ...

    def grab(self, exposed: Callable[[], None] = nothing) -> Frame:
        """Take one picture now; ``exposed`` is called as soon as its light is in, if that is known
        before it is there.

        Raises:
            CommunicationError: the frame came late, torn, lost or out of turn.
        """
        ...

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the camera tells."""
        ...

    def close(self) -> None:
        """Let go of the camera; raises nothing."""
        ...


class Camera:
    """A camera on the bench, whatever its protocol; satisfies ``CameraDevice``. One exposure at a
    time, from any thread.

    Args:
        name: the name on the bench.
        commands: what speaks to it.
        wait_until_ready: called before it is armed; returns once it can take a picture.

    Attributes:
        last: the last frame fetched; None before the first.
    """

    def __init__(
        self, name: str, commands: CameraCommands, wait_until_ready: Callable[[], None] = nothing
    ) -> None:
        self.name = name
        self._commands = commands
        self._wait_until_ready = wait_until_ready
        self._turn = threading.RLock()
        self._number = self._dropped = 0
        self._armed = self._exposing = False
        self._shape: tuple[int, ...] | None = None
        self._before: tuple[float, int] | None = None  # stamp and sum of the last frame
        self._said = set[str]()
        self.last: Frame | None = None

    @property
    def exposure_limits(self) -> tuple[float, float]:
        """Shortest and longest exposure, s."""
        return self._commands.exposure_limits

    @property
    def offered_exposures(self) -> tuple[float, ...]:
        """The only exposures there are, rising, s; empty where anything within the limits can be
        asked for.
        """
        return self._commands.offered_exposures

    @property
    def gain_limits(self) -> tuple[float, float]:
        """Least and largest gain, as a factor."""
        return self._commands.gain_limits

    @property
    def pixel_format(self) -> str:
        """By GenICam's naming convention; empty where only a frame tells."""
        return self._commands.setup.pixel_format

    @property
    def full_scale(self) -> int:
        """What a saturated pixel reads, DN."""
        return self._commands.setup.full_scale

    @property
    def dn_per_electron(self) -> float:
        """DN that an electron makes, at the gain prepared."""
        return self._commands.setup.dn_per_electron

    @property
    def read_noise_dn(self) -> float:
        """Standard deviation of a pixel in the dark, DN."""
        return self._commands.setup.read_noise_dn

    @property
    def offset_dn(self) -> float:
        """Mean of a pixel in the dark, DN."""
        return self._commands.setup.offset_dn

    @property
    def dropped(self) -> int:
        """How many exposures since it was opened gave no frame; each was told as an error."""
        return self._dropped

    def prepare(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure time in s and gain.

        Raises:
            LimitError: outside what the camera can do, or between what it offers; nothing is set.
            DeviceError: it did not become what was asked, an exposure is under way, or the camera
                does not answer.
        """
        for what, value, (least, most), unit in (
            ("exposure", exposure_s, self.exposure_limits, " s"),
            ("gain", gain, self.gain_limits, ""),
        ):
            if not math.isfinite(value) or not least <= value <= most:
                allowed = (
                    f"{least:g}{unit} to {most:g}{unit}"
                    if least < most
                    else f"{least:g}{unit} only"
                )
                raise LimitError(
                    f"{self.name}: asked for {what} {value:g}{unit}; allowed is {allowed}"
                )
        with self._turn:
            if self._exposing:
                raise DeviceError(
                    f"{self.name}: asked for exposure {exposure_s:g} s while a picture is under"
                    " way; fetch that one first"
                )
            self._commands.prepare(float(exposure_s), float(gain))

    def arm(self) -> None:
        """Make ready for a trigger.

        Raises:
            DeviceError: an exposure is under way, something came unasked, or the camera does not
                answer.
        """
        with self._turn:
            if self._exposing:
                raise DeviceError(
                    f"{self.name}: asked to arm while a picture is under way; fetch that one first"
                )
            self._wait_until_ready()
            self._guarded(self._commands.arm)
            self._armed = True

    def trigger(self) -> None:
        """Start one exposure.

        Raises:
            DeviceError: it is not armed, or does not take the trigger; no frame is due then.
        """
        with self._turn:
            if not self._armed:
                raise DeviceError(f"{self.name}: asked to expose before it was armed; arm it first")
            self._armed = False
            self._guarded(self._commands.trigger)
            self._number += 1
            self._exposing = True

    def fetch(self) -> Frame:
        """Wait for the frame of the last trigger.

        Raises:
            DeviceError: nothing was triggered.
            CommunicationError: the frame came late, torn, lost, or is not the one asked for; it
                counts as dropped.
        """
        with self._turn:
            if not self._exposing:
                raise DeviceError(
                    f"{self.name}: asked for a frame with no exposure under way; arm and trigger"
                    " first"
                )
            self._exposing = False
            try:
                taken = self._guarded(self._commands.fetch)
                self._check(taken)
                self._remark(taken)
            except BaseException:
                self._dropped += 1
                raise
            self.last = Frame(
                taken.picture,
                taken.exposure_s,
                taken.gain,
                taken.timestamp,
                self._number,
                self._dropped,
                taken.pixel_format,
            )
            return self.last

    def grab(self, exposed: Callable[[], None] = nothing) -> Frame:
        """Take one picture now: arm, trigger, fetch; ``exposed`` is called once its light is in,
        where the camera can tell.
        """
        with self._turn:
            self.arm()
            self.trigger()
            try:
                if exposed is not nothing:
                    while exposing := self._guarded(self._commands.exposing):
                        time.sleep(LOOK_S)
                    if exposing is False:
                        exposed()
            except BaseException:  # nobody fetches this one any more
                self._exposing = False
                self._dropped += 1
                raise
            return self.fetch()

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the camera tells."""
        with self._turn:
            return self._commands.identity()

    def close(self) -> None:
        """Let go of the camera; raises nothing."""
        self._commands.close()

    def _guarded(self, command: Callable[[], Any]) -> Any:
        try:
            return command()
        except BaseException:  # Ctrl-C too: nobody fetches what is under way then
            self._commands.reset()
            raise

    def _check(self, taken: Taken) -> None:
        """A picture of another size or beyond full scale means that somebody else has set the
        camera up.

        Raises:
            CommunicationError: it is such a one.
        """
        shape, most = taken.picture.shape, int(taken.picture.max(initial=0))
        if self._shape not in (None, shape) or len(shape) != 2 or most > self.full_scale:
            self._commands.reset()
            before = self._shape and f"{self._shape[1]} x {self._shape[0]} pixels"
            raise CommunicationError(
                f"{self.name}: the frame has {' x '.join(map(str, reversed(shape)))} pixels up to"
                f" {most} DN where {before or 'rows and columns'} up to {self.full_scale} DN are"
                " due; see who else sets the camera up, then take it again"
            )
        self._shape = shape

    def _remark(self, taken: Taken) -> None:
        """Say, once each, what no camera in order does: pixels that are those of the frame before,
        noise and all, and a clock that goes back.
        """
        import numpy as np  # who only moves a stage does not wait for it

        pixels = np.ascontiguousarray(taken.picture)
        now = taken.timestamp, zlib.crc32(pixels.data)
        before, self._before = self._before, now
        if before is None:
            return
        noisy = self.read_noise_dn >= NOISY_DN and pixels.min() < pixels.max()
        for holds, words in (
            (
                noisy and before[1] == now[1],
                "the frame has the pixels of the one before, noise and all, under a new number; see"
                " whether the camera sends an old picture",
            ),
            (
                now[0] < before[0],
                f"its clock went back by {before[0] - now[0]:.3g} s between two frames; see what"
                " sets it",
            ),
        ):
            if holds and words.partition(" ")[0] not in self._said:
                self._said.add(words.partition(" ")[0])
                LOG.info("%s: frame %d: %s", self.name, self._number, words)
                sys.stderr.write(f"flflab: {self.name}: frame {self._number}: {words}\n")

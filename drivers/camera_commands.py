"""What a camera driver provides: the few commands that ``Camera`` is made from, what they deliver,
and the keys most drivers share.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Protocol

from pydantic import Field

from flflab.description import Description

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


@dataclass(frozen=True)
class Setup:
    """What a camera is set to, and what its numbers then mean; ``pixel_format`` is empty where only
    a frame tells.
    """

    exposure_s: float
    gain: float
    pixel_format: str
    full_scale: int
    offset_dn: float
    dn_per_electron: float
    read_noise_dn: float


@dataclass(frozen=True)
class Taken:
    """A picture as a driver delivers it; see ``Frame``."""

    picture: "npt.NDArray[np.uint16]"
    exposure_s: float
    gain: float
    timestamp: float
    pixel_format: str


class CameraCommands(Protocol):
    """One camera as its protocol has it; every method may raise CommunicationError, or DeviceError
    where the camera refuses.
    """

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

    @property
    def gain_limits(self) -> tuple[float, float]:
        """Least and largest gain, as a factor."""
        ...

    @property
    def setup(self) -> Setup:
        """What it is set to now, as it said itself where it can be asked."""
        ...

    def prepare(self, exposure_s: float, gain: float) -> None:
        """Set both, within the limits, and read back.

        Raises:
            LimitError: the camera offers only certain values, and this is none of them.
            DeviceError: it did not become what was asked.
        """
        ...

    def arm(self) -> None:
        """Make ready, so that the next frame is the one triggered next; what came unasked since
        then is not taken for it.
        """
        ...

    def trigger(self) -> None:
        """Start one exposure."""
        ...

    def exposing(self) -> bool | None:
        """Whether the light of the last trigger is still being collected; None where only its
        picture can tell.
        """
        ...

    def fetch(self) -> Taken:
        """Wait for the picture of the last trigger.

        Raises:
            CommunicationError: it came late, torn, not at all, or is not the one asked for.
        """
        ...

    def reset(self) -> None:
        """After a fault: give up what is under way, so that ``arm`` begins anew; raises nothing."""
        ...

    def identity(self) -> str:
        """Maker, model, serial number and firmware as far as the camera tells."""
        ...

    def close(self) -> None:
        """Let go of the camera; raises nothing."""
        ...


class SensorKeys(Description):
    """What a camera does not tell of its sensor, for the bench file; numbers at gain 1, from its
    data sheet or a photon transfer curve.
    """

    black_level: Annotated[float, Field(ge=0)]
    electrons_per_dn: Annotated[float, Field(gt=0)]
    read_noise_electrons: Annotated[float, Field(ge=0)]

    def setup(self, exposure_s: float, gain: float, pixel_format: str, full_scale: int) -> Setup:
        """What a camera set so makes of light."""
        per_electron = gain / self.electrons_per_dn
        noise = self.read_noise_electrons * per_electron
        return Setup(
            exposure_s, gain, pixel_format, full_scale, self.black_level, per_electron, noise
        )

"""A recorded frame with the bench when it was taken, and what its frames gave so far."""

from dataclasses import dataclass
from typing import Literal

from flflab.bench import Element

Status = Literal["admitted", "diagnostic", "unvalidated"]


@dataclass(frozen=True)
class Validity:
    """What a frame may be used for.

    Attributes:
        status: verdicts use ``admitted`` frames only.
        reason: why it is not admitted; empty where it is.
    """

    status: Status
    reason: str = ""

    @property
    def admitted(self) -> bool:
        """Whether verdicts use the frame."""
        return self.status == "admitted"


ADMITTED = Validity("admitted")


@dataclass(frozen=True)
class FrameRecord:
    """One recorded frame and the bench when it was taken.

    Attributes:
        key: the point's, each once in a run: ``c3/bars/0`` is the first bars frame of configuration
            3, ``dark/0.01s/0`` a dark one.
        configuration: index of the study's configuration; None for a dark frame.
        target: name of the target in place.
        repeat: counts the frames of one target in one configuration.
        f_number: by the iris's reading.
        readings: of all axes, mm or rad.
        worlds: world z in mm of main lens, array, sensor and target, by those readings; without
            what nobody knows the place of.
        exposure_s: as the camera says.
        gain: factor.
        saturated: number of pixels at full scale.
        number: the camera's own count of exposures.
        index: place in frames.h5.
        time: s since 1970, this computer's clock.
        crc32: of its pixels (see ``checksum``); empty in records without.
        note: what whoever took it wrote to it.
        moved: by how many of its steps an axis moved during the exposure, the largest; None where
            nobody looked.
        temperature: of the bench, degC; None where it was not recorded.
        validity: whether verdicts use it, and why not.
    """

    key: str
    configuration: int | None
    target: str
    repeat: int
    f_number: float
    readings: dict[str, float]
    worlds: dict[Element, float]
    exposure_s: float
    gain: float
    saturated: int
    number: int
    index: int
    time: float
    crc32: str = ""
    note: str = ""
    moved: float | None = None
    temperature: float | None = None
    validity: Validity = ADMITTED

    @property
    def distance(self) -> float:
        """Main lens to target, mm, positive in front."""
        return self.worlds["main_lens.z"] - self.worlds["target.z"]

    @property
    def array(self) -> float:
        """Main lens to array, mm."""
        return self.worlds["array.z"] - self.worlds["main_lens.z"]

    @property
    def sensor(self) -> float:
        """Main lens to sensor, mm."""
        return self.worlds["sensor.z"] - self.worlds["main_lens.z"]


@dataclass(frozen=True)
class AccuracyRecord:
    """What the frames of a point gave so far, where a study asks for an accuracy.

    Attributes:
        configuration: index of the study's configuration.
        frames: how many frames of the bars there were.
        mtf_standard_uncertainty: of the MTF measured in their mean, the largest over its
            frequencies.
        enough: whether that is what the study asks for.
        time: s since 1970, this computer's clock.
    """

    configuration: int
    frames: int
    mtf_standard_uncertainty: float
    enough: bool
    time: float

"""Natural fall-off: a ray that meets the sensor at an angle theta from the normal brings cos^4(theta) of its paraxial light."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Falloff:
    """It has no number of its own: the angles follow from the camera."""

    name: ClassVar[str] = "falloff"

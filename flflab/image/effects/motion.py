"""Motion during the exposure: the target moves evenly, or trembles, while light is gathered."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError


@dataclass(frozen=True)
class Motion:
    """What every target does during the exposure, across the axis, mm.

    ``drift`` (x, y) is the whole even way, half of it before the middle of the exposure; ``vibration`` (x, y) is the amplitude of a
    sine of many periods.
    """

    drift: tuple[float, float] = (0.0, 0.0)
    vibration: tuple[float, float] = (0.0, 0.0)
    name: ClassVar[str] = "motion"

    def __post_init__(self) -> None:
        """Refuse what is no motion.

        Raises:
            InputError: a length is not finite.
        """
        if not all(math.isfinite(length) for length in (*self.drift, *self.vibration)):
            raise InputError(f"motion: drift is {self.drift} mm and vibration {self.vibration} mm; finite lengths are due")

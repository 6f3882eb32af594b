"""Diffraction: light of one wavelength bends round the edges of the clipped pupil."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError


@dataclass(frozen=True)
class Diffraction:
    """Light of one ``wavelength``, mm."""

    wavelength: float = 550e-6
    name: ClassVar[str] = "diffraction"

    def __post_init__(self) -> None:
        """Refuse what is no wavelength.

        Raises:
            InputError: it is not a finite number above 0.
        """
        if not (math.isfinite(self.wavelength) and self.wavelength > 0):
            raise InputError(f"diffraction: wavelength is {self.wavelength:g} mm; a finite number above 0 is due")

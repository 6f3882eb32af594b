"""Distortion of the main lens: what is seen under a paraxial slope lies under another one."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError


@dataclass(frozen=True)
class Distortion:
    """A ray whose paraxial object point is o (mm, at distance D) comes from o (1 + coefficient |o / D|^2).

    A positive ``coefficient`` (1/rad^2) is a barrel: the border of the picture sees more than it should.
    """

    coefficient: float
    name: ClassVar[str] = "distortion"

    def __post_init__(self) -> None:
        """Refuse what is no coefficient.

        Raises:
            InputError: it is not finite.
        """
        if not math.isfinite(self.coefficient):
            raise InputError(f"distortion: coefficient is {self.coefficient:g} 1/rad^2; a finite number is due")

"""Shading: the main lens brings less light towards the corners of the sensor."""

from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Shading:
    """Light falls by ``corner``, a share, from the sensor's middle to its corner, with the square
    of the distance.
    """

    corner: float
    name: ClassVar[str] = "shading"
    unit: ClassVar[str] = "of light"

    def __post_init__(self) -> None:
        """Refuse what is no share.

        Raises:
            InputError: it is not from 0 to 1.
        """
        if not 0 <= self.corner <= 1:
            raise InputError(f"shading: corner is {self.corner:g}; from 0 to 1 is allowed")

    def size(self, regime: Regime) -> float:
        """What the corner loses."""
        return self.corner

    def bound(self, regime: Regime) -> float:
        """No pixel loses more than the corner's share of the brightest light."""
        return self.corner * regime.brightest

    def cost(self, regime: Regime) -> float:
        """One product a pixel."""
        return 2e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """Where the light is lost."""
        return f"the sensor's corners get {100 * self.corner:.3g} % less light"

"""Stray light: a share of all light that is spread evenly over the sensor (veiling glare)."""

from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
from flflab.image.regime import Regime


@dataclass(frozen=True)
class StrayLight:
    """``share`` of the light of every pixel goes evenly to all."""

    share: float
    name: ClassVar[str] = "stray-light"
    unit: ClassVar[str] = "of light"

    def __post_init__(self) -> None:
        """Refuse what is no share.

        Raises:
            InputError: it is not from 0 to 1.
        """
        if not 0 <= self.share <= 1:
            raise InputError(f"stray light: share is {self.share:g}; from 0 to 1 is allowed")

    def size(self, regime: Regime) -> float:
        """Its share."""
        return self.share

    def bound(self, regime: Regime) -> float:
        """No pixel loses or gains more than this share of the brightest light."""
        return self.share * regime.brightest

    def cost(self, regime: Regime) -> float:
        """One sum over the picture."""
        return 2e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """Where the light goes."""
        return f"{self.share:.3g} of all light is spread over the sensor"

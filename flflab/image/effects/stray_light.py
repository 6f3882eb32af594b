"""Stray light: a share of all light that is spread evenly over the sensor (veiling glare)."""

from dataclasses import dataclass
from typing import ClassVar

from flflab.image.effects.effect import Array, Formed, require
from flflab.image.regime import Regime


@dataclass(frozen=True)
class StrayLight:
    """``share`` of the light of every pixel goes evenly to all."""

    share: float
    name: ClassVar[str] = "stray-light"
    unit: ClassVar[str] = "of light"

    def __post_init__(self) -> None:
        """The share lies between 0 and 1.

        Raises:
            InputError: it is not.
        """
        require(self.name, "share", self.share, most=1)

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

    def apply(self, image: Array, formed: Formed) -> None:
        """Take the share, and add its mean everywhere."""
        mean = float(image.mean())
        image *= 1 - self.share
        image += self.share * mean

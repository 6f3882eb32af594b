"""Stray light: a share of all light that is spread evenly over the sensor (veiling glare)."""

from dataclasses import dataclass

from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class StrayLight(Finishing):
    """``share`` of the light of every pixel goes evenly to all."""

    share: float = parameter(most=1)
    name = "stray-light"
    unit = "of light"
    pixel_ns = 2  # one sum over the picture

    def why(self, regime: Regime) -> str:
        """Where the light goes."""
        return f"{self.share:.3g} of all light is spread over the sensor"

    def apply(self, image: Array, formed: Formed) -> None:
        """Take the share, and add its mean everywhere."""
        mean = float(image.mean())
        image *= 1 - self.share
        image += self.share * mean

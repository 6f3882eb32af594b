"""Halo: a share of the light of every point lands in a wide spot round it (scatter in glass and
cover).
"""

from dataclasses import dataclass

from scipy.ndimage import gaussian_filter

from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Halo(Finishing):
    """``share`` of the light is spread as a Gaussian of the standard deviation ``radius``, mm on
    the sensor.
    """

    share: float = parameter(most=1)
    radius: float = parameter(unit="mm", above=0)
    name = "halo"
    unit = "of light"
    pixel_ns = 100  # two passes of a filter

    def why(self, regime: Regime) -> str:
        """How far the light goes."""
        return f"{self.share:.3g} of all light lands {1e3 * self.radius:.3g} um aside"

    def apply(self, image: Array, formed: Formed) -> None:
        """Take the share, and add it where it is spread to."""
        radius = self.radius / formed.camera.sensor.pixel
        image += self.share * (gaussian_filter(image, radius, mode="constant") - image)

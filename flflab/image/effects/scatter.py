"""Scatter of the microlenses: every one has a focal length, a place and a brightness of its own."""

from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Scatter(Effect):
    """Independent normal errors of every microlens, drawn once from a ``seed``.

    ``focal_length`` is the standard deviation relative to the focal length, ``position`` that of
    each coordinate of a lens with its aperture, mm, ``brightness`` that of the light relative to
    the mean, ``aperture_decentre`` that of each coordinate of an aperture against its lens, mm.
    """

    focal_length: float = parameter(0.0, most=0.1, unit="of the focal length")
    position: float = parameter(0.0, unit="mm")
    seed: int = parameter(0)
    brightness: float = parameter(0.0, most=0.2, unit="of the light")
    aperture_decentre: float = parameter(0.0, unit="mm")
    name = "scatter"
    unit = "px"

    def size(self, regime: Regime) -> float:
        """How far rims move at most."""
        return regime.scattered.rim

    def bound(self, regime: Regime) -> float:
        """What the farthest errors change."""
        return regime.changed(regime.scattered)

    def cost(self, regime: Regime) -> float:
        """A table of shares for every microlens."""
        return 0.02 * regime.microlenses

    def why(self, regime: Regime) -> str:
        """Of what."""
        return (
            f"focal lengths scatter by {100 * self.focal_length:.2g} %, places by"
            f" {1e3 * self.position:.2g} um, apertures by {1e3 * self.aperture_decentre:.2g} um,"
            f" brightness by {100 * self.brightness:.2g} %"
        )

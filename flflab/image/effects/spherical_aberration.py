"""Spherical aberration of the microlenses: a ray through a microlens's rim does not land where one
through its middle does.
"""

import math
from dataclasses import dataclass

from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime

MEAN_REACH = 4 / (5 * math.pi)  # mean of |x| r^2 over the unit disc


@dataclass(frozen=True)
class SphericalAberration(Effect):
    """A ray through the place p of a microlens, in radii of its aperture from its centre, lands
    ``marginal`` |p|^2 p (mm on the sensor) aside of where it does by first order. Vignetting stays.
    """

    marginal: float = parameter(unit="mm", least=-math.inf)
    name = "spherical-aberration"
    unit = "px"
    lit_ns = 350  # rays

    def size(self, regime: Regime) -> float:
        """How far aside the ray through the rim lands."""
        return abs(self.marginal) / regime.pixel

    def bound(self, regime: Regime) -> float:
        """A ray is off its place by the mean way, along x and along y; the pixel alone limits what
        that changes.
        """
        off = regime.light * MEAN_REACH * self.size(regime)
        return sum(min(plane.contrast, off * (1 if plane.plain else 2)) for plane in regime.planes)

    def why(self, regime: Regime) -> str:
        """How far."""
        return f"rays through a microlens's rim land {1e3 * self.marginal:.3g} um aside"

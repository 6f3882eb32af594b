"""Scatter of the microlenses: every one has a focal length, a place and a brightness of its own."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Scatter:
    """Independent normal errors of every microlens, drawn once from a ``seed``.

    ``focal_length`` is the standard deviation relative to the focal length, ``position`` that of
    each coordinate of a lens with its aperture, mm, ``brightness`` that of the light relative to
    the mean, ``aperture_decentre`` that of each coordinate of an aperture against its lens, mm.
    """

    focal_length: float = 0.0
    position: float = 0.0
    seed: int = 0
    brightness: float = 0.0
    aperture_decentre: float = 0.0
    name: ClassVar[str] = "scatter"
    unit: ClassVar[str] = "px"

    def __post_init__(self) -> None:
        """Refuse what is no scatter.

        Raises:
            InputError: a number is negative or not finite, or so large that microlenses turn into
                others.
        """
        if not (math.isfinite(self.focal_length) and 0 <= self.focal_length <= 0.1):
            raise InputError(
                f"scatter: focal_length is {self.focal_length:g} of the focal length; from 0 to 0.1"
                " is allowed"
            )
        if not (math.isfinite(self.brightness) and 0 <= self.brightness <= 0.2):
            raise InputError(
                f"scatter: brightness is {self.brightness:g} of the light; from 0 to 0.2 is allowed"
            )
        for name in ("position", "aperture_decentre"):
            length = getattr(self, name)
            if not (math.isfinite(length) and length >= 0):
                raise InputError(
                    f"scatter: {name} is {length:g} mm; a finite number from 0 up is due"
                )

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

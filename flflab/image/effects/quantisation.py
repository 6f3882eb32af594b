"""Quantisation: what is read becomes whole numbers of some bits."""

import math
from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Quantisation:
    """Numbers (DN) of ``bits`` bits, ``dn_per_electron`` for each electron, above the ``offset_dn``
    that a dark pixel reads.
    """

    bits: int = 12
    dn_per_electron: float = 0.4
    offset_dn: float = 64.0
    name: ClassVar[str] = "quantisation"
    unit: ClassVar[str] = "of white"

    def __post_init__(self) -> None:
        """Refuse what makes no numbers.

        Raises:
            InputError: a number is not finite or outside what is allowed.
        """
        if not 1 <= self.bits <= 16:
            raise InputError(f"quantisation: bits is {self.bits}; from 1 to 16 are allowed")
        if not (math.isfinite(self.dn_per_electron) and self.dn_per_electron > 0):
            raise InputError(
                f"quantisation: dn_per_electron is {self.dn_per_electron:g} DN/electron; a finite"
                " number above 0 is due"
            )
        if not 0 <= self.offset_dn < self.full_scale:
            raise InputError(
                f"quantisation: offset_dn is {self.offset_dn:g} DN; from 0 to below"
                f" {self.full_scale}, full scale, is allowed"
            )

    @property
    def full_scale(self) -> int:
        """The largest number."""
        return 2**self.bits - 1

    def size(self, regime: Regime) -> float:
        """One number."""
        return 1 / (self.dn_per_electron * regime.electrons) if regime.electrons > 0 else math.inf

    def bound(self, regime: Regime) -> float:
        """Half a number, or what the largest number cuts off the brightest light."""
        largest = (self.full_scale - self.offset_dn) * self.size(regime)
        return max(self.size(regime) / 2, regime.brightest - largest)

    def cost(self, regime: Regime) -> float:
        """Rounding."""
        return 1e-6 * regime.pixels

    def why(self, regime: Regime) -> str:
        """How fine the numbers are."""
        return f"{self.bits} bits, {1 / self.dn_per_electron:.3g} electrons to a number"

"""Quantisation: what is read becomes whole numbers of some bits."""

from dataclasses import dataclass

from flflab.errors import InputError
from flflab.image.effects.effect import Effect, parameter
from flflab.image.regime import Regime


@dataclass(frozen=True)
class Quantisation(Effect):
    """Numbers (DN) of ``bits`` bits, ``dn_per_electron`` for each electron, above the ``offset_dn``
    that a dark pixel reads.
    """

    bits: int = parameter(12, least=1, most=16)
    dn_per_electron: float = parameter(0.4, unit="DN/electron", above=0)
    offset_dn: float = parameter(64.0, unit="DN")
    name = "quantisation"
    unit = "of white"
    pixel_ns = 1  # rounding

    def __post_init__(self) -> None:
        """Refuse what makes no numbers.

        Raises:
            InputError: a number is not finite or outside what is allowed.
        """
        super().__post_init__()
        if self.offset_dn >= self.full_scale:
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
        return regime.of_white(1 / self.dn_per_electron)

    def bound(self, regime: Regime) -> float:
        """Half a number, or what the largest number cuts off the brightest light."""
        largest = (self.full_scale - self.offset_dn) * self.size(regime)
        return max(self.size(regime) / 2, regime.brightest - largest)

    def why(self, regime: Regime) -> str:
        """How fine the numbers are."""
        return f"{self.bits} bits, {1 / self.dn_per_electron:.3g} electrons to a number"

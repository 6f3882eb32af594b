"""Stray light: a share of all light that is spread evenly over the sensor (veiling glare)."""

from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError


@dataclass(frozen=True)
class StrayLight:
    """``share`` of the light of every pixel goes evenly to all."""

    share: float
    name: ClassVar[str] = "stray-light"

    def __post_init__(self) -> None:
        """Refuse what is no share.

        Raises:
            InputError: it is not from 0 to 1.
        """
        if not 0 <= self.share <= 1:
            raise InputError(f"stray light: share is {self.share:g}; from 0 to 1 is allowed")

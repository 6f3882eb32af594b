"""Colour filter array: every pixel sees the light through the filter of its place in a mosaic of two by two."""

from dataclasses import dataclass
from typing import ClassVar

from flflab.errors import InputError

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")


@dataclass(frozen=True)
class ColourFilter:
    """``pattern`` names the filters of the pixels [0, 0], [0, 1], [1, 0], [1, 1]; transmissions count from the green one."""

    pattern: str = "rggb"
    red: float = 0.6
    green: float = 1.0
    blue: float = 0.5
    name: ClassVar[str] = "colour-filter"

    def __post_init__(self) -> None:
        """Refuse what is no mosaic.

        Raises:
            InputError: an unknown pattern, or a transmission that is not from 0 to 1.
        """
        if self.pattern not in PATTERNS:
            raise InputError(f"colour filter: there is no pattern {self.pattern!r}; allowed: {', '.join(PATTERNS)}")
        for colour in ("red", "green", "blue"):
            share = getattr(self, colour)
            if not 0 <= share <= 1:
                raise InputError(f"colour filter: {colour} is {share:g}; a transmission from 0 to 1 is allowed")

"""Colour filter array: every pixel sees the light through the filter of its place in a mosaic of
two by two.
"""

from dataclasses import dataclass

import numpy as np

from flflab.errors import InputError
from flflab.image.effects.effect import Array, Finishing, Formed, parameter
from flflab.image.regime import Regime

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")


@dataclass(frozen=True)
class ColourFilter(Finishing):
    """``pattern`` names the filters of the pixels [0, 0], [0, 1], [1, 0], [1, 1]; transmissions
    count from the green one.
    """

    pattern: str = "rggb"
    red: float = parameter(0.6, most=1)
    green: float = parameter(1.0, most=1)
    blue: float = parameter(0.5, most=1)
    name = "colour-filter"
    unit = "of light"
    pixel_ns = 2  # one multiplication a pixel

    def __post_init__(self) -> None:
        """Refuse what is no mosaic.

        Raises:
            InputError: an unknown pattern, or a transmission that is not from 0 to 1.
        """
        if self.pattern not in PATTERNS:
            raise InputError(
                f"colour filter: there is no pattern {self.pattern!r}; allowed:"
                f" {', '.join(PATTERNS)}"
            )
        super().__post_init__()

    def size(self, regime: Regime) -> float:
        """What the densest filter takes."""
        return 1 - min(self.red, self.green, self.blue)

    def why(self, regime: Regime) -> str:
        """The mosaic."""
        return f"mosaic {self.pattern} of {self.red:g}, {self.green:g}, {self.blue:g}"

    def apply(self, image: Array, formed: Formed) -> None:
        """Multiply every pixel by what its filter lets through."""
        by_letter = {"r": self.red, "g": self.green, "b": self.blue}
        tile = np.array([by_letter[letter] for letter in self.pattern]).reshape(2, 2)
        rows, columns = image.shape
        image *= tile[np.ix_(np.arange(rows) % 2, np.arange(columns) % 2)]

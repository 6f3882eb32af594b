"""Random numbers for rectangles of pixels of a sensor: a pixel's numbers depend on the key and on
its row and column, on nothing else.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.sensor.random_numbers import Bits, Key, draw_bits, normals, poissons

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Draws:
    """What was drawn for each pixel [row, column] under a key: two independent streams of 64 bits.

    Attributes:
        key: what was drawn under.
        corner: row and column on the sensor of the pixel [0, 0].
        first: bits of stream 0.
        second: bits of stream 1.
    """

    key: Key
    corner: tuple[int, int]
    first: Bits
    second: Bits

    def normal(self, stream: int) -> Array:
        """Standard normal numbers of a stream."""
        out = np.empty(self.first.shape)
        normals(self.second if stream else self.first, stream, self.corner, self.key, out)
        return out

    def poisson(self, means: Array) -> Array:
        """Poisson numbers of these means, of stream 0."""
        out = np.empty(self.first.shape)
        poissons(means, self.first, self.corner, self.key, out)
        return out

    def chosen(self, share: float) -> npt.NDArray[np.bool_]:
        """Whether a pixel is among this share of all, by stream 0."""
        return (self.first >> np.uint64(11)).astype(np.float64) < share * 2.0**53

    def exponential(self) -> Array:
        """Exponential numbers of mean 1, of stream 1."""
        return -np.log(1 - (self.second >> np.uint64(11)).astype(np.float64) * 2.0**-53)

    @property
    def coin(self) -> npt.NDArray[np.bool_]:
        """A toss of a coin, by stream 1."""
        return (self.second & np.uint64(1)).astype(np.bool_)


def draw(shape: tuple[int, int], corner: tuple[int, int], key: Key) -> Draws:
    """Draw for the pixels of a rectangle (rows, columns) with its corner at a row and column of the
    sensor.
    """
    first, second = np.empty(shape, dtype=np.uint64), np.empty(shape, dtype=np.uint64)
    draw_bits(corner, key, first, second)
    return Draws(key, corner, first, second)

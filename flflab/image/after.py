"""What multiplies or blurs a finished picture, in the order of the light: stray light, filters."""

import numpy as np
import numpy.typing as npt

from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.scene import Scene

Array = npt.NDArray[np.float64]


def finish(image: Array, scene: Scene) -> None:
    """Apply a scene's effects to its picture, in place."""
    if scene.stray_light is not None:
        share, mean = scene.stray_light.share, float(image.mean())
        image *= 1 - share
        image += share * mean
    if scene.colour_filter is not None:
        image *= transmissions(scene.colour_filter, image.shape)


def transmissions(mosaic: ColourFilter, shape: tuple[int, ...]) -> Array:
    """How much of the light the filter of each pixel lets through, [row, column]."""
    by_letter = {"r": mosaic.red, "g": mosaic.green, "b": mosaic.blue}
    tile = np.array([by_letter[letter] for letter in mosaic.pattern]).reshape(2, 2)
    rows, columns = shape
    return tile[np.ix_(np.arange(rows) % 2, np.arange(columns) % 2)]

"""What multiplies or blurs a finished picture, in the order of the light: shading, halo, stray
light, filters, gamma.
"""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from flflab.image.effects.colour_filter import ColourFilter
from flflab.image.effects.shading import Shading
from flflab.image.scene import Scene

Array = npt.NDArray[np.float64]


def finish(image: Array, scene: Scene) -> None:
    """Apply a scene's effects to its picture, in place."""
    pixel = scene.camera.sensor.pixel
    if scene.shading is not None:
        image *= shade(scene.shading, image.shape)
    if scene.halo is not None:
        spread = gaussian_filter(image, scene.halo.radius / pixel, mode="constant")
        image += scene.halo.share * (spread - image)
    if scene.stray_light is not None:
        share, mean = scene.stray_light.share, float(image.mean())
        image *= 1 - share
        image += share * mean
    if scene.colour_filter is not None:
        image *= transmissions(scene.colour_filter, image.shape)
    if scene.gamma is not None:
        np.power(np.maximum(image, 0.0), scene.gamma.exponent, out=image)


def shade(shading: Shading, shape: tuple[int, ...]) -> Array:
    """How much of the light each pixel gets, [row, column]: 1 - corner (r / R)^2, R the distance
    from the sensor's middle to the middle of its corner pixel.
    """
    rows, columns = (np.arange(count) - (count - 1) / 2 for count in shape)
    farthest = max(float(rows[-1] ** 2 + columns[-1] ** 2), 1e-300)
    return 1 - shading.corner * (rows[:, None] ** 2 + columns[None] ** 2) / farthest


def transmissions(mosaic: ColourFilter, shape: tuple[int, ...]) -> Array:
    """How much of the light the filter of each pixel lets through, [row, column]."""
    by_letter = {"r": mosaic.red, "g": mosaic.green, "b": mosaic.blue}
    tile = np.array([by_letter[letter] for letter in mosaic.pattern]).reshape(2, 2)
    rows, columns = shape
    return tile[np.ix_(np.arange(rows) % 2, np.arange(columns) % 2)]

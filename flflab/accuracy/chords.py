"""A reference for charts of sines: chords of the two apertures in closed form, a dense sum over the
two coordinates that are left.

The chart varies along x only, so at one x on the sensor and one x on the microlens all light is the
same, and how much of it there is is the length that two chords have in common, averaged over the
pixel's height: a sum of squares. ``render`` goes the other way round (exact along x, strips along
y) and shares no code with it. Source: physics.md, "Exact image of a flat target".
"""

import math

import numpy as np
import numpy.typing as npt

from flflab.accuracy.ray_sums import Geometry, chart_geometry
from flflab.image.scene import Scene

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

ACROSS_LENS, ACROSS_PIXEL = 2048, 16  # nodes; the uncertainty is the difference to half as many


def integrate_pixels(scene: Scene, pixels: Whole) -> tuple[Array, Array]:
    """Values of single pixels.

    Args:
        scene: a chart of sines before an aligned, ideal camera.
        pixels: (column, row) of each, shape (K, 2).

    Returns:
        Irradiance in units of the white level, and by how much it differs from the sum over half as
        many nodes, both of shape (K,).

    Raises:
        InputError: the scene has more than a chart of sines.
    """
    geometry = chart_geometry(scene, pixels)
    fine, coarse = (
        np.array(
            [
                _light(geometry, pair, ACROSS_LENS // part, ACROSS_PIXEL // part)
                for pair in geometry.pairs
            ]
        )
        for part in (1, 2)
    )
    values, halved = (
        np.bincount(geometry.pixel, light, minlength=len(pixels)) / geometry.white
        for light in (fine, coarse)
    )
    return values, np.abs(values - halved)


def _light(geometry: Geometry, pair: Array, across_lens: int, across_pixel: int) -> float:
    """Mean radiance over a pixel and a microlens, what the stop holds back counting as black.

    A ray through t on the microlens (from its centre) to e on the sensor (from the micro-image's)
    crosses the main lens at m = L/b (kappa t - e) and the target at D (m W - q/L), W = 1/D - 1/F +
    1/L.
    """
    depth, gap, radius, kappa = geometry.depth, geometry.gap, geometry.radius, geometry.kappa
    angle = math.pi * ((np.arange(across_lens) + 0.5) / across_lens - 0.5)
    t, share_t = radius * np.sin(angle), radius * np.cos(angle) * math.pi / across_lens
    node, weight = np.polynomial.legendre.leggauss(across_pixel)
    centre = pair[2:] * (1 + gap / depth)
    e = (pair[0] - centre[0] + geometry.pixel_width / 2 * node)[:, None]
    m = depth / gap * (kappa * t - e)
    vergence = 1 / geometry.distance - 1 / geometry.main_focal + 1 / depth
    landing = geometry.distance * (m * vergence - (pair[2] + t) / depth)
    own = radius * np.cos(angle)
    other = np.sqrt(np.maximum(geometry.stop**2 - m**2, 0.0)) * gap / (depth * abs(kappa))
    middle, half = (pair[1] - centre[1]) / kappa, geometry.pixel_width / (2 * abs(kappa))
    common = (_area(middle + half, own, other) - _area(middle - half, own, other)) / (2 * half)
    total = np.sum(weight[:, None] / 2 * share_t * common * geometry.chart.radiance(landing, 0.0))
    return float(total) / (math.pi * radius**2)


def _area(shift: float, one: Array, other: Array) -> Array:
    """Integral up to ``shift`` of the length that two intervals of these half widths have in
    common, their centres so far apart.
    """
    outer, inner = one + other, np.abs(one - other)
    ramps = (
        np.maximum(shift + sign * reach, 0.0) ** 2 * side
        for reach, side in ((outer, 1), (inner, -1))
        for sign in (1, -1)
    )
    return 0.5 * sum(ramps, np.zeros_like(outer))

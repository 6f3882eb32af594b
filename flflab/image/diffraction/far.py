"""Light that diffraction brings from far beyond a target's upper and lower border, in closed form.

A transfer function has a corner at no frequency, |f| in every direction, from which light comes
far; splines over frequencies round the corner off, and lose it. A Poisson kernel e/(2 pi (r^2 +
e^2)^(3/2)) has the transfer function exp(-2 pi e f), with a corner of its own: weighted so that
both are alike, what it makes of the target's mean light is added in closed form and taken off as
splines make it.
"""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from flflab.image.diffraction.ruled import Line

Array = npt.NDArray[np.float64]

SOFT = 8.0  # pixels, e: wide against a pixel


def poisson_weight(tail: float) -> float:
    """How much of the kernel has the corner of a transfer function whose line spread falls as
    ``tails`` of ``Modes`` over x^2.
    """
    return math.pi * tail / SOFT


def poisson_transfer(frequency: Array) -> Array:
    """The kernel's transfer function at frequencies in cycles/pixel."""
    return np.exp(-2 * math.pi * SOFT * frequency)


def mean_light(line: Line) -> Line:
    """The mean light of a line alone."""
    ruling = line.ruling
    steps = np.array([[ruling.start, ruling.end], [ruling.level, -ruling.level]])
    return replace(line, ruling=replace(ruling, steps=steps, points=np.zeros((2, 0))))


def poisson_light(line: Line, distance: Array) -> Array:
    """What the kernel brings of the lines' mean light from beyond a border, as spline coefficients.

    Over the quadrant u > a, v > b the kernel holds (pi/2 - atan(a/e) - atan(b/e) + atan(a b/(e
    sqrt(a^2 + b^2 + e^2))))/(2 pi).

    Args:
        line: the lines.
        distance: inside of the border, pixels, shape (Y,).

    Returns:
        Coefficients over the nodes of distance and the line's positions, shape (Y, X).
    """
    places, away = line.first + np.arange(line.count) / line.samples, distance[:, None]

    def up_to(end: float) -> Array:
        u = np.clip(end, -1e9, 1e9) - places
        return np.arctan(u / SOFT) - np.arctan(
            u * away / (SOFT * np.sqrt(u**2 + away**2 + SOFT**2))
        )

    light = line.ruling.level / (2 * math.pi) * (up_to(line.ends[1]) - up_to(line.ends[0]))
    return np.asarray(ndimage.spline_filter(light, mode="mirror"), dtype=np.float64)

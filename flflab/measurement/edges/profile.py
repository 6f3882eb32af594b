"""A straight edge seen by square pixels: its profile across the edge and the profile's derivatives,
in closed form.

With F2(t) = ((t^2 + s^2) Phi(t/s) + t s phi(t/s))/2, a and b the larger and the smaller of |cos|
and |sin| of the edge's angle, an edge blurred by a Gaussian of standard deviation s px and
integrated over a square pixel is E(t) = [F2(t + (a+b)/2) - F2(t + (a-b)/2) - F2(t - (a-b)/2) + F2(t
- (a+b)/2)]/(a b) at t px from the edge (measurement.md, 1.2). Its transfer function is exp(-2 pi^2
s^2 f^2) sinc(f a) sinc(f b).
"""

import math

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

Array = npt.NDArray[np.float64]

ALIGNED = 1e-4  # px, the least b: beside less the differences above drown in rounding


def _ladder(t: Array, blur: float) -> tuple[Array, Array, Array]:
    """F2 and its first two derivatives."""
    z = t / blur
    below, bell = ndtr(z), np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi)
    return (
        0.5 * ((t * t + blur * blur) * below + t * blur * bell),
        t * below + blur * bell,
        below,
    )


def pixel_sides(angle: float) -> tuple[float, float]:
    """Widths a >= b (px) of the two boxes whose product a square pixel is, seen along the edge's
    normal.
    """
    cos, sin = abs(math.cos(angle)), abs(math.sin(angle))
    return max(cos, sin), max(min(cos, sin), ALIGNED)


def edge_profile(t: Array, blur: float, angle: float) -> tuple[Array, Array, Array]:
    """The blurred edge E(t) from 0 to 1, its slope, and the slope's slope.

    By the equation of heat the last is twice the derivative by the blur's variance.

    Args:
        t: distance from the edge towards the bright side, px.
        blur: standard deviation of the Gaussian, px, above 0.
        angle: of the edge's normal, rad.
    """
    a, b = pixel_sides(angle)
    corners = [
        _ladder(t + at, blur) for at in ((a + b) / 2, (a - b) / 2, (b - a) / 2, -(a + b) / 2)
    ]
    value, slope, bend = (
        (corners[0][n] - corners[1][n] - corners[2][n] + corners[3][n]) / (a * b) for n in range(3)
    )
    return value, slope, bend


def pixel_transfer(cycles_per_px: Array, angle: float) -> Array:
    """sinc(f a) sinc(f b): what the pixel leaves of a wave across the edge."""
    a, b = pixel_sides(angle)
    return np.sinc(cycles_per_px * a) * np.sinc(cycles_per_px * b)

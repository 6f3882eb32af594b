"""Area common to two discs in plain numpy: the model's own path, without a compiler to start;
``discs`` is the kernels' one.

Lengths in any one unit. Every difference that vanishes at a tangency is formed first, with one
rounding, and everything after it only multiplies.
"""

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Array = npt.NDArray[np.float64]

_TERMS, _SERIES_UP_TO = 34, 0.35


def _series() -> Array:
    """Coefficients of (integral of sqrt(z (1 - z)) from 0 to z) / z^(3/2): (-1)^n binomial(1/2, n)
    / (n + 3/2), highest first.
    """
    factors = np.concatenate([[1.0], (np.arange(_TERMS - 1) - 0.5) / (np.arange(_TERMS - 1) + 1)])
    return (np.cumprod(factors) / (np.arange(_TERMS) + 1.5))[::-1]


def gap_of(a: Array, b: Array, c: Array) -> Array:
    """a + b - c with one rounding, by two-term sums."""
    total = a + b
    part = total - a
    lost = (a - (total - part)) + (b - part)
    rest = total - c
    part = rest - total
    lost = lost + ((total - (rest - part)) + (-c - part))
    return rest + lost


def segment_area(z: Array, complement: Array) -> Array:
    """Area of a circular segment of radius 1 and half angle a, a - sin a cos a, from z = sin^2(a/2)
    and 1 - z.

    The integral of 8 sqrt(z (1 - z)) from 0 to z; its series where the difference would cancel.
    """
    small, large = np.minimum(z, complement), np.maximum(z, complement)
    root, other = np.sqrt(small), np.sqrt(large)
    closed = 2 * np.arctan2(root, other) - 2 * root * other * (large - small)
    low = np.minimum(small, _SERIES_UP_TO)
    total = np.zeros_like(low)
    for coefficient in _series():
        total = total * low + coefficient
    area = np.where(small > _SERIES_UP_TO, closed, 8 * low * np.sqrt(low) * total)
    return np.where(z > complement, np.pi - area, area)


def common_area(radius1: npt.ArrayLike, radius2: npt.ArrayLike, distance: npt.ArrayLike) -> Array:
    """Area common to two closed discs of these radii whose centres lie ``distance`` apart, element
    by element of broadcast arrays.

    Good to 8 units of roundoff for every input, tangent, nested and unlike ones included.

    Raises:
        InputError: a radius or distance is negative or not finite.
    """
    given = np.broadcast_arrays(
        *(np.asarray(part, dtype=np.float64) for part in (radius1, radius2, distance))
    )
    for name, part in zip(("radius1", "radius2", "distance"), given, strict=True):
        wrong = ~((part >= 0) & np.isfinite(part))
        if np.any(wrong):
            raise InputError(
                f"common_area: {name} is {part[wrong].flat[0]:g}; a finite number from 0 up is due"
            )
    small, large, apart = np.minimum(given[0], given[1]), np.maximum(given[0], given[1]), given[2]
    between, beyond = gap_of(small, large, apart), gap_of(apart, small, large)
    crossing = (between > 0) & (beyond > 0)
    r, R, a, i, o = (
        np.where(crossing, part, 1.0) for part in (small, large, apart, between, beyond)
    )
    toward, whole = gap_of(a, R, r), a + (r + R)
    # Ratios first: no product of two lengths leaves the range of doubles.
    in_small = r * r * segment_area((toward / a) * (i / (4 * r)), (whole / r) * (o / (4 * a)))
    in_large = R * R * segment_area((o / a) * (i / (4 * R)), (whole / R) * (toward / (4 * a)))
    nested = np.pi * small * small
    return np.where(between <= 0, 0.0, np.where(beyond <= 0, nested, in_small + in_large))


def common_chord(radius1: Array, radius2: Array, distance: Array) -> Array:
    """Length of the chord between the points where two circles meet, 0 where they do not; arguments
    as in ``common_area``.
    """
    small, large = np.minimum(radius1, radius2), np.maximum(radius1, radius2)
    between, beyond = gap_of(small, large, distance), gap_of(distance, small, large)
    crossing = (between > 0) & (beyond > 0)
    a, i, o = (np.where(crossing, part, 1.0) for part in (distance, between, beyond))
    toward, whole = gap_of(a, large, small), a + (small + large)
    return np.where(crossing, np.sqrt(toward / a * i) * np.sqrt(whole / a * o), 0.0)

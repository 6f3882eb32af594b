"""Which part of the pupil lights a sensor point: the unit disc inside the shadow of the wider
aperture.
"""

import math

import numba

SLIVER = 1.0 - 1e-6  # of the way to the micro-image's rim; what lies further out looks from there


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lens_span(x: float, y: float, radius: float) -> tuple[float, float]:
    """Lowest and highest y common to the unit disc and a disc at (x, y) of a radius of at least 1
    that cuts it.
    """
    squared = x * x + y * y
    cut = radius * radius
    inverse = 1.0 / max(squared, 1e-30)
    along = 0.5 * (1.0 + squared - cut) * inverse
    across = abs(x) * math.sqrt(max(0.0, inverse - along * along))
    top = y + radius if x * x + (y + radius) ** 2 < 1.0 else along * y + across
    bottom = y - radius if x * x + (y - radius) ** 2 < 1.0 else along * y - across
    high = top if squared - 2.0 * y + 1.0 > cut else 1.0
    low = bottom if squared + 2.0 * y + 1.0 > cut else -1.0
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def clip(
    ex: float, ey: float, along_x: float, along_y: float, slope: float, reach: float
) -> tuple[float, float]:
    """Where the wider aperture's shadow lies over the pupil, seen from a sensor point (mm): along
    the strips and across them.

    A pixel whose centre is dark but whose edge is lit gets the last sliver of the pupil.
    """
    unslope = 1.0 / slope if slope != 0.0 else 0.0
    away = math.sqrt(ex * ex + ey * ey)
    inward = min(1.0, (reach + abs(slope)) * SLIVER / max(away, 1e-300)) * unslope
    return (along_x * ex + along_y * ey) * inward, (along_x * ey - along_y * ex) * inward

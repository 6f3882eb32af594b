"""Whether the way from a micro-image's centre to a footprint runs through a neighbour's light.

The way is the hull of the centre, (0, 0), and the footprint: all discs (squares) of size t margin
round t reach, with t from 0 to 1. Lengths in mm.
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def meets_disc(centre: Array, reach: Array, margin: Array, radius: Array) -> Flags:
    """Whether the hull of (0, 0) and the disc of radius ``margin`` round ``reach`` meets the open
    disc of this ``radius`` round ``centre``.

    The hull is all discs (t reach, t margin) with t from 0 to 1; the nearest of them touches the
    tangent from (0, 0).
    """
    length = np.hypot(reach[:, 0], reach[:, 1])
    some = np.maximum(length, np.finfo(np.float64).tiny)
    along = np.einsum("ij,ij->i", centre, reach) / some
    across = np.abs(centre[:, 0] * reach[:, 1] - centre[:, 1] * reach[:, 0]) / some
    tangent = np.sqrt(np.maximum(length - margin, 0.0)) * np.sqrt(length + margin)
    outside = tangent > 0
    bend = np.where(outside, across * margin / np.where(outside, tangent, 1.0), 0.0)
    part = np.where(outside, np.clip((along + bend) / some, 0.0, 1.0), 1.0)
    nearest = np.hypot(*(centre - part[:, None] * reach).T) - part * margin
    return nearest < radius


def meets_square(centre: Array, reach: Array, margin: Array, half: Array) -> Flags:
    """Whether the hull of (0, 0) and the square of half width ``margin`` round ``reach`` meets the
    open square of half width ``half`` round ``centre``.
    """
    enter, leave = way_in_square(centre, reach, margin, half)
    return enter < leave


def way_in_square(centre: Array, reach: Array, margin: Array, half: Array) -> tuple[Array, Array]:
    """From which t to which the squares (t reach, t margin) meet the open one, within 0 to 1; none
    where the first is not the smaller.
    """
    enter, leave = np.zeros(len(reach)), np.ones(len(reach))
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            # sign (centre - t reach) < half + t margin
            step = margin + sign * reach[:, axis]
            need = sign * centre[:, axis] - half
            with np.errstate(divide="ignore", invalid="ignore"):
                at = need / step
            enter = np.where(step > 0, np.maximum(enter, at), enter)
            leave = np.where(step < 0, np.minimum(leave, at), leave)
            leave = np.where((step == 0) & (need >= 0), -np.inf, leave)
    return enter, leave

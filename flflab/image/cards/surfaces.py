"""Microlenses and surfaces as the numbers by which kernels follow single rays."""

import numpy as np
import numpy.typing as npt

from flflab.image.cards.windows import Card
from flflab.image.geometry.pupil import Pupils
from flflab.image.geometry.rays import own_axes

Array = npt.NDArray[np.float64]


def lens_numbers(pupils: Pupils) -> Array:
    """The sensor side of N entries, shape (N, 15): centre, slope, reach, then by what rays are
    followed, level, slants.
    """
    return np.column_stack(
        [
            pupils.centre_x,
            pupils.centre_y,
            pupils.slope,
            pupils.reach,
            pupils.lens_spread,
            pupils.lens_scale,
            pupils.spread,
            pupils.scale,
            pupils.direction_x,
            pupils.direction_y,
            pupils.level,
            pupils.slant_x,
            pupils.slant_y,
            pupils.slant_scale,
            pupils.slant_spread,
        ]
    )


def surface_numbers(card: Card) -> Array:
    """A plane as numbers: distance, vergence, offset, tilt, own axes, half its card's size, whether
    rays must end on the card.
    """
    plane = card.plane
    size = card.size
    return np.array(
        [
            plane.distance,
            1 / plane.distance,
            *plane.offset,
            *plane.tilt,
            *own_axes(plane).ravel(),
            size[0] / 2,
            size[1] / 2,
            float(card.own),
        ]
    )

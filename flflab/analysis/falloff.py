"""How natural fall-off shades each micro-image within itself, as a measured lattice has it.

Steep rays bring less light, so a white target is darker on that side of a micro-image which lies away from the axis, by some per cent at
F/4. What is read there of bars and dots is shaded alike.
"""

import numpy as np
import numpy.typing as npt

from flflab.analysis.lattice import Lattice
from flflab.analysis.profile import FALLOFF, LOPSIDED, ORDERS, VALUE, profile_table

Array = npt.NDArray[np.float64]

LEAST_LIGHT = 1e-3  # of the middle's: what is darker than that is not shaded


def shade(lattice: Lattice, lens: npt.NDArray[np.int64], away_px: Array) -> Array:
    """What fall-off leaves of the light at places of micro-images, over what a picture without fall-off has there.

    Args:
        lattice: measured, or nominal: without a cone nothing is shaded.
        lens: position of each micro-image in the lattice, shape (n,).
        away_px: place from its centre, shape (n, 2).

    Returns:
        Shape (n,), 1 in the middle of a micro-image on the axis and beyond all micro-images.
    """
    if lattice.cone is None:
        return np.ones(len(lens))
    large, small = (lattice.outside_radius_px + lattice.inside_radius_px) / 2, (lattice.outside_radius_px - lattice.inside_radius_px) / 2
    share = float(lattice.slants[0])
    table = profile_table(large, max(0.05, small), lattice.cone, share)
    plain = table.values[:, VALUE] - share * table.values[:, FALLOFF]
    lit = plain > LEAST_LIGHT
    columns = [VALUE, LOPSIDED, *range(ORDERS.start, ORDERS.stop)]
    shades = np.where(lit[:, None], table.values[:, columns] / np.where(lit, plain, 1.0)[:, None], np.eye(len(columns))[0])
    distance = np.hypot(*away_px.T)
    nearest = np.minimum(np.rint(distance / table.step), len(plain) - 1).astype(np.int64)
    even, odd, steep, along_twice, steep_odd, along_thrice = shades[nearest].T
    slant = lattice.slants[1:3] + lattice.slants[3] * (lattice.centres_px - lattice.origin_px)[lens]
    along = (slant * away_px).sum(axis=1) / np.maximum(distance, 1e-9)
    return even + along * odd + (slant**2).sum(axis=1) * (steep + along * steep_odd) + along**2 * (along_twice + along * along_thrice)

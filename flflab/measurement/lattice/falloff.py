"""How natural fall-off shades each micro-image within itself, as a measured lattice has it.

Steep rays bring less light, so a white target is darker on that side of a micro-image which lies
away from the axis, by some per cent at F/4. What is read there of bars is shaded alike.
"""

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import FALLOFF, LOPSIDED, ORDERS, VALUE, profile_table

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

LEAST_LIGHT = 1e-3  # of the middle's: what is darker than that is not shaded


def shade(lattice: Lattice, lens: npt.NDArray[np.int64], away_px: Array) -> Array:
    """What fall-off leaves of the light at places of micro-images, over what a picture without
    fall-off has there.

    Args:
        lattice: measured, or nominal: without a cone nothing is shaded.
        lens: position of each micro-image in the lattice, shape (n,).
        away_px: place from its centre, shape (n, 2).

    Returns:
        Shape (n,), 1 in the middle of a micro-image on the axis and beyond all micro-images.
    """
    if lattice.cone is None:
        return np.ones(len(lens))
    shades, step = _shades(lattice)
    return _shade_at(np.ascontiguousarray(away_px), slants_of(lattice)[lens], shades, step)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _left(
    dx: float, dy: float, slant: Array, shades: Array, step: float
) -> float:  # pragma: no cover - compiled
    """What fall-off leaves at a place from a micro-image's centre."""
    r = np.sqrt(dx * dx + dy * dy)
    k = min(int(r / step + 0.5), len(shades) - 1)
    along, steep = (slant[0] * dx + slant[1] * dy) / max(r, 1e-9), slant[0] ** 2 + slant[1] ** 2
    left = shades[k, 0] + along * shades[k, 1] + steep * (shades[k, 2] + along * shades[k, 4])
    return left + along * along * (shades[k, 3] + along * shades[k, 5])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _shade_at(
    away: Array, slants: Array, shades: Array, step: float
) -> Array:  # pragma: no cover - compiled
    shade = np.empty(len(away))
    for n in range(len(away)):
        shade[n] = _left(away[n, 0], away[n, 1], slants[n], shades, step)
    return shade


def slants_of(lattice: Lattice) -> Array:
    """Slope of each micro-image's middle ray, as far as light falls off with it, shape (n, 2)."""
    return lattice.slants[1:3] + lattice.slants[3] * (lattice.centres_px - lattice.origin_px)


def _shades(lattice: Lattice) -> tuple[Array, float]:
    """Fall-off against the distance from a micro-image's centre, by the powers of its slant as in
    ``ProfileTable``, and the step.
    """
    large, small = (
        (lattice.outside_radius_px + lattice.inside_radius_px) / 2,
        (lattice.outside_radius_px - lattice.inside_radius_px) / 2,
    )
    share = float(lattice.slants[0])
    table = profile_table(large, max(0.05, small), lattice.cone, share)
    plain = table.values[:, VALUE] - share * table.values[:, FALLOFF]
    lit = plain > LEAST_LIGHT
    columns = [VALUE, LOPSIDED, *range(ORDERS.start, ORDERS.stop)]
    shades = np.where(
        lit[:, None],
        table.values[:, columns] / np.where(lit, plain, 1.0)[:, None],
        np.eye(len(columns))[0],
    )
    return np.ascontiguousarray(shades), table.step

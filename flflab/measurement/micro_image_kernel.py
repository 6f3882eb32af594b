"""What the fits of single micro-images sum over pixels, compiled: normal matrices of each and of
each with its neighbours.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.measurement.lattice.profile import (
    BY_LARGE,
    BY_RADIUS,
    BY_SMALL,
    LOPSIDED,
    ORDERS,
    SQUARE,
    VALUE,
)

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

VALUES = 5  # of a micro-image: centre x, y, larger and smaller radius, light
_FIRST_ORDER = ORDERS.start


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _between(table: Array, k: int, t: float, column: int) -> float:  # pragma: no cover - compiled
    """A column of a table at the part t of the way from an entry to the next."""
    return table[k, column] + t * (table[k + 1, column] - table[k, column])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _derivatives(
    column: int,
    row: int,
    one: Array,
    slant: Array,
    table: Array,
    at: Array,
    g: Array,
) -> bool:  # pragma: no cover - compiled
    """Derivatives of a pixel by the values of a micro-image; the last is its share of the light.
    False where it sends none.
    """
    dx, dy = column - one[0], row - one[1]
    r = math.sqrt(dx * dx + dy * dy)
    if r >= at[2]:
        return False
    place = r / at[3]
    k = int(place)
    t = place - k
    ux, uy = dx / max(r, 1e-9), dy / max(r, 1e-9)
    # All columns are read between their entries: a share with steps in it has a fit of what the
    # border cuts jump to and fro.
    along, steep = slant[0] * ux + slant[1] * uy, slant[0] ** 2 + slant[1] ** 2
    share = (
        _between(table, k, t, VALUE)
        + (1.0 - 8.0 * (ux * uy) ** 2) * _between(table, k, t, SQUARE)
        + along * _between(table, k, t, LOPSIDED)
    )
    share += steep * (
        _between(table, k, t, _FIRST_ORDER) + along * _between(table, k, t, _FIRST_ORDER + 2)
    )
    share += (
        along
        * along
        * (
            _between(table, k, t, _FIRST_ORDER + 1)
            + along * _between(table, k, t, _FIRST_ORDER + 3)
        )
    )
    large, small = _between(table, k, t, BY_LARGE), _between(table, k, t, BY_SMALL)
    share += large * (one[2] - at[0]) + small * (one[3] - at[1])
    slope = one[4] * _between(table, k, t, BY_RADIUS)
    g[0], g[1], g[2], g[3], g[4] = -slope * ux, -slope * uy, one[4] * large, one[4] * small, share
    return True


@numba.njit(nogil=True, cache=True, error_model="numpy")
def sum_up(
    picture: npt.NDArray[np.float32],
    members: Whole,
    values: Array,
    slants: Array,
    neighbours: Whole,
    tables: Array,
    at: Array,
    which: Whole,
    background: float,
    dark: float,
    gain: float,
    ceiling: float,
    offset_dn: float,
) -> tuple[Array, Array, Array, Array, Whole]:  # pragma: no cover - compiled
    """Normal matrices of some micro-images, those with each neighbour, right sides, chi^2 and
    numbers of pixels.

    ``which`` table is each micro-image's, ``at`` its radii, reach and step; where ``neighbours``
    are -1 there are none.
    """
    normal = np.zeros((len(members), VALUES, VALUES))
    cross = np.zeros((len(members), neighbours.shape[1], VALUES, VALUES))
    right = np.zeros((len(members), VALUES))
    chi2, count = np.zeros(len(members)), np.zeros(len(members), dtype=np.int64)
    g, others = np.zeros(VALUES), np.zeros((neighbours.shape[1], VALUES))
    lit = np.zeros(neighbours.shape[1], dtype=np.bool_)
    height, width = picture.shape
    for m in range(len(members)):
        n = members[m]
        x, y, table = values[n, 0], values[n, 1], which[n]
        reach = at[table, 2]
        for row in range(max(0, math.ceil(y - reach)), min(height - 1, math.floor(y + reach)) + 1):
            for column in range(
                max(0, math.ceil(x - reach)), min(width - 1, math.floor(x + reach)) + 1
            ):
                read = picture[row, column]
                if not read < ceiling:
                    continue
                if not _derivatives(column, row, values[n], slants[n], tables[table], at[table], g):
                    continue
                expected = background + values[n, 4] * g[4]
                for k in range(neighbours.shape[1]):
                    o = neighbours[n, k]
                    lit[k] = False
                    if o < 0:
                        continue
                    there = which[o]
                    if (column - values[o, 0]) ** 2 + (row - values[o, 1]) ** 2 >= at[
                        there, 2
                    ] ** 2:  # spares most neighbours' rows
                        continue
                    lit[k] = _derivatives(
                        column, row, values[o], slants[o], tables[there], at[there], others[k]
                    )
                    if lit[k]:
                        expected += values[o, 4] * others[k, 4]
                weight = 1.0 / (dark + gain * max(expected - offset_dn, 0.0))
                rest = read - expected
                chi2[m] += weight * rest * rest
                count[m] += 1
                for a in range(VALUES):
                    right[m, a] += weight * rest * g[a]
                    for b in range(a + 1):
                        normal[m, a, b] += weight * g[a] * g[b]
                for k in range(neighbours.shape[1]):
                    if lit[k]:
                        for a in range(VALUES):
                            for b in range(VALUES):
                                cross[m, k, a, b] += weight * g[a] * others[k, b]
        for a in range(VALUES):
            for b in range(a):
                normal[m, b, a] = normal[m, a, b]
    return normal, cross, right, chi2, count


@numba.njit(nogil=True, cache=True)
def with_neighbours(
    members: Whole, neighbours: Whole, normal: Array, cross: Array, right: Array
) -> tuple[Array, Array]:
    """Systems of each of some micro-images together with its neighbours, itself first; a missing
    neighbour is left at rest.
    """
    around = neighbours.shape[1] + 1
    systems = np.zeros((len(members), around * VALUES, around * VALUES))
    sides = np.zeros((len(members), around * VALUES))
    group = np.zeros(around, dtype=np.int64)
    for m in range(len(members)):
        group[0] = members[m]
        group[1:] = neighbours[members[m]]
        for p in range(around):
            here = slice(p * VALUES, (p + 1) * VALUES)
            if group[p] < 0:
                systems[m, here, here] = np.eye(VALUES)
                continue
            systems[m, here, here] = normal[group[p]]
            sides[m, here] = right[group[p]]
            for k in range(around - 1):
                for q in range(around):
                    if group[q] >= 0 and neighbours[group[p], k] == group[q]:
                        systems[m, here, q * VALUES : (q + 1) * VALUES] = cross[group[p], k]
    return systems, sides

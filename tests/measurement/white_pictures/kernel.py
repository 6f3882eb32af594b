"""Light of micro-images added pixel by pixel."""

import math

import numba
import numpy as np
import numpy.typing as npt
from white_pictures.profiles import ProfileTable

Array = npt.NDArray[np.float64]

LENS = np.dtype(
    [
        ("x", np.float64),  # centre, px
        ("y", np.float64),
        ("light", np.float64),
        ("xx", np.float64),  # from px about the centre to the profile's px
        ("xy", np.float64),
        ("yx", np.float64),
        ("yy", np.float64),
        ("longest", np.float64),  # the profile's px for a pixel, at most
        ("across", np.float64),  # half of the micro-image's width and height, px
        ("down", np.float64),
        ("stop_x", np.float64),  # half of the way between the two stops, the profile's px
        ("stop_y", np.float64),
        ("slope_x", np.float64),  # a profile's px
        ("slope_y", np.float64),
        ("rounding", np.float64),  # a profile's px squared
        ("covered", np.bool_),
        ("cover_x", np.float64),  # direction of the dark half
        ("cover_y", np.float64),
    ]
)


@numba.njit(cache=True, error_model="numpy", fastmath=True)
def _add(
    picture: Array,
    lenses: npt.NDArray[np.void],
    table: Array,
    limits: tuple[float, float, float],
    rim: tuple[Array, Array],
    flat: tuple[Array, Array],
) -> None:
    inner, outer, step = limits
    finer, last_step = 1 / step, len(table) - 1.001
    rows, columns = picture.shape
    for n in range(len(lenses)):
        lens = lenses[n]
        x, y, xx, xy, yx, yy = lens.x, lens.y, lens.xx, lens.xy, lens.yx, lens.yy
        stop_x, stop_y = lens.stop_x, lens.stop_y
        slope_x, slope_y, rounding = lens.slope_x, lens.slope_y, lens.rounding
        stop = stop_x * stop_x + stop_y * stop_y
        reach = 0.7072 * lens.longest
        first = max(0, math.floor(x - lens.across))
        last = min(columns - 1, math.ceil(x + lens.across))
        for row in range(
            max(0, math.floor(y - lens.down)), min(rows - 1, math.ceil(y + lens.down)) + 1
        ):
            for column in range(first, last + 1):
                u = xx * (column - x) + xy * (row - y)
                v = yx * (column - x) + yy * (row - y)
                middle = math.sqrt(u * u + v * v + stop + 2 * abs(u * stop_x + v * stop_y))
                if middle - reach >= outer:
                    continue
                nodes, weights = rim if lens.covered or middle + reach > inner else flat
                total = 0.0
                for k in range(len(nodes)):
                    for m in range(len(nodes)):
                        p = u + xx * nodes[m] + xy * nodes[k]
                        q = v + yx * nodes[m] + yy * nodes[k]
                        square = p * p + q * q
                        r = math.sqrt(square + stop + 2 * abs(p * stop_x + q * stop_y))
                        at = min(max((r - inner) * finer, 0.0), last_step)
                        low, high = table[int(at)], table[int(at) + 1]
                        light = low + (at - int(at)) * (high - low)
                        light *= (1 + slope_x * p + slope_y * q) / (1 + rounding * square)
                        if lens.covered:
                            light *= 0.5 * math.erfc(p * lens.cover_x + q * lens.cover_y)
                        total += weights[k] * weights[m] * light
                picture[row, column] += lens.light * total


def add_micro_images(picture: Array, lenses: npt.NDArray[np.void], table: ProfileTable) -> None:
    """Add pixels' means of the lenses' light (dtype ``LENS``) to a picture."""
    rim, flat = (np.polynomial.legendre.leggauss(order) for order in (8, 3))
    limits = (table.inner, table.outer, table.step)
    halved = [(nodes / 2, weights / 2) for nodes, weights in (rim, flat)]
    _add(picture, lenses, table.light, limits, *halved)

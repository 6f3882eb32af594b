"""What the microlenses see of each direction of the map, summed up in compiled loops.

A view of the map's place t (px on the array) by a microlens is read from the normalised picture at
the sensor's point of ``geometry``. All views of a place are compared by weighted sums.
"""

import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Record = Any  # a row of such a table, as numba sees it
Pixels = npt.NDArray[np.float32]

LENS = np.dtype(
    [
        ("x", "f8"),
        ("y", "f8"),
        ("column", "f8"),
        ("row", "f8"),
        ("rise", "f8"),
        ("kappa", "f8"),
        ("reach", "f8"),
        ("skew", "f8"),
        ("variance", "f8"),
        ("blur", "f8"),
        ("kind", "i8"),
    ]
)
# lengths of the whole camera, px; the map's grid: t = first + index * step, step < 0
OPTICS = np.dtype(
    [
        ("distance", "f8"),
        ("gap", "f8"),
        ("first_x", "f8"),
        ("first_y", "f8"),
        ("step", "f8"),
        ("per_table", "f8"),
        ("kappa", "f8"),
        ("kappa_square", "f8"),
    ]
)
# sums of a place: information, score, misfit, number of views, mean value, what noise adds to the
# information, variance of the disparity by what the microlenses' places are uncertain
INFORMATION, SCORE, MISFIT, VIEWS, VALUE, PRETENDED, BY_PLACES = range(7)
SUMS = 7
# sums over the views of a place: weight, v, v^2, gradient, d, d d, v d, number, and of the lens's
# variance with the squared weight: 1, d, d^2
(WEIGHT, V, VV, GX, GY, DX, DY, DXX, DXY, DYY, VDX, VDY, NUMBER, U, UX, UY, UU) = range(17)
SLOTS = 17
# variance of the derivative of smoothed noise (SMOOTHING_PX), cubic interpolation, over its own
NOISE_SLOPE = 0.72
MOST_SHARPENED = 2.0  # px^2: beyond, a view's curvature no longer says how its blur changes it


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _seen(
    lens: Record, optics: Record, tables: Array, delta: float, tx: float, ty: float
) -> tuple[float, float, float, float]:
    """Where the lens sees t at a disparity: (x, y from the micro-image's centre, their slopes
    against delta), px.
    """
    b, distance, rise = optics.gap, optics.distance, lens.rise
    own, stretch, slope = delta, 1.0, 1.0
    if rise != 0.0:
        w = delta + b / distance
        toward = b + rise * w
        own = (b - rise) * w / toward - (b - rise) / (distance + rise)
        slope = (b - rise) * b / toward**2
        stretch = (distance + rise) / distance
    away_x, away_y = lens.x - tx * stretch, lens.y - ty * stretch
    x0, y0 = own * away_x, own * away_y
    shift, inside = tables[0, lens.kind], tables[1, lens.kind]
    last = len(shift) - 2
    defocus = lens.kappa + own
    place = math.hypot(x0, y0) * optics.per_table
    first = min(int(place), last)
    part = min(place - first, 1.0)
    ratio = shift[first] + part * (shift[first + 1] - shift[first])
    near = inside[first] + part * (inside[first + 1] - inside[first])
    place *= 1 + defocus * ratio + near
    cell = min(max(int(place), 0), last)
    part = min(place - cell, 1.0)
    ratio = shift[cell] + part * (shift[cell + 1] - shift[cell])
    near = inside[cell] + part * (inside[cell + 1] - inside[cell])
    factor = 1 / (1 - defocus * ratio - near)
    x = x0 * factor + defocus * lens.skew * lens.x
    y = y0 * factor + defocus * lens.skew * lens.y
    return x, y, slope * (away_x * factor + ratio * x), slope * (away_y * factor + ratio * y)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sum_costs(
    lenses: Record,
    optics: Record,
    stretches: Array,
    tables: Array,
    value: Pixels,
    curvature: Pixels,
    weight: Pixels,
    delta: float,
    first: int,
    last: int,
    sums: Array,
) -> None:
    """Add up weight, value and value^2 of all views of rows ``first`` to ``last`` of the map at one
    disparity: sums (4, rows, columns) with the number of views last.

    Every microlens is taken as of its kind's kappa, ``stretches`` are those of ``stretches_at``:
    near enough for a sweep.
    """
    columns = sums.shape[2]
    rows, cols = value.shape
    ys = lenses.y
    most = 0.0
    for index in range(len(lenses)):
        most = max(most, lenses[index].reach)
    most = 1.1 * most / abs(delta)
    end = stretches.shape[1] - 2
    for line in range(first, last):
        ty = optics.first_y + line * optics.step
        start = np.searchsorted(ys, ty - most)
        stop = np.searchsorted(ys, ty + most)
        for index in range(start, stop):
            lens = lenses[index]
            half = math.sqrt(max(most**2 - (lens.y - ty) ** 2, 0.0))
            left = max(int((lens.x + half - optics.first_x) / optics.step), 0)
            right = min(int((lens.x - half - optics.first_x) / optics.step) + 2, columns)
            own, wide = _own(lens, optics, delta)
            stretch = stretches[lens.kind]
            aside = (lens.kappa + own) * lens.skew
            variances = tables[2, lens.kind]
            y0 = own * (lens.y - ty * wide)
            reach2 = lens.reach**2
            for across in range(left, right):
                tx = optics.first_x + across * optics.step
                x0 = own * (lens.x - tx * wide)
                place = math.sqrt(x0 * x0 + y0 * y0) * optics.per_table
                cell = min(int(place), end)
                part = min(place - cell, 1.0)
                factor = stretch[cell] + part * (stretch[cell + 1] - stretch[cell])
                x, y = x0 * factor + aside * lens.x, y0 * factor + aside * lens.y
                if x * x + y * y > reach2:
                    continue
                px, py = lens.column + x, lens.row + y
                c, r = math.floor(px), math.floor(py)
                if c < 0 or r < 0 or c + 1 >= cols or r + 1 >= rows:
                    continue
                w = weight[r, c]
                if w <= 0:
                    continue
                fx, fy = px - c, py - r
                v = _between(value, r, c, fx, fy)
                v += _sharpen(lens, optics, own, variances[cell]) * curvature[r, c]
                sums[0, line, across] += w
                sums[1, line, across] += w * v
                sums[2, line, across] += w * v * v
                sums[3, line, across] += 1


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _own(lens: Record, optics: Record, delta: float) -> tuple[float, float]:
    """Disparity with a lens's own distances, and how much wider its chief rays lie apart."""
    if lens.rise == 0.0:
        return delta, 1.0
    b, distance, rise = optics.gap, optics.distance, lens.rise
    w = delta + b / distance
    own = (b - rise) * w / (b + rise * w) - (b - rise) / (distance + rise)
    return own, (distance + rise) / distance


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sharpen(lens: Record, optics: Record, own: float, variance: float) -> float:
    """Times a view's curvature and added to it, this makes the view as blurred as by the whole
    aperture of its type's microlens.

    An aperture's variance times (kappa + delta)^2 is that of its blur; a variance more by s adds
    s/2 of the curvature. A disc of diameter d has d^2/16 along an axis.
    """
    due = (optics.kappa_square + own * (2 * optics.kappa + own)) * lens.blur**2 / 16
    change = (due - (lens.kappa + own) ** 2 * variance) / 2
    return min(max(change, -MOST_SHARPENED), MOST_SHARPENED)


def stretches_at(defocus: Array, tables: Array, per_table: float) -> Array:
    """How much further from the micro-image's centre a view lies than the pinhole's, by kind and at
    the tables' steps of the pinhole's place; shape (kinds, steps).

    Args:
        defocus: kappa + delta of each kind.
        tables: ``shift`` and ``inside`` over e, shape (2, kinds, steps).
        per_table: steps of the tables a pixel.
    """
    kinds, steps = tables.shape[1:]
    even = np.arange(steps) / per_table
    found = np.ones((kinds, steps))
    for _ in range(2):
        for kind in range(kinds):
            shift, inside = (np.interp(even * found[kind], even, one[kind]) for one in tables[:2])
            found[kind] = 1 / (1 - defocus[kind] * shift - inside)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _between(value: Pixels, r: int, c: int, fx: float, fy: float) -> float:
    """Linear interpolation."""
    return (1 - fy) * ((1 - fx) * value[r, c] + fx * value[r, c + 1]) + fy * (
        (1 - fx) * value[r + 1, c] + fx * value[r + 1, c + 1]
    )


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cubic(value: Pixels, r: int, c: int, fx: float, fy: float) -> tuple[float, float, float]:
    """Catmull-Rom interpolation with its derivatives along x and y."""
    wx = (
        fx * (-0.5 + fx * (1 - 0.5 * fx)),
        1 + fx * fx * (-2.5 + 1.5 * fx),
        fx * (0.5 + fx * (2 - 1.5 * fx)),
        fx * fx * (-0.5 + 0.5 * fx),
    )
    dx = (
        -0.5 + fx * (2 - 1.5 * fx),
        fx * (-5 + 4.5 * fx),
        0.5 + fx * (4 - 4.5 * fx),
        fx * (-1 + 1.5 * fx),
    )
    v, vx, vy = 0.0, 0.0, 0.0
    for k in range(4):
        along, slope = 0.0, 0.0
        for m in range(4):
            along += wx[m] * value[r - 1 + k, c - 1 + m]
            slope += dx[m] * value[r - 1 + k, c - 1 + m]
        if k == 0:
            wy, dy = fy * (-0.5 + fy * (1 - 0.5 * fy)), -0.5 + fy * (2 - 1.5 * fy)
        elif k == 1:
            wy, dy = 1 + fy * fy * (-2.5 + 1.5 * fy), fy * (-5 + 4.5 * fy)
        elif k == 2:
            wy, dy = fy * (0.5 + fy * (2 - 1.5 * fy)), 0.5 + fy * (4 - 4.5 * fy)
        else:
            wy, dy = fy * fy * (-0.5 + 0.5 * fy), fy * (-1 + 1.5 * fy)
        v += wy * along
        vx += wy * slope
        vy += dy * along
    return v, vx, vy


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sum_scores(
    lenses: Record,
    optics: Record,
    tables: Array,
    value: Pixels,
    curvature: Pixels,
    weight: Pixels,
    delta: Array,
    first: int,
    last: int,
    out: Array,
) -> None:
    """Of rows ``first`` to ``last`` of the map, at each place's own disparity: what its views say
    about it, out (SUMS, rows, columns). NaN disparities are left alone.

    With v the views, d how they move with delta, w their weights, m the views' weighted mean and G
    that of their gradients: g = G d, information sum w g^2 - (sum w g)^2/sum w, score
    sum w g (m - v), misfit sum w (v - m)^2. The mean gradient, not each view's own: views are
    blurred differently, and own gradients draw towards disparities where they are blurred alike.
    """
    columns = out.shape[2]
    rows, cols = value.shape
    ys = lenses.y
    reach = 0.0
    for index in range(len(lenses)):
        reach = max(reach, lenses[index].reach)
    s = np.zeros((SLOTS, columns))
    for line in range(first, last):
        s[:] = 0.0
        least = np.inf
        for across in range(columns):
            if delta[line, across] == delta[line, across]:
                least = min(least, abs(delta[line, across]))
        if not least < np.inf:
            continue
        most = 1.1 * reach / least
        ty = optics.first_y + line * optics.step
        start = np.searchsorted(ys, ty - most)
        stop = np.searchsorted(ys, ty + most)
        for index in range(start, stop):
            lens = lenses[index]
            half = math.sqrt(max(most**2 - (lens.y - ty) ** 2, 0.0))
            left = max(int((lens.x + half - optics.first_x) / optics.step), 0)
            right = min(int((lens.x - half - optics.first_x) / optics.step) + 2, columns)
            for across in range(left, right):
                here = delta[line, across]
                if here != here:
                    continue
                tx = optics.first_x + across * optics.step
                x, y, dx, dy = _seen(lens, optics, tables, here, tx, ty)
                if not x * x + y * y <= lens.reach**2:
                    continue
                px, py = lens.column + x, lens.row + y
                c, r = math.floor(px), math.floor(py)
                if c < 1 or r < 1 or c + 2 >= cols or r + 2 >= rows:
                    continue
                w = weight[r, c]
                if w <= 0:
                    continue
                v, vx, vy = _cubic(value, r, c, px - c, py - r)
                away = math.sqrt(x * x + y * y) * optics.per_table
                variance = tables[2, lens.kind, min(int(away), tables.shape[2] - 1)]
                v += _sharpen(lens, optics, here, variance) * _between(
                    curvature, r, c, px - c, py - r
                )
                s[WEIGHT, across] += w
                s[V, across] += w * v
                s[VV, across] += w * v * v
                s[GX, across] += w * vx
                s[GY, across] += w * vy
                s[DX, across] += w * dx
                s[DY, across] += w * dy
                s[DXX, across] += w * dx * dx
                s[DXY, across] += w * dx * dy
                s[DYY, across] += w * dy * dy
                s[VDX, across] += w * v * dx
                s[VDY, across] += w * v * dy
                s[NUMBER, across] += 1
                uncertain = lens.variance * w * w
                s[U, across] += uncertain
                s[UX, across] += uncertain * dx
                s[UY, across] += uncertain * dy
                s[UU, across] += uncertain * (dx * dx + dy * dy)
        for across in range(columns):
            if s[NUMBER, across] > 0:
                _conclude(s[:, across], out[:, line, across])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _conclude(s: Array, out: Array) -> None:
    """From the sums over a place's views to what they say, see ``sum_scores``."""
    total = s[WEIGHT]
    mean = s[V] / total
    out[VIEWS] = s[NUMBER]
    out[VALUE] = mean
    if s[NUMBER] < 2:
        return
    gx, gy = s[GX] / total, s[GY] / total
    mx, my = s[DX] / total, s[DY] / total
    xx, xy, yy = s[DXX] - mx * s[DX], s[DXY] - mx * s[DY], s[DYY] - my * s[DY]
    spread = xx + yy
    out[INFORMATION] = gx * gx * xx + 2 * gx * gy * xy + gy * gy * yy
    out[SCORE] = gx * (mean * s[DX] - s[VDX]) + gy * (mean * s[DY] - s[VDY])
    out[MISFIT] = max(s[VV] - mean * s[V], 0.0)
    out[PRETENDED] = NOISE_SLOPE / total * spread
    uncertain = s[UU] - 2 * (mx * s[UX] + my * s[UY]) + (mx * mx + my * my) * s[U]
    out[BY_PLACES] = uncertain / max(spread, 1e-300) ** 2

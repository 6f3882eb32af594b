"""What the fit of a lattice sums over pixels, compiled: normal equations of some, the gradient of
all, light about lattice points.
"""

import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from flflab.measurement.lattice.profile import (
    BY_LARGE,
    BY_RADIUS,
    BY_SMALL,
    FALLOFF,
    LOPSIDED,
    SQUARE,
    VALUE,
)

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

# origin 2, vectors 4, radii 2, background 1, polynomial 6, share of fall-off 1, slant at the origin
# 2, its rate 1, tilt 2, kinds' widths 1
COUNT = 22
X, Y, RISE, OUT_X, OUT_Y, LEVER_X, LEVER_Y, LARGE_BY_RISE, SMALL_BY_RISE, TABLE, WIDER_PX = range(
    11
)  # of a micro-image's place
OUT, LEVER, RADII_BY_RISE, PLACES = (
    slice(OUT_X, OUT_Y + 1),
    slice(LEVER_X, LEVER_Y + 1),
    slice(LARGE_BY_RISE, SMALL_BY_RISE + 1),
    11,
)
BY_RISE = 11  # column of the tables beyond those of a ``ProfileTable``
SIDEWAYS, TWICE, THRICE, FOURFOLD, SHAPES = range(
    1, 6
)  # of a micro-image's own profile, beside its symmetric part
DERIVATIVES = [
    BY_RADIUS,
    BY_LARGE,
    BY_SMALL,
    FALLOFF,
    LOPSIDED,
    VALUE,
]  # columns of the tables that the gradient looks up


@numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"}
)
def accumulate(
    picture: npt.NDArray[np.float32],
    rows: Whole,
    columns: tuple[int, int, int],
    values: Array,
    inverse: Array,
    tables: Array,
    step: float,
    offsets: Whole,
    lights: Array,
    places: Array,
    dark: float,
    gain: float,
    ceiling: float,
    offset_dn: float,
    wanted: int,
) -> tuple[Array, Array, float, int]:  # pragma: no cover - compiled
    """Normal matrix, right side, chi^2 and number of pixels of every so manieth column of some
    rows.

    ``lights`` holds each micro-image's light and the six terms of the polynomial there; light 0
    where there is none. ``places`` holds centre, rise beyond that of its table, place from the
    axis, how the rise changes with the tilt and the radii with the rise, which of ``tables`` it has
    and by how much its kind's disc is described wider than the central one's. Of the values the
    first ``wanted`` are looked at, the others' sums are 0.
    """
    normal = np.zeros((COUNT, COUNT))
    right = np.zeros(COUNT)
    g = np.zeros(COUNT)
    chi2 = 0.0
    count = 0
    half_i = lights.shape[0] // 2
    half_j = lights.shape[1] // 2
    reach = step * (tables.shape[1] - 2)
    for row in rows:
        py = row - values[1]
        for column in range(columns[0], columns[1], columns[2]):
            read = picture[row, column]
            if not read < ceiling:
                continue
            px = column - values[0]
            i0 = int(np.floor(inverse[0, 0] * px + inverse[0, 1] * py + 0.5))
            j0 = int(np.floor(inverse[1, 0] * px + inverse[1, 1] * py + 0.5))
            expected = values[8]
            lit = False
            for n in range(len(offsets)):
                i = i0 + offsets[n, 0]
                j = j0 + offsets[n, 1]
                if abs(i) > half_i or abs(j) > half_j:
                    continue
                at = places[i + half_i, j + half_j]
                dx = column - at[X]
                dy = row - at[Y]
                square = dx * dx + dy * dy
                if square >= reach * reach:
                    continue
                light = lights[i + half_i, j + half_j, 0]
                if light == 0.0:
                    continue
                if not lit:
                    g[:] = 0.0
                    lit = True
                table = tables[int(at[TABLE])]
                r = np.sqrt(square)
                place = r / step
                k = int(place)
                t = place - k
                ux = dx / max(r, 1e-9)
                uy = dy / max(r, 1e-9)
                fourfold = 1.0 - 8.0 * (ux * uy) ** 2
                value = (
                    table[k, VALUE]
                    + t * (table[k + 1, VALUE] - table[k, VALUE])
                    + fourfold * table[k, SQUARE]
                )
                lop = table[k, LOPSIDED] + t * (table[k + 1, LOPSIDED] - table[k, LOPSIDED])
                vx = at[X] - values[0]
                vy = at[Y] - values[1]
                sx = values[16] + values[18] * vx
                sy = values[17] + values[18] * vy
                along = sx * ux + sy * uy
                by_rise = table[k, BY_RISE] + t * (table[k + 1, BY_RISE] - table[k, BY_RISE])
                share = value + lop * along + at[RISE] * by_rise
                share += (sx * sx + sy * sy) * (
                    table[k, 7] + along * table[k, 9]
                ) + along * along * (table[k, 8] + along * table[k, 10])
                expected += light * share
                slope = -light * (
                    table[k, BY_RADIUS] + t * (table[k + 1, BY_RADIUS] - table[k, BY_RADIUS])
                )
                ex = slope * ux
                ey = slope * uy
                g[0] += ex
                g[1] += ey
                g[2] += i * ex
                g[3] += i * ey
                g[4] += j * ex
                g[5] += j * ey
                by_small = light * (
                    table[k, BY_SMALL] + t * (table[k + 1, BY_SMALL] - table[k, BY_SMALL])
                )
                g[6] += light * (
                    table[k, BY_LARGE] + t * (table[k + 1, BY_LARGE] - table[k, BY_LARGE])
                )
                g[7] += by_small
                for m in range(6):
                    g[9 + m] += share * lights[i + half_i, j + half_j, 1 + m]
                g[15] += light * table[k, FALLOFF]
                g[16] += light * lop * ux
                g[17] += light * lop * uy
                g[18] += light * lop * (vx * ux + vy * uy)
                lifted = light * by_rise - ex * at[OUT_X] - ey * at[OUT_Y]
                g[19] += lifted * at[LEVER_X]
                g[20] += lifted * at[LEVER_Y]
                g[21] += by_small * at[WIDER_PX]
            weight = 1.0 / (dark + gain * max(expected - offset_dn, 0.0))
            rest = read - expected
            pull = weight * rest
            chi2 += pull * rest
            count += 1
            if not lit:
                right[8] += pull
                normal[8, 8] += weight
                continue
            g[8] = 1.0
            for n in range(wanted):
                right[n] += pull * g[n]
                weighted = weight * g[n]
                for m in range(n + 1):
                    normal[n, m] += weighted * g[m]
    for n in range(wanted):
        normal[:n, n] = normal[n, :n]
    return normal, right, chi2, count


def _own_floats(context: Any, number: Any) -> Any:
    """A pointer to so many floats of a function's own, which it loses when it ends.

    What is written there can be no part of what is read from an argument: only then does the
    compiler look several pixels up at a time.
    """

    def generated(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.alloca(ir.FloatType(), arguments[0])

    return types.CPointer(types.float32)(number), generated


own_floats: Any = intrinsic(_own_floats)


@numba.njit(cache=True, nogil=True)
def _columns_lit(cx: float, dy: np.floating[Any], reach: float, width: int) -> tuple[int, int]:
    """The columns of a row ``dy`` px from a centre within its reach: the first and that after the
    last; the same where there are none.
    """
    half = reach * reach - dy * dy
    if half <= 0.0:
        return 0, 0
    half = math.sqrt(half) - 1e-3
    first = min(max(0, math.ceil(cx - half)), width)
    return first, max(first, min(width, math.floor(cx + half) + 1))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def own_profiles(
    tables: Array, values: Array, places: Array
) -> npt.NDArray[np.float32]:  # pragma: no cover - compiled
    """Each listed micro-image's profile with its own slant and rise, shape (n, entries, SHAPES).

    The symmetric part at the tables' entries, the rest, of which a pixel sees little, in the middle
    between an entry and the next: what comes with the slant along the direction from the centre,
    with its square and its cube, and with the cosine of four times the angle.
    """
    count = tables.shape[1]
    found = np.zeros((len(places), count, SHAPES), dtype=np.float32)
    for n in range(len(places)):
        at, table = places[n], tables[int(places[n, TABLE])]
        sx = values[16] + values[18] * (at[X] - values[0])
        sy = values[17] + values[18] * (at[Y] - values[1])
        steep = sx * sx + sy * sy
        for k in range(count - 1):
            one, after = table[k], table[k + 1]
            found[n, k, 0] = one[VALUE] + at[RISE] * one[BY_RISE] + steep * one[7]
            found[n, k, SIDEWAYS] = 0.5 * (
                one[LOPSIDED] + after[LOPSIDED] + steep * (one[9] + after[9])
            )
            found[n, k, TWICE] = 0.5 * (one[8] + after[8])
            found[n, k, THRICE] = 0.5 * (one[10] + after[10])
            found[n, k, FOURFOLD] = 0.5 * (one[SQUARE] + after[SQUARE])
    return found


@numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"}
)
def gradient(
    picture: npt.NDArray[np.float32],
    first: int,
    last: int,
    values: Array,
    profiles: npt.NDArray[np.float32],
    derivatives: npt.NDArray[np.float32],
    step: float,
    indices: Array,
    lights: Array,
    places: Array,
    dark: float,
    gain: float,
    ceiling: float,
    offset_dn: float,
) -> tuple[Array, float, int]:  # pragma: no cover - compiled
    """Right side, chi^2 and number of pixels of whole rows, micro-image by micro-image; they are
    listed by the rows of their centres.

    ``profiles`` as from ``own_profiles``; ``derivatives`` has the tables' columns DERIVATIVES, in
    the middle between an entry and the next. ``indices`` holds i and j of each; ``lights`` and
    ``places`` as in ``accumulate``.
    """
    right = np.zeros(COUNT)
    chi2 = 0.0
    count = 0
    width = picture.shape[1]
    reach = step * (profiles.shape[1] - 2)
    expected = carray(own_floats(width), width)
    pull = np.empty(width, dtype=np.float32)
    scale = np.float32(1 / step)
    background = np.float32(values[8])
    f_dark, f_gain, f_offset = np.float32(dark), np.float32(gain), np.float32(offset_dn)
    none = np.float32(0)
    begin = 0
    for row in range(first, last):
        while begin < len(places) and places[begin, Y] + reach < row:
            begin += 1
        expected[:] = background
        end = begin
        while end < len(places) and places[end, Y] - reach <= row:
            at, profile = places[end], profiles[end]
            cx = at[X]
            dy = np.float32(row - at[Y])
            low, high = _columns_lit(cx, dy, reach, width)
            light = np.float32(lights[end, 0])
            end += 1
            sx = np.float32(values[16] + values[18] * (cx - values[0]))
            sy = np.float32(values[17] + values[18] * (at[Y] - values[1]))
            lit = expected[low:high]
            begins = np.float32(low - cx)
            for n in range(len(lit)):
                dx = begins + np.float32(n)
                r = np.sqrt(dx * dx + dy * dy) + np.float32(1e-6)
                place = r * scale
                k = np.int32(place)
                t = place - np.float32(k)
                one = np.float32(1) / r
                product = dx * dy * one * one
                slant = (sx * dx + sy * dy) * one
                value = profile[k, 0] + t * (profile[k + 1, 0] - profile[k, 0])
                value += (np.float32(1) - np.float32(8) * product * product) * profile[k, FOURFOLD]
                value += slant * (
                    profile[k, SIDEWAYS] + slant * (profile[k, TWICE] + slant * profile[k, THRICE])
                )
                lit[n] += light * value
        total, squares, seen = np.float32(0), np.float32(0), 0
        for column in range(width):
            read = picture[row, column]
            due = expected[column]
            rest = read - due
            weight = np.float32(1) / (f_dark + f_gain * max(due - f_offset, none))
            usable = read < ceiling
            p = weight * rest if usable else none
            pull[column] = p
            total += p
            squares += p * rest
            seen += usable
        right[8] += total
        chi2 += float(squares)
        count += seen
        for n in range(begin, end):
            at, table = places[n], derivatives[int(places[n, TABLE])]
            cx = at[X]
            dy = np.float32(row - at[Y])
            low, high = _columns_lit(cx, dy, reach, width)
            along = across = large = small = bright = fall = slant_x = slant_y = np.float32(0)
            light = lights[n, 0]
            vx, vy = cx - values[0], at[Y] - values[1]
            sx, sy = (
                np.float32(values[16] + values[18] * vx),
                np.float32(values[17] + values[18] * vy),
            )
            pulls = pull[low:high]
            begins = np.float32(low - cx)
            for m in range(len(pulls)):
                dx = begins + np.float32(m)
                r = np.sqrt(dx * dx + dy * dy) + np.float32(1e-6)
                k = np.int32(r * scale)
                p = pulls[m]
                turned = p / r
                slope = turned * table[k, 0]
                along -= slope * dx
                across -= slope * dy
                large += p * table[k, 1]
                small += p * table[k, 2]
                fall += p * table[k, 3]
                lop = turned * table[k, 4]
                slant_x += lop * dx
                slant_y += lop * dy
                bright += p * table[k, 5]
            bright += sx * slant_x + sy * slant_y
            i, j = indices[n, 0], indices[n, 1]
            right[0] += light * along
            right[1] += light * across
            right[2] += light * i * along
            right[3] += light * i * across
            right[4] += light * j * along
            right[5] += light * j * across
            right[6] += light * large
            right[7] += light * small
            for m in range(6):
                right[9 + m] += bright * lights[n, 1 + m]
            right[15] += light * fall
            right[16] += light * slant_x
            right[17] += light * slant_y
            right[18] += light * (vx * slant_x + vy * slant_y)
            lifted = light * (
                at[LARGE_BY_RISE] * large
                + at[SMALL_BY_RISE] * small
                - at[OUT_X] * along
                - at[OUT_Y] * across
            )
            right[19] += lifted * at[LEVER_X]
            right[20] += lifted * at[LEVER_Y]
            right[21] += light * small * at[WIDER_PX]
    return right, chi2, count


@numba.njit(nogil=True, cache=True)
def brightness(
    picture: npt.NDArray[np.float32],
    places: Array,
    background: float,
    tables: Array,
    step: float,
    ceiling: float,
) -> Array:  # pragma: no cover - compiled
    """Sums (read - background) profile and profile^2 about every place, as in ``accumulate``, shape
    (i, j, 2).
    """
    height, width = picture.shape
    reach = step * (tables.shape[1] - 2)
    sums = np.zeros((places.shape[0], places.shape[1], 2))
    for i in range(places.shape[0]):
        for j in range(places.shape[1]):
            cx, cy = places[i, j, X], places[i, j, Y]
            table = tables[int(places[i, j, TABLE])]
            stride = max(1, int(reach / 12.0))
            for row in range(
                max(0, int(np.ceil(cy - reach))), min(height - 1, int(cy + reach)) + 1, stride
            ):
                for column in range(
                    max(0, int(np.ceil(cx - reach))), min(width - 1, int(cx + reach)) + 1, stride
                ):
                    r = np.hypot(column - cx, row - cy)
                    if r < reach and picture[row, column] < ceiling:
                        share = table[int(r / step), 0]
                        sums[i, j, 0] += share * (picture[row, column] - background)
                        sums[i, j, 1] += share * share
    return sums

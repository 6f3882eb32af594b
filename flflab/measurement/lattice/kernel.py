"""What the fits of single micro-images sum over pixels, compiled.

A micro-image at c of light l lights the pixel at p by l (1 + slope . (p - c) / R) T(t), where
t = R + (r - R - wider) exp(-softer) and r = |p - c|: T is the profile that all share, R its radius
at half light.
Neighbours that reach the pixel add theirs; the ground below is each micro-image's own.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

X, Y, LIGHT, GROUND, WIDER, SOFTER, SLOPE_X, SLOPE_Y = range(8)
VALUES = 8  # of a micro-image, in this order
OUTLIER = 36.0  # squared deviations of a pixel beyond which it is left out


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _share(
    column: float,
    row: float,
    one: Array,
    extent: Array,
    table: Array,
    radius: float,
    step: float,
) -> float:  # pragma: no cover - compiled
    """Share of a micro-image's light that a pixel gets; 0 where the profile has ended."""
    dx, dy = column - one[X], row - one[Y]
    square = dx * dx + dy * dy
    if square >= extent[1]:
        return 0.0
    r = math.sqrt(square)
    place = max((radius + (r - radius - one[WIDER]) * extent[0]) / step, 0.0)
    k = min(int(place), len(table) - 2)
    value = table[k, 0] + (place - k) * (table[k + 1, 0] - table[k, 0])
    return value * (1.0 + (one[SLOPE_X] * dx + one[SLOPE_Y] * dy) / radius)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _light(
    column: float,
    row: float,
    one: Array,
    extent: Array,
    table: Array,
    radius: float,
    step: float,
    g: Array,
) -> bool:  # pragma: no cover - compiled
    """Derivatives of a pixel by the values of a micro-image, that by LIGHT being its share of the
    light. False where the profile has ended.
    """
    dx, dy = column - one[X], row - one[Y]
    square = dx * dx + dy * dy
    if square >= extent[1]:
        return False
    r, shrink = math.sqrt(square), extent[0]
    place = max((radius + (r - radius - one[WIDER]) * shrink) / step, 0.0)
    k = min(int(place), len(table) - 2)
    t = place - k
    value = table[k, 0] + t * (table[k + 1, 0] - table[k, 0])
    fall = (table[k, 1] + t * (table[k + 1, 1] - table[k, 1])) * shrink
    tilt = 1.0 + (one[SLOPE_X] * dx + one[SLOPE_Y] * dy) / radius
    light, along = one[LIGHT], fall / max(r, 1e-9)
    g[X] = -light * (tilt * along * dx + one[SLOPE_X] / radius * value)
    g[Y] = -light * (tilt * along * dy + one[SLOPE_Y] / radius * value)
    g[LIGHT] = tilt * value
    g[GROUND] = 1.0
    g[WIDER] = -light * tilt * fall
    g[SOFTER] = -light * tilt * fall * (r - radius - one[WIDER])
    g[SLOPE_X] = light * value * dx / radius
    g[SLOPE_Y] = light * value * dy / radius
    return True


@numba.njit(nogil=True, cache=True, error_model="numpy")
def sum_up(
    picture: npt.NDArray[np.float32],
    members: Whole,
    values: Array,
    extents: Array,
    neighbours: Whole,
    profile: tuple[Array, float, float],
    every: Whole,
    noise: Array,
    size: int,
    joint: bool,
    sectors: int,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """Normal matrices of some micro-images, those with each neighbour, right sides by sectors,
    and chi^2, number of pixels, number left out, lag-one products, squares, and share of noise.

    Args:
        picture: DN.
        members: which micro-images.
        values: of all, shape (n, VALUES).
        extents: of all: exp(-softer), and the square of the distance at which the profile ends.
        neighbours: of all, -1 where there is none, shape (n, most).
        profile: table of T and its slope, radius at half light, step, px.
        every: of how many rows and columns one is looked at, by micro-image.
        noise: dark variance, gain, full scale, offset, share of the light that the profile leaves.
        size: how many of the values are looked at.
        joint: whether the matrices with neighbours are summed.
        sectors: round the centre, in which right sides are summed apart.
    """
    table, radius, step = profile
    normal = np.zeros((len(members), size, size))
    cross = np.zeros((len(members) if joint else 0, neighbours.shape[1], size, size))
    right = np.zeros((len(members), sectors, size))
    fit = np.zeros((len(members), 6))
    g, others = np.zeros(VALUES), np.zeros((neighbours.shape[1], VALUES))
    lit = np.zeros(neighbours.shape[1], dtype=np.bool_)
    height, width = picture.shape
    for m in range(len(members)):
        n = members[m]
        one = values[n]
        reach = math.sqrt(extents[n, 1])
        misfit = (noise[4] * one[LIGHT]) ** 2
        stride = every[n]
        first_row, first_column = max(0, math.ceil(one[Y] - reach)), math.ceil(one[X] - reach)
        for row in range(first_row, min(height - 1, math.floor(one[Y] + reach)) + 1, stride):
            half = math.sqrt(max(reach * reach - (row - one[Y]) ** 2, 0.0))
            start = max(0, math.ceil(one[X] - half))
            start += (first_column - start) % stride
            before = 0.0
            for column in range(start, min(width - 1, math.floor(one[X] + half)) + 1, stride):
                read = picture[row, column]
                if not read < noise[2]:
                    continue
                if not _light(column, row, one, extents[n], table, radius, step, g):
                    continue
                expected = one[GROUND] + one[LIGHT] * g[LIGHT]
                for k in range(neighbours.shape[1]):
                    o = neighbours[n, k]
                    if o < 0:
                        break
                    there = values[o]
                    if not joint:
                        share = _share(column, row, there, extents[o], table, radius, step)
                        expected += there[LIGHT] * share
                        continue
                    lit[k] = _light(column, row, there, extents[o], table, radius, step, others[k])
                    if lit[k]:
                        expected += there[LIGHT] * others[k, LIGHT]
                variance = noise[0] + noise[1] * max(expected - noise[3], 0.0) + misfit
                rest = read - expected
                if rest * rest > OUTLIER * variance:
                    fit[m, 2] += 1
                    continue
                weight = 1.0 / variance
                fit[m, 0] += weight * rest * rest
                fit[m, 1] += 1
                fit[m, 3] += before * rest
                fit[m, 4] += rest * rest
                fit[m, 5] += weight * (variance - misfit)
                before = rest
                sector = 0
                if sectors > 1:
                    turn = math.atan2(row - one[Y], column - one[X]) / (2 * math.pi) + 0.5
                    sector = min(int(turn * sectors), sectors - 1)
                for a in range(size):
                    scaled = weight * g[a]
                    right[m, sector, a] += scaled * rest
                    for b in range(a + 1):
                        normal[m, a, b] += scaled * g[b]
                if joint:
                    for k in range(neighbours.shape[1]):
                        if lit[k] and neighbours[n, k] >= 0:
                            others[k, GROUND] = 0.0
                            for a in range(size):
                                scaled = weight * g[a]
                                for b in range(size):
                                    cross[m, k, a, b] += scaled * others[k, b]
        for a in range(size):
            for b in range(a):
                normal[m, b, a] = normal[m, a, b]
    return normal, cross, right, fit


@numba.njit(nogil=True, cache=True, error_model="numpy")
def sum_profile(
    picture: npt.NDArray[np.float32],
    members: Whole,
    values: Array,
    neighbours: Whole,
    profile: tuple[Array, float, float],
    spline: tuple[float, int, float],
    every: Whole,
    noise: Array,
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Normal matrix and right side of the profile's coefficients: uniform cubic B-splines of t.

    Args:
        picture: as ``sum_up``'s, as the following but ``spline``.
        members: see there.
        values: see there.
        neighbours: see there.
        profile: the one before, by which pixels are weighed, as ``sum_up``'s.
        spline: spacing of the knots in px, number of coefficients, distance at which it ends.
        every: see there.
        noise: see there.
    """
    table, radius, step = profile
    spacing, count, end = spline
    normal, right = np.zeros((count, count)), np.zeros(count)
    most = 4 * (neighbours.shape[1] + 1)
    index, share = np.zeros(most, dtype=np.int64), np.zeros(most)
    height, width = picture.shape
    for m in range(len(members)):
        n = members[m]
        one = values[n]
        reach = radius + one[WIDER] + (end - radius) * math.exp(one[SOFTER])
        stride = every[n]
        for row in range(
            max(0, math.ceil(one[Y] - reach)),
            min(height - 1, math.floor(one[Y] + reach)) + 1,
            stride,
        ):
            half = math.sqrt(max(reach * reach - (row - one[Y]) ** 2, 0.0))
            for column in range(
                max(0, math.ceil(one[X] - half)),
                min(width - 1, math.floor(one[X] + half)) + 1,
                stride,
            ):
                read = picture[row, column]
                if not read < noise[2]:
                    continue
                used, expected = 0, one[GROUND]
                for k in range(-1, neighbours.shape[1]):
                    o = n if k < 0 else neighbours[n, k]
                    if o < 0:
                        continue
                    dx, dy = column - values[o, X], row - values[o, Y]
                    r = math.sqrt(dx * dx + dy * dy)
                    place = radius + (r - radius - values[o, WIDER]) * math.exp(-values[o, SOFTER])
                    entry = int(max(place, 0.0) / step)
                    place = max(place, 0.0) / spacing
                    j = int(place)
                    if j + 3 >= count:
                        continue
                    t = place - j
                    tilt = 1.0 + (values[o, SLOPE_X] * dx + values[o, SLOPE_Y] * dy) / radius
                    light = values[o, LIGHT] * tilt / 6.0
                    if entry < len(table):
                        expected += 6.0 * light * table[entry, 0]
                    for c in range(4):
                        index[used + c] = j + c
                    share[used] = light * (1 - t) ** 3
                    share[used + 1] = light * (3 * t**3 - 6 * t**2 + 4)
                    share[used + 2] = light * (-3 * t**3 + 3 * t**2 + 3 * t + 1)
                    share[used + 3] = light * t**3
                    used += 4
                rest = read - one[GROUND]
                misfit = noise[4] * one[LIGHT]
                variance = noise[0] + noise[1] * max(expected - noise[3], 0.0) + misfit * misfit
                weight = 1.0 / variance
                for a in range(used):
                    right[index[a]] += weight * share[a] * rest
                    for b in range(used):
                        normal[index[a], index[b]] += weight * share[a] * share[b]
    return normal, right


@numba.njit(nogil=True, cache=True)
def with_neighbours(
    members: Whole, neighbours: Whole, normal: Array, cross: Array, right: Array
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Systems of each of some micro-images together with its neighbours, itself first; a missing
    neighbour is left at rest.
    """
    around = neighbours.shape[1] + 1
    size = right.shape[1]
    systems = np.zeros((len(members), around * size, around * size))
    sides = np.zeros((len(members), around * size))
    group = np.zeros(around, dtype=np.int64)
    for m in range(len(members)):
        group[0] = members[m]
        group[1:] = neighbours[members[m]]
        for p in range(around):
            here = slice(p * size, (p + 1) * size)
            if group[p] < 0:
                systems[m, here, here] = np.eye(size)
                continue
            systems[m, here, here] = normal[group[p]]
            sides[m, here] = right[group[p]]
            for k in range(around - 1):
                for q in range(around):
                    if group[q] >= 0 and neighbours[group[p], k] == group[q]:
                        systems[m, here, q * size : (q + 1) * size] = cross[group[p], k]
    return systems, sides


@numba.njit(nogil=True, cache=True, error_model="numpy")
def draw(
    picture: npt.NDArray[np.float32],
    values: Array,
    extents: Array,
    profile: tuple[Array, float, float],
) -> None:  # pragma: no cover - compiled
    """Add the light of micro-images to a picture, their ground left out.

    Args:
        picture: DN, added to.
        values: of all, shape (n, VALUES).
        extents: as ``sum_up``'s.
        profile: as ``sum_up``'s.
    """
    table, radius, step = profile
    height, width = picture.shape
    for n in range(len(values)):
        one, reach = values[n], math.sqrt(extents[n, 1])
        left, right = max(0, math.ceil(one[X] - reach)), min(width - 1, math.floor(one[X] + reach))
        for row in range(
            max(0, math.ceil(one[Y] - reach)), min(height - 1, math.floor(one[Y] + reach)) + 1
        ):
            for column in range(left, right + 1):
                share = _share(column, row, one, extents[n], table, radius, step)
                picture[row, column] += one[LIGHT] * share

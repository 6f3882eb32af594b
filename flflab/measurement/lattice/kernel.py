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


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _light(
    dx: float,
    dy: float,
    one: Array,
    shrink: float,
    profile: tuple[Array, float, float],
    g: Array,
) -> None:  # pragma: no cover - compiled
    """Derivatives of a pixel by the values of a micro-image, that by LIGHT being its share of the
    light.
    """
    table, radius, step = profile
    r = math.sqrt(dx * dx + dy * dy)
    away = r - radius - one[WIDER]
    place = max((radius + away * shrink) / step, 0.0)
    k = min(int(place), len(table) - 2)
    t = place - k
    value = table[k, 0] + t * (table[k + 1, 0] - table[k, 0])
    fall = (table[k, 1] + t * (table[k + 1, 1] - table[k, 1])) * shrink
    along_x, along_y = one[SLOPE_X] / radius, one[SLOPE_Y] / radius
    tilt, light = 1.0 + along_x * dx + along_y * dy, one[LIGHT]
    rim = light * tilt * fall
    outwards = rim / max(r, 1e-9)
    g[X] = -outwards * dx - light * along_x * value
    g[Y] = -outwards * dy - light * along_y * value
    g[LIGHT] = tilt * value
    g[GROUND] = 1.0
    g[WIDER] = -rim
    g[SOFTER] = -rim * away
    g[SLOPE_X] = light * value * dx / radius
    g[SLOPE_Y] = light * value * dy / radius


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def sum_up(
    picture: npt.NDArray[np.float32],
    members: Whole,
    values: Array,
    extents: Array,
    neighbours: Whole,
    profile: tuple[Array, float, float],
    every: int,
    noise: Array,
    sectors: int,
) -> tuple[Array, Array, Array, Array]:  # pragma: no cover - compiled
    """Normal matrices of some micro-images, those with each neighbour, right sides by sectors,
    and number of pixels, number left out, lag-one products, and share of noise.

    Args:
        picture: DN.
        members: which micro-images.
        values: of all, shape (n, VALUES).
        extents: of all: exp(-softer), and the square of the distance at which the profile ends.
        neighbours: of all, first, -1 after them, shape (n, most).
        profile: table of T and its slope, radius at half light, step, px.
        every: of how many rows and columns one is looked at.
        noise: dark variance, gain, full scale, offset, share of the light that the profile leaves.
        sectors: round the centre, in which right sides are summed apart.
    """
    most = neighbours.shape[1]
    normal = np.zeros((len(members), VALUES, VALUES))
    cross = np.zeros((len(members), most, VALUES, VALUES))
    right = np.zeros((len(members), sectors, VALUES))
    fit = np.zeros((len(members), 4))
    g, others, lit = np.zeros(VALUES), np.zeros((most, VALUES)), np.zeros(most, dtype=np.int64)
    height, width = picture.shape
    for m in range(len(members)):
        n = members[m]
        one, reach = values[n], math.sqrt(extents[n, 1])
        misfit = (noise[4] * one[LIGHT]) ** 2
        top = max(0, math.ceil(one[Y] - reach))
        for row in range(top + -top % every, min(height, math.floor(one[Y] + reach) + 1), every):
            dy = row - one[Y]
            half = math.sqrt(max(reach * reach - dy * dy, 0.0))
            left = max(0, math.ceil(one[X] - half))
            right_end = min(width, math.floor(one[X] + half) + 1)
            before = 0.0
            for column in range(left + -left % every, right_end, every):
                read = picture[row, column]
                if not read < noise[2]:
                    continue
                dx = column - one[X]
                _light(dx, dy, one, extents[n, 0], profile, g)
                expected, count = one[GROUND] + one[LIGHT] * g[LIGHT], 0
                for k in range(most):
                    o = neighbours[n, k]
                    if o < 0:
                        break
                    there_x, there_y = column - values[o, X], row - values[o, Y]
                    if there_x * there_x + there_y * there_y < extents[o, 1]:
                        there = others[count]
                        _light(there_x, there_y, values[o], extents[o, 0], profile, there)
                        expected += values[o, LIGHT] * there[LIGHT]
                        there[GROUND] = 0.0
                        lit[count] = k
                        count += 1
                variance = noise[0] + noise[1] * max(expected - noise[3], 0.0) + misfit
                rest = read - expected
                if rest * rest > OUTLIER * variance:
                    fit[m, 1] += 1
                    continue
                weight = 1.0 / variance
                fit[m, 0] += 1
                fit[m, 2] += before * rest
                fit[m, 3] += weight * (variance - misfit)
                before = rest
                sector = 0
                if sectors > 1:
                    turn = math.atan2(dy, dx) / (2 * math.pi) + 0.5
                    sector = min(int(turn * sectors), sectors - 1)
                for a in range(VALUES):
                    scaled = weight * g[a]
                    right[m, sector, a] += scaled * rest
                    for b in range(VALUES):
                        normal[m, a, b] += scaled * g[b]
                    for c in range(count):
                        for b in range(VALUES):
                            cross[m, lit[c], a, b] += scaled * others[c, b]
    return normal, cross, right, fit


@numba.njit(nogil=True, cache=True, error_model="numpy")
def sum_profile(
    picture: npt.NDArray[np.float32],
    members: Whole,
    values: Array,
    neighbours: Whole,
    profile: tuple[Array, float, float],
    spline: tuple[float, int, float],
    every: int,
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
    spacing, count, longest = spline
    normal, right = np.zeros((count, count)), np.zeros(count)
    most = 4 * (neighbours.shape[1] + 1)
    index, share = np.zeros(most, dtype=np.int64), np.zeros(most)
    height, width = picture.shape
    for m in range(len(members)):
        n = members[m]
        one = values[n]
        reach = radius + one[WIDER] + (longest - radius) * math.exp(one[SOFTER])
        top = max(0, math.ceil(one[Y] - reach))
        for row in range(top + -top % every, min(height, math.floor(one[Y] + reach) + 1), every):
            half = math.sqrt(max(reach * reach - (row - one[Y]) ** 2, 0.0))
            left = max(0, math.ceil(one[X] - half))
            end = min(width, math.floor(one[X] + half) + 1)
            for column in range(left + -left % every, end, every):
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
    g = np.zeros(VALUES)
    height, width = picture.shape
    for n in range(len(values)):
        one, reach = values[n], math.sqrt(extents[n, 1])
        left, right = max(0, math.ceil(one[X] - reach)), min(width - 1, math.floor(one[X] + reach))
        for row in range(
            max(0, math.ceil(one[Y] - reach)), min(height - 1, math.floor(one[Y] + reach)) + 1
        ):
            for column in range(left, right + 1):
                dx, dy = column - one[X], row - one[Y]
                if dx * dx + dy * dy < extents[n, 1]:
                    _light(dx, dy, one, extents[n, 0], profile, g)
                    picture[row, column] += one[LIGHT] * g[LIGHT]

"""Diffracted images of targets without lines, dots and pictures: fields over the target for every
term of the transfer functions.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.special import j1

from flflab.image.diffraction.border import read_sheet, read_waves
from flflab.image.diffraction.falloff import mean_falloff
from flflab.image.diffraction.modes import Modes
from flflab.image.diffraction.ruled import spline_weights
from flflab.image.diffraction.shading import WEIGHTS, weigh_pupil
from flflab.image.diffraction.table import fast_length
from flflab.image.diffraction.terms import shade_pairs, weigh_pairs
from flflab.image.geometry.rim import place_on_rim
from flflab.targets import Picture

Array = npt.NDArray[np.float64]
SingleArray = npt.NDArray[np.float32]
ComplexArray = npt.NDArray[np.complex128]
SingleComplexArray = npt.NDArray[np.complex64]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

MOST_WAVES, ROOM = 64, 1 << 26  # waves at a time, and the most numbers they may hold
TOGETHER = (
    8  # terms whose waves are put in their places at a time: a line of the processor's memory
)


@dataclass(frozen=True)
class Grid:
    """An even grid over a part of the target, in pixels of the sensor along the target's axes x'
    and y'.

    Attributes:
        axes: x' and y' as unit vectors on the sensor, rows.
        first: first wanted position along x' and y'.
        samples: positions a pixel.
        count: how many are wanted, along x' and y'.
        length: how many the Fourier sums have.
    """

    axes: Array
    first: tuple[float, float]
    samples: float
    count: tuple[int, int]
    length: tuple[int, int]


@dataclass(frozen=True)
class Fields:
    """Spline coefficients over a grid, shape (Y, X) and (Y, X, K), single precision.

    Attributes:
        whole: of the unclipped pupil over a pixel; empty where the unclipped pupil is not asked
            for.
        part: the same over a part of a pixel.
        waves: some terms of the clipped pupils' sum, each for the cosine of the sensor point's
            angle and for the sine.
        terms: which terms, shape (K / 2,).
    """

    whole: SingleArray
    part: SingleArray
    waves: SingleArray
    terms: Whole


def make_grid(axes: Array, low: Array, high: Array, pad: Array, samples: float) -> Grid:
    """A grid from low to high, pixels along x' and y'; what lies ``pad`` beyond its ends must be
    black or of no matter.
    """
    first = np.floor(low - 2 / min(samples, 1.0))
    count = np.ceil((high - first) * samples).astype(int) + 4
    length = [fast_length(n) for n in count + pad * samples]
    return Grid(
        axes,
        (float(first[0]), float(first[1])),
        samples,
        (int(count[0]), int(count[1])),
        (length[0], length[1]),
    )


def dots_spectrum(centres: Array, radii: Array, x: Array, y: Array) -> ComplexArray:
    """Spectrum of white discs at frequencies along x' and y', shape (y, x); centres (n, 2) from the
    grid's first position, in pixels.
    """
    turn = np.exp(-2j * np.pi * y[:, None] * centres[:, 1]) @ np.exp(
        -2j * np.pi * centres[:, :1] * x
    )
    (across, column), (along, row) = (
        np.unique(np.abs(some), return_inverse=True) for some in (x, y)
    )  # alike in all four quarters
    z = 2 * np.pi * np.maximum(np.hypot(across * radii[0], along[:, None] * radii[1]), 1e-9)
    return math.pi * radii[0] * radii[1] * (2 * j1(z) / z)[row[:, None], column] * turn


def picture_spectrum(
    picture: Picture,
    scales: Array,
    low: Array,
    high: Array,
    first: tuple[float, float],
    x: Array,
    y: Array,
) -> ComplexArray:
    """Spectrum of the part of a picture between low and high (pixels) at frequencies along x' and
    y', shape (y, x).
    """
    parts: list[ComplexArray] = []
    kept: list[slice] = []
    for axis, frequency in ((0, x), (1, y)):
        count = picture.values.shape[1 - axis]
        side = picture.texel / scales[axis]
        borders = (np.arange(count + 1) - count / 2) * side
        start, end = np.maximum(borders[:-1], low[axis]), np.minimum(borders[1:], high[axis])
        inside = np.flatnonzero(start < end)
        kept.append(slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, 0))
        middle, width = (0.5 * (start + end))[kept[axis]], (end - start)[kept[axis]]
        parts.append(
            np.exp(-2j * np.pi * frequency[:, None] * (middle - first[axis]))
            * width
            * np.sinc(frequency[:, None] * width)
        )
    return parts[1] @ picture.values[kept[1], kept[0]] @ parts[0].T


def kept_frequencies(grid: Grid, band: float) -> tuple[Whole, Whole, Array, Array]:
    """Indices and values of the frequencies of a grid's Fourier sums below the end of the band,
    along x' and along y'.
    """
    x, y = (
        np.asarray(fft.fftfreq(length, 1 / grid.samples), dtype=np.float64)
        for length in grid.length
    )
    column, row = np.flatnonzero(np.abs(x) < band), np.flatnonzero(np.abs(y) < band)
    return column, row, x[column], y[row]


def on_sensor(grid: Grid, x: Array, y: Array) -> Array:
    """Frequencies along x' and y' as vectors in the sensor's frame, cycles/pixel, shape (y, x,
    2).
    """
    return np.asarray(np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1) @ grid.axes)


def make_fields(
    modes: Modes, grid: Grid, spectrum: ComplexArray, box: float, part_box: float
) -> Iterator[Fields]:
    """Image a target through every term, some at a time.

    Args:
        modes: the transfer functions.
        grid: where.
        spectrum: of the target at the ``kept_frequencies``.
        box: side of the square over which a pixel gathers light, pixels.
        part_box: the same of a part of it.
    """
    column, row, x, y = kept_frequencies(grid, modes.band)
    f = on_sensor(grid, x, y)
    prefilter = [(2 + np.cos(2 * np.pi * frequency / grid.samples)) / 3 for frequency in (x, y)]
    wanted = (
        spectrum
        * modes.kind.smear.transfer(f)
        * (grid.samples**2 / (prefilter[0] * prefilter[1][:, None]))
    )
    base, beyond = modes.places(np.hypot(f[..., 0], f[..., 1]))
    by_pixel, by_part, angle = (np.empty(wanted.shape, dtype=np.complex64) for _ in range(3))
    box_over(by_pixel, by_part, angle, wanted, f, box, part_box)
    unclipped = (
        modes.core_fine[base].astype(np.float32)
        + beyond * np.diff(modes.core_fine).astype(np.float32)[base]
    )

    up = np.empty((grid.length[1], len(column)), dtype=np.complex64)
    rows = np.empty((grid.count[1], grid.length[0]), dtype=np.complex64)
    rising = int((x >= 0).sum())  # the others lie at the end

    def field() -> SingleComplexArray:
        """The Fourier sums of ``up``, which is used up."""
        along = np.asarray(fft.ifft(up, axis=0, overwrite_x=True))[: grid.count[1]]
        rows[:, :rising], rows[:, rising:] = along[:, :rising], 0.0
        rows[:, rows.shape[1] - (len(column) - rising) :] = along[:, rising:]
        return np.asarray(fft.ifft(rows, axis=1, overwrite_x=True), dtype=np.complex64)[
            :, : grid.count[0]
        ]

    def core(pattern: SingleComplexArray) -> SingleArray:
        up[:] = 0.0
        up[row] = unclipped * pattern
        return np.ascontiguousarray(field().real)

    whole, part = core(by_pixel), core(by_part)
    at_once = max(1, min(MOST_WAVES, ROOM // whole.size) // 2)
    starts = range(0, len(modes.orders), at_once)
    turned, order = by_part, 0
    room = np.empty((min(TOGETHER, at_once, len(modes.orders)), *whole.shape), dtype=np.complex64)
    for start in starts or [0]:
        terms = np.arange(start, min(start + at_once, len(modes.orders)))
        waves = np.empty((*whole.shape, 2 * len(terms)), dtype=np.float32)
        for first in range(0, len(terms), TOGETHER):
            some = terms[first : first + TOGETHER]
            for index, (term, table) in enumerate(zip(some, modes.fine[some], strict=True)):
                while order < modes.orders[term]:
                    turned, order = turned * angle, order + 1
                up[:] = 0.0
                add_pattern(up, row, turned, table, base, beyond)
                room[index] = field()  # two real fields in one sum
            interleave(waves, first, room[: len(some)], modes.orders[some])
        yield Fields(whole if start == 0 else whole[:0, :0], part, waves, terms)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def box_over(
    by_pixel: SingleComplexArray,
    by_part: SingleComplexArray,
    angle: SingleComplexArray,
    wanted: ComplexArray,
    f: Array,
    box: float,
    part_box: float,
) -> None:
    """Fill in what a pixel leaves of some frequencies, what a part of it does, and their
    directions, exp(i alpha); see ``make_fields``.
    """
    for i in range(wanted.shape[0]):
        for j in range(wanted.shape[1]):
            x, y = f[i, j, 0], f[i, j, 1]
            by_pixel[i, j] = wanted[i, j] * (_sinc(x * box) * _sinc(y * box))
            by_part[i, j] = wanted[i, j] * (_sinc(x * part_box) * _sinc(y * part_box))
            size = math.sqrt(x * x + y * y)
            angle[i, j] = complex(x, y) / size if size > 0.0 else complex(1.0, 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sinc(x: float) -> float:
    return math.sin(math.pi * x) / (math.pi * x) if x != 0.0 else 1.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def interleave(waves: SingleArray, first: int, sums: SingleComplexArray, orders: Whole) -> None:
    """Put some terms' sums (K, Y, X) into their places among the waves (Y, X, ...) from the term
    ``first`` on, odd orders times i.
    """
    for i in range(sums.shape[1]):
        for j in range(sums.shape[2]):
            for k in range(sums.shape[0]):
                cos, sin = sums[k, i, j].real, sums[k, i, j].imag
                odd = orders[k] % 2 == 1
                waves[i, j, 2 * (first + k)] = -sin if odd else cos
                waves[i, j, 2 * (first + k) + 1] = cos if odd else sin


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_pattern(
    up: SingleComplexArray,
    rows: Whole,
    turned: SingleComplexArray,
    table: SingleArray,
    base: Whole,
    beyond: SingleArray,
) -> None:
    """Add a pattern to some rows: ``turned`` times what a table holds ``beyond`` the nodes
    ``base``, see ``Modes.places``.
    """
    for i in range(turned.shape[0]):
        for j in range(turned.shape[1]):
            node = base[i, j]
            up[rows[i], j] += turned[i, j] * (
                table[node] + beyond[i, j] * (table[node + 1] - table[node])
            )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def read_pairs(waves: SingleArray, column: float, row: float, weights: SingleArray) -> float:
    """The sum of so weighted waves (see ``Fields``) at a place of their grid."""
    i, j = int(column), int(row)
    by_column, by_row = spline_weights(column - i), spline_weights(row - j)
    total = 0.0
    for m in range(4):
        for n in range(4):
            total += by_row[m] * by_column[n] * read_waves(waves, j + m - 1, i + n - 1, weights)
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_fields(
    image: Array,
    rows: tuple[int, int],
    windows: Whole,
    centres: Array,
    origins: Array,
    looks: Array,
    levels: Array,
    rims: Array,
    steep: bool,
    bright: float,
    ring: tuple[float, float],
    offsets: Array,
    amounts: Array,
    box: float,
    xs: Array,
    ys: Array,
    pixel: float,
    sheets: tuple[SingleArray, SingleArray, SingleArray],
    terms: tuple[Whole, Whole, Array],
    count: int,
    first: tuple[float, float],
    samples: float,
    slants: Array,
    moments: Array,
    fit: Array,
    blur: float,
    nodes: Array,
    chosen: Chosen,
) -> None:
    """Add the light of some fields to the rows from rows[0] to below rows[1].

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last; shape (N, 4).
        centres: of the micro-images, mm, shape (N, 2).
        origins: position on the target seen from there along x' and y', in pixels of either
            direction, shape (N, 2).
        looks: change of that position per pixel on the sensor, shape (N, 2, 2).
        levels: light at full pupil.
        rims: see ``Kind``.
        steep: whether its rim is too narrow for terms of its own.
        bright: see ``PixelParts``.
        ring: the same.
        offsets: the same.
        amounts: the same.
        box: side of the square over which a pixel gathers light, pixels.
        xs: positions of the columns, mm.
        ys: of the rows.
        pixel: side of a pixel, mm.
        sheets: ``whole``, ``part`` and ``waves`` of ``Fields``.
        terms: ``orders``, ``polynomials`` and ``coefficients`` of those whose waves they are, see
            ``weigh_pairs``.
        count: steps of the table over a rim.
        first: see ``Grid``.
        samples: the same.
        slants: see ``slant_rows``.
        moments: see ``pupil_moments``.
        fit: see ``Shading``.
        blur: see ``Kind``.
        nodes: pupil points for steep rims.
        chosen: which pixels to compute.
    """
    unclipped, part, waves = sheets
    orders, polynomials, coefficients = terms
    weights, shaded = np.empty(2 * orders.size, dtype=np.float32), fit.shape[0] > 0
    told = np.ones(WEIGHTS)
    for entry in range(windows.shape[0]):
        rim = rims[entry]
        for row in range(max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])):
            dy = (ys[row] - centres[entry, 1]) / pixel
            for column in range(windows[entry, 0], windows[entry, 1]):
                dx = (xs[column] - centres[entry, 0]) / pixel
                from_centre = math.sqrt(dx * dx + dy * dy)
                whole = from_centre < rim[0] - bright
                if (
                    (whole and unclipped.size == 0)
                    or from_centre > rim[3] + 0.75
                    or not chosen[row, column]
                ):
                    continue
                if not ring[0] <= rim[0] - from_centre < ring[1]:
                    continue
                pieces = 1 if whole else offsets.size
                side = max(box / pieces, 1e-3)
                light = 0.0
                for j in range(pieces):
                    y = dy + (0.0 if whole else offsets[j] * box)
                    for i in range(pieces):
                        x = dx + (0.0 if whole else offsets[i] * box)
                        amount = 1.0 if whole else amounts[i] * amounts[j]
                        radial, share, look = place_on_rim(
                            x, y, side, rim, steep and not whole, count, nodes
                        )
                        falling, aside_x, aside_y = 1.0, 0.0, 0.0
                        if shaded:
                            falling = weigh_pupil(x, y, slants[entry], fit, told)
                            radial = max(radial, 0.0)
                        else:
                            falling, aside_x, aside_y = mean_falloff(
                                x, y, rim, slants[entry], moments
                            )
                        seen_x, seen_y = look * x + blur * aside_x, look * y + blur * aside_y
                        across = (
                            origins[entry, 0]
                            + looks[entry, 0, 0] * seen_x
                            + looks[entry, 0, 1] * seen_y
                            - first[0]
                        ) * samples
                        along = (
                            origins[entry, 1]
                            + looks[entry, 1, 0] * seen_x
                            + looks[entry, 1, 1] * seen_y
                            - first[1]
                        ) * samples
                        if share <= 0.0 or not (
                            1.0 <= across < part.shape[1] - 2.0
                            and 1.0 <= along < part.shape[0] - 2.0
                        ):
                            continue
                        if radial >= 0.0:
                            if orders.size > 0:
                                weigh_pairs(radial, math.atan2(y, x), orders, coefficients, weights)
                                if shaded:
                                    shade_pairs(polynomials, told, weights)
                                light += (
                                    amount * falling * read_pairs(waves, across, along, weights)
                                )
                        elif unclipped.size > 0:
                            base_row, base_column = int(along), int(across)
                            by_row, by_column = (
                                spline_weights(along - base_row),
                                spline_weights(across - base_column),
                            )
                            light += (
                                amount
                                * falling
                                * share
                                * read_sheet(
                                    unclipped if whole else part,
                                    base_row,
                                    base_column,
                                    by_row,
                                    by_column,
                                )
                            )
                image[row, column] += levels[entry] * light

"""Diffracted images of targets without lines, dots and pictures: fields over the target for every term of the transfer functions."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy import fft

from flflab.image.diffraction_border import radial_value, read_sheet
from flflab.image.diffraction_falloff import mean_falloff
from flflab.image.diffraction_ruled import spline_weights
from flflab.image.diffraction_table import Modes, fast_length
from flflab.image.rim import place_on_rim
from flflab.optics.contrast import disc_transfer
from flflab.targets import Picture

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

MOST_SAMPLES = 16.0


@dataclass(frozen=True)
class Grid:
    """An even grid over a part of the target, in pixels of the sensor along the target's axes x' and y'.

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
class Field:
    """Spline coefficients of one term over a grid; a term of -1 is the unclipped pupil over a pixel, -2 over a part of one."""

    term: int
    order: int
    even: Array
    odd: Array


def make_grid(axes: Array, low: Array, high: Array, pad: float, cutoff: float, tolerance: float) -> Grid:
    """A grid from low to high, pixels; what lies ``pad`` beyond its ends must be black or of no matter."""
    samples = max(2.25 if tolerance >= 1e-3 else 4.0, min(4.5 * cutoff, 0.1 / tolerance, MOST_SAMPLES))
    first = np.floor(low) - 2
    count = np.ceil((high - first + 3) * samples).astype(int)
    length = [fast_length(n + pad * samples) for n in count]
    return Grid(axes, (float(first[0]), float(first[1])), samples, (int(count[0]), int(count[1])), (length[0], length[1]))


def dot_spectrum(centre: Array, radii: Array, x: Array, y: Array) -> ComplexArray:
    """Spectrum of a white disc at frequencies along x' and y', shape (y, x); centre from the grid's first position, all in pixels."""
    size = np.hypot(x * radii[0], y[:, None] * radii[1])
    turn = np.exp(-2j * np.pi * (y * centre[1]))[:, None] * np.exp(-2j * np.pi * (x * centre[0]))
    return math.pi * radii[0] * radii[1] * disc_transfer(2.0, size) * turn


def picture_spectrum(
    picture: Picture, scales: Array, low: Array, high: Array, first: tuple[float, float], x: Array, y: Array
) -> ComplexArray:
    """Spectrum of a picture's texels between low and high (pixels) at frequencies along x' and y', shape (y, x)."""
    parts: list[ComplexArray] = []
    kept: list[slice] = []
    for axis, frequency in ((0, x), (1, y)):
        count = picture.values.shape[1 - axis]
        side = picture.texel / scales[axis]
        places = (np.arange(count) - (count - 1) / 2) * side
        inside = np.flatnonzero((places > low[axis]) & (places < high[axis]))
        kept.append(slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, 0))
        turn = np.exp(-2j * np.pi * frequency[:, None] * (places[kept[axis]] - first[axis]))
        parts.append(turn * (side * np.sinc(frequency * side))[:, None])
    return parts[1] @ picture.values[kept[1], kept[0]] @ parts[0].T


def kept_frequencies(grid: Grid, cutoff: float) -> tuple[Whole, Whole, Array, Array]:
    """Indices and values of the frequencies of a grid's Fourier sums below the cutoff, along x' and along y'."""
    x, y = (np.asarray(fft.fftfreq(length, 1 / grid.samples), dtype=np.float64) for length in grid.length)
    column, row = np.flatnonzero(np.abs(x) < cutoff), np.flatnonzero(np.abs(y) < cutoff)
    return column, row, x[column], y[row]


def make_fields(modes: Modes, grid: Grid, spectrum: ComplexArray, box: float, parts: int) -> Iterator[Field]:
    """Image a target through every term, one after the other.

    Args:
        modes: the transfer functions.
        grid: where.
        spectrum: of the target at the ``kept_frequencies``.
        box: side of the square over which a pixel gathers light, pixels.
        parts: parts a side of it.
    """
    column, row, x, y = kept_frequencies(grid, modes.kind.cutoff)
    f = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1) @ grid.axes
    size, alpha = np.hypot(f[..., 0], f[..., 1]), np.arctan2(f[..., 1], f[..., 0])
    prefilter = [(2 + np.cos(2 * np.pi * frequency / grid.samples)) / 3 for frequency in (x, y)]
    wanted = spectrum * modes.kind.smear.transfer(f) * grid.samples**2 / (prefilter[0] * prefilter[1][:, None])

    def field(pattern: ComplexArray, side: float) -> ComplexArray:
        full = np.zeros((grid.length[1], grid.length[0]), dtype=np.complex128)
        full[np.ix_(row, column)] = wanted * pattern * np.sinc(f[..., 0] * side) * np.sinc(f[..., 1] * side)
        return np.asarray(fft.ifft2(full, overwrite_x=True), dtype=np.complex128)[: grid.count[1], : grid.count[0]]

    core = modes.spectrum(-1, size).astype(np.complex128)
    for term, side in ((-1, box), (-2, box / parts)):
        yield Field(term, 0, np.ascontiguousarray(field(core, side).real), np.zeros((1, 1)))
    for term, order in enumerate(modes.orders):
        both = np.cos(order * alpha) + 1j * np.sin(order * alpha)  # two real fields in one sum
        found = field(modes.spectrum(term, size) * (1j if order % 2 else 1.0) * both, box / parts)
        yield Field(term, int(order), np.ascontiguousarray(found.real), np.ascontiguousarray(found.imag))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_field(
    image: Array,
    rows: tuple[int, int],
    windows: Whole,
    centres: Array,
    origins: Array,
    looks: Array,
    levels: Array,
    rims: Array,
    steep: bool,
    parts: int,
    box: float,
    xs: Array,
    ys: Array,
    pixel: float,
    term: int,
    order: int,
    even: Array,
    odd: Array,
    radial_term: Array,
    first: tuple[float, float],
    samples: float,
    slants: Array,
    moments: Array,
    nodes: Array,
    chosen: Chosen,
) -> None:
    """Add one field's light to the rows from rows[0] to below rows[1].

    Args:
        image: picture to add to, [row, column].
        rows: the band.
        windows: first column, column after the last, first row, row after the last; shape (N, 4).
        centres: of the micro-images, mm, shape (N, 2).
        origins: position on the target seen from there along x' and y', in pixels of either direction, shape (N, 2).
        looks: change of that position per pixel on the sensor, shape (N, 2, 2).
        levels: light at full pupil.
        rims: see ``Kind``.
        steep: whether its rim is too narrow for terms of its own.
        parts: parts a side of a pixel.
        box: side of the square over which a pixel gathers light, pixels.
        xs: positions of the columns, mm.
        ys: of the rows.
        pixel: side of a pixel, mm.
        term: see ``Field``.
        order: the same.
        even: the same.
        odd: the same.
        radial_term: the term's spline coefficients over radius.
        first: see ``Grid``.
        samples: the same.
        slants: see ``slant_rows``.
        moments: see ``pupil_moments``.
        nodes: pupil points for steep rims.
        chosen: which pixels to compute.
    """
    count = radial_term.size - 1
    for entry in range(windows.shape[0]):
        rim = rims[entry]
        for row in range(max(rows[0], windows[entry, 2]), min(rows[1], windows[entry, 3])):
            dy = (ys[row] - centres[entry, 1]) / pixel
            for column in range(windows[entry, 0], windows[entry, 1]):
                dx = (xs[column] - centres[entry, 0]) / pixel
                from_centre = math.sqrt(dx * dx + dy * dy)
                whole = from_centre < rim[0] - 0.75
                if whole != (term == -1) or from_centre > rim[3] + 0.75 or not chosen[row, column]:
                    continue
                pieces = 1 if whole else parts
                side = max(box / pieces, 1e-3)
                light = 0.0
                for j in range(pieces):
                    y = dy + ((j + 0.5) / pieces - 0.5) * box
                    for i in range(pieces):
                        x = dx + ((i + 0.5) / pieces - 0.5) * box
                        distance = math.sqrt(x * x + y * y)
                        radial, share, look = place_on_rim(x, y, side, rim, steep and not whole, count, nodes)
                        across = (origins[entry, 0] + look * (looks[entry, 0, 0] * x + looks[entry, 0, 1] * y) - first[0]) * samples
                        along = (origins[entry, 1] + look * (looks[entry, 1, 0] * x + looks[entry, 1, 1] * y) - first[1]) * samples
                        if share <= 0.0 or not (1.0 <= across < even.shape[1] - 2.0 and 1.0 <= along < even.shape[0] - 2.0):
                            continue
                        base_column, base_row = int(across), int(along)
                        by_row, by_column = spline_weights(along - base_row), spline_weights(across - base_column)
                        if term < 0:
                            if radial < 0.0:
                                light += share * read_sheet(even, base_row, base_column, by_row, by_column)
                            continue
                        if radial < 0.0:
                            continue
                        cos, sin = 1.0, 0.0
                        for _ in range(order):
                            cos, sin = (cos * x - sin * y) / distance, (sin * x + cos * y) / distance
                        seen = cos * read_sheet(even, base_row, base_column, by_row, by_column)
                        if order > 0:
                            seen += sin * read_sheet(odd, base_row, base_column, by_row, by_column)
                        light += radial_value(radial_term, radial) * seen
                weight = levels[entry] * mean_falloff(dx, dy, rim, slants[entry], moments)
                image[row, column] += weight * light / (pieces * pieces)

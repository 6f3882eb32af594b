"""What a target's upper and lower border take from the diffracted image of its lines: the light
that would come from beyond.

The light of the lines' continuation beyond a straight border, seen from a distance inside of it, is
a curve over x' for every distance and for every term of the transfer functions' sum. What comes far
no spline holds: it is put right by ``far``.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage
from scipy.interpolate import make_interp_spline

from flflab.image.diffraction.far import mean_light, poisson_light, poisson_transfer, poisson_weight
from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.modes import Modes
from flflab.image.diffraction.ruled import Line, line_spectrum, mirrored, spline_weights
from flflab.image.diffraction.shading import ODD
from flflab.image.diffraction.terms import weigh_waves

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
SingleArray = npt.NDArray[np.float32]
SingleComplexArray = npt.NDArray[np.complex64]
Whole = npt.NDArray[np.int64]

LEAST_PANELS = 100
FARTHEST = 400.0
FELT = 16  # nodes away a spline's coefficients feel a value by less than 1e-9
ROOM = 1 << 24  # numbers of patterns and sheets at a time


@dataclass(frozen=True)
class Border:
    """Spline coefficients of the light from beyond a border.

    Attributes:
        core: through an unclipped pupil over a pixel, shape (Y, X).
        part: the same over a part of a pixel.
        waves: the terms' light over a part of a pixel, each for the cosine of the sensor point's
            angle and, unless of order 0, for the sine: so K waves, those that are felt farthest
            first; shape (Y, X, K), single precision.
        terms: the term of each wave, shape (K,).
        turns: twice the order of the sensor point's turn for its cosine, 1 more for its sine, shape
            (K,).
        last: the row, counted from outside, after which a wave no longer matters, shape (K,).
        place: node of the border itself, nodes a unit and scale (pixels) of the distance's inverse
            hyperbolic sine; first position along x', pixels, and coefficients a pixel.
    """

    core: Array
    part: Array
    waves: SingleArray
    terms: Whole
    turns: Whole
    last: Array
    place: tuple[float, float, float, float, float]


NO_BORDER = Border(
    np.zeros((1, 1)),
    np.zeros((1, 1)),
    np.zeros((1, 1, 0), dtype=np.float32),
    np.zeros(0, dtype=np.int64),
    np.zeros(0, dtype=np.int64),
    np.zeros(0),
    (0.0, 1.0, 1.0, 0.0, 1.0),
)


def border_reach(kind: Kind, tolerance: float) -> float:
    """How far inside of a border it is felt, pixels."""
    return min(max(0.3 / (kind.cutoff * tolerance) / 2, 20.0), FARTHEST) + kind.extent


def make_borders(
    modes: Modes,
    line: Line,
    inwards: list[tuple[Array, tuple[float, float]]],
    box: float,
    part: float,
    tolerance: float,
) -> list[Border]:
    """Tabulate the light from beyond some borders.

    Args:
        modes: the transfer functions.
        line: the lines' grid along x'.
        inwards: direction from each border to the target's inside: mm on the target per pixel on
            the sensor along x and y; and the least and largest distance inside of it, pixels, at
            which it matters: one that ends before it begins does not.
        box: side of the square over which a pixel gathers light, pixels.
        part: the same of a part of it.
        tolerance: largest error asked for.
    """
    band = modes.band
    near = 4 + modes.kind.extent
    spacing = 0.5 * min(1.0, (tolerance / 0.002) ** 0.125) / max(1.0, band)
    farthest = border_reach(modes.kind, tolerance)
    nodes = math.ceil(math.asinh(farthest / near) / (spacing / near))
    distance = near * np.sinh(np.arange(-nodes, nodes + 1) * spacing / near)
    turn = np.linspace(0, np.pi, modes.spectra.shape[1])
    coarse = band * (1 - np.cos(turn)) / 2
    lines, steady = (_line_weights(one, turn, band) for one in (line, mean_light(line)))
    soft = poisson_transfer(np.hypot(coarse[:, None], coarse))
    borders: list[Border] = []
    for inward, (nearest, farthest) in inwards:
        first, last = (
            nodes + math.asinh(inside / near) * near / spacing for inside in (nearest, farthest)
        )
        first, last = max(math.floor(first) - 3, 0), min(math.ceil(last) + 4, 2 * nodes + 1)
        place = (float(nodes - first), near / spacing, near, line.first, line.samples)
        axes = np.stack([line.direction, inward])
        if nearest >= farthest or last - first <= 3:
            borders.append(NO_BORDER)
            continue
        wide = max(first - FELT, 0)
        weights = _step_weights(coarse, distance[wide : last + FELT])
        filtered = [
            ndimage.spline_filter1d(part, axis=1, mode="mirror")
            for part in (weights.real, weights.imag)
        ]
        kernel = np.asarray(
            filtered[0] + 1j * filtered[1], dtype=np.complex128
        )  # the prefilter over the rows is linear: done here, once
        some = np.ascontiguousarray(kernel[:, first - wide : last - wide])
        far = poisson_light(line, distance[wide : last + FELT])[first - wide : last - wide]
        far -= _sheets(
            np.stack([2 * soft, 0 * soft])[None], np.zeros(1, dtype=np.int64), some, steady
        )[0]
        borders.append(
            _border(modes, axes, coarse, some, lines, far, (box, part), tolerance, place)
        )
    return borders


def _border(
    modes: Modes,
    axes: Array,
    coarse: Array,
    kernel: ComplexArray,
    lines: Array,
    far: Array,
    sides: tuple[float, float],
    tolerance: float,
    place: tuple[float, float, float, float, float],
) -> Border:
    """One border; ``axes``: the lines' direction and the one inward, ``far``: see
    ``poisson_light``, ``sides``: of a pixel and its part.
    """
    f = np.stack(np.broadcast_arrays(coarse[:, None], np.concatenate([coarse, -coarse])), axis=-1)
    f = f @ (axes / np.hypot(axes[:, 0], axes[:, 1])[:, None])
    size, alpha = np.hypot(f[..., 0], f[..., 1]), np.arctan2(f[..., 1], f[..., 0])
    smeared = modes.kind.smear.transfer(f)
    boxes = [smeared * np.sinc(f[..., 0] * side) * np.sinc(f[..., 1] * side) for side in sides]
    whole, half = modes.unclipped(size), len(coarse)
    rising, falling = (
        np.stack([(whole * box)[:, side] for box in boxes])
        for side in (slice(half), slice(half, None))
    )
    core, part = _sheets(
        np.stack([rising + falling, rising - falling], axis=1),
        np.zeros(2, dtype=np.int64),
        kernel,
        lines,
    )
    core, part = (sheet + poisson_weight(modes.core_tail) * far for sheet in (core, part))
    at_once = max(1, ROOM // (2 * max(size.size, kernel.shape[1] * lines.shape[1])))
    found: list[tuple[float, int, int, SingleArray]] = []
    single = np.asarray(kernel, dtype=np.complex64), np.asarray(lines, dtype=np.float32)
    turned, angle, reached, places = (
        np.asarray(boxes[1], dtype=np.complex128),
        np.exp(1j * alpha),
        0,
        modes.places(size),
    )
    for start in range(0, len(modes.orders), at_once):
        terms = np.arange(start, min(start + at_once, len(modes.orders)))
        patterns = np.empty((len(terms), 2, 2, half, half), dtype=np.float32)
        for pattern, term, table in zip(patterns, terms, modes.fine[terms], strict=True):
            while reached < modes.orders[term]:
                turned, reached = turned * angle, reached + 1
            fill_patterns(pattern, turned, table, *places)
        orders = np.repeat(modes.orders[terms], 2)
        sheets = _sheets(patterns.reshape(-1, 2, half, half), orders, *single)
        for index, wave in enumerate(sheets):  # the sine of order 0 is nowhere felt
            term = int(terms[index // 2])
            if orders[index] == 0 and index % 2 == 0:
                wave = wave + poisson_weight(float(modes.tails[term])) * far
            felt = np.flatnonzero(
                np.abs(wave).max(axis=1) > tolerance / 15 / np.abs(modes.radial[term]).max()
            )
            if len(felt):
                odd = int(modes.weights[term] >= ODD)  # sin(order (phi - alpha))
                turn = 2 * int(orders[index]) + (index + odd) % 2
                found.append(
                    (
                        float(felt[-1]),
                        term,
                        turn,
                        np.asarray(-wave if odd and index % 2 else wave, dtype=np.float32),
                    )
                )
    found.sort(key=lambda wave: -wave[0])
    return Border(
        core,
        part,
        np.stack([wave[3] for wave in found], axis=-1) if found else NO_BORDER.waves,
        np.array([wave[1] for wave in found], dtype=np.int64),
        np.array([wave[2] for wave in found], dtype=np.int64),
        np.array([wave[0] for wave in found], dtype=np.float64),
        place,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_patterns(
    patterns: SingleArray,
    turned: ComplexArray,
    table: SingleArray,
    base: Whole,
    beyond: SingleArray,
) -> None:
    """Fill a term's patterns at frequencies along x' and y', for ``_sheets``: of the cosine and the
    sine.

    Args:
        patterns: shape (2, 2, F, F).
        turned: cosine and sine at frequencies along y' rising, then falling, shape (F, 2 F).
        table: what they are multiplied by, see ``Modes.places``.
        base: places in it.
        beyond: the same.
    """
    half = turned.shape[0]
    for i in range(half):
        for j in range(half):
            node, other = base[i, j], base[i, j + half]
            rising = turned[i, j] * (table[node] + beyond[i, j] * (table[node + 1] - table[node]))
            falling = turned[i, j + half] * (
                table[other] + beyond[i, j + half] * (table[other + 1] - table[other])
            )
            both, apart = rising + falling, rising - falling
            patterns[0, 0, i, j], patterns[0, 1, i, j] = both.real, apart.real
            patterns[1, 0, i, j], patterns[1, 1, i, j] = both.imag, apart.imag


def _sheets(
    patterns: Array | SingleArray,
    orders: Whole,
    kernel: ComplexArray | SingleComplexArray,
    lines: Array | SingleArray,
) -> Array | SingleArray:
    """The light of real patterns, times i for odd orders, as sheets over distance and place, shape
    (P, Y, X).

    A pattern is given at frequencies along x' and y', as the sum of its values where y' rises and
    falls, and as their difference; shape (P, 2, F, F).
    """
    count, _, rows, columns = patterns.shape
    both, apart = (np.ascontiguousarray(patterns[:, side]).reshape(-1, columns) for side in (0, 1))
    real, imaginary = (
        (both @ kernel.real).reshape(count, rows, -1),
        (apart @ kernel.imag).reshape(count, rows, -1),
    )
    odd = (orders % 2 == 1)[:, None, None]
    coarser = np.concatenate(
        [np.where(odd, -imaginary, real), np.where(odd, real, imaginary)], axis=1
    ).transpose(0, 2, 1)
    return (coarser.reshape(-1, 2 * rows) @ lines).reshape(count, coarser.shape[1], -1)


def _line_weights(line: Line, turn: Array, band: float) -> Array:
    """Weights that turn the real and imaginary parts of a pattern at frequencies along x' into
    spline coefficients over x', (2 F, X).

    The pattern is the quintic spline through its values; the sum over the line's frequencies is
    that of its Fourier series.
    """
    frequency = line.frequency[line.frequency < band]
    splines = make_interp_spline(turn, np.eye(len(turn)), k=5)(np.arccos(1 - 2 * frequency / band))
    waves = np.zeros((len(turn), line.length), dtype=np.complex128)
    waves[:, : len(frequency)] = (splines * line_spectrum(line, band)[:, None]).T
    waves[:, 1:] *= 2
    found = np.asarray(fft.ifft(waves, axis=1, overwrite_x=True))[:, : line.count]
    return np.concatenate([np.real(found), -np.imag(found)])


def _step_weights(coarse: Array, distance: Array) -> ComplexArray:
    """Weights that turn a pattern at frequencies along y', rising and falling, into the light from
    beyond a border at distances.

    The light is half the pattern at 0 plus i/(2 pi) times the integral over v > 0 of (P(v) E -
    P(-v) / E) / v, E = exp(2 pi i v distance), P the quintic spline through the pattern's values.
    Shape (n, Y), for the rising frequencies; those for falling ones are the conjugate.
    """
    count = len(coarse)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    panels = max(
        LEAST_PANELS, count, math.ceil(math.pi / 2 * coarse[-1] * float(np.abs(distance).max()))
    )  # no more than a wave in each
    edges = np.linspace(0, np.pi, panels + 1)
    half = np.pi / (2 * panels)
    turn = (edges[:-1, None] + half * (1 + nodes)).ravel()
    weight = np.tile(half * weights, panels) / np.tan(turn / 2)  # dv / v
    splines = (
        make_interp_spline(np.linspace(0, np.pi, count), np.eye(count), k=5)(turn) * weight[:, None]
    )
    phase = np.pi * coarse[-1] * (1 - np.cos(turn))[:, None] * distance
    cos, sin = splines.T @ np.cos(phase), splines.T @ np.sin(phase)
    rising = 1j / (2 * np.pi) * (cos + 1j * sin)
    rising[0] = 0.25 - sin[0] / (
        2 * np.pi
    )  # both sides share the value at 0, and the cosines cancel
    return rising


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_sheet(
    sheet: Array | SingleArray,
    row: int,
    column: int,
    by_row: tuple[float, float, float, float],
    by_column: tuple[float, float, float, float],
) -> float:
    """A spline over two axes from its coefficients around a place; the rows are mirrored at their
    ends.
    """
    total = 0.0
    for m in range(4):
        line = sheet[mirrored(row + m - 1, sheet.shape[0])]
        part = by_column[0] * line[column - 1] + by_column[1] * line[column]
        total += by_row[m] * (
            part + by_column[2] * line[column + 1] + by_column[3] * line[column + 2]
        )
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def read_waves(waves: SingleArray, row: int, column: int, weights: SingleArray) -> float:
    """The weighted sum of the first waves at a node."""
    total = np.float32(0.0)
    for wave in range(weights.size):
        total += weights[wave] * waves[row, column, wave]
    return float(total)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def border_row(inside: float, place: tuple[float, float, float, float, float]) -> float:
    """The row at ``inside`` pixels from a border; from a sheet's last one on its light is not felt.
    ``place``: see ``Border``.
    """
    return math.asinh(inside / place[2]) * place[1] + place[0]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def from_beyond(
    radial: float,
    cos: float,
    sin: float,
    x: float,
    row: float,
    sheet: Array,
    waves: SingleArray,
    terms: Whole,
    turns: Whole,
    last: Array,
    place: tuple[float, float, float, float, float],
    scratch: tuple[Array, Array, SingleArray],
) -> float:
    """The light from beyond a border at a row below the last; infinite where nothing else is seen.

    Args:
        radial: place of the sensor point in nodes of radius, below 0 where nothing is clipped.
        cos: cosine of its direction from the micro-image's centre.
        sin: the sine.
        x: position along x', pixels.
        row: see ``border_row``.
        sheet: of the unclipped pupil, see ``Border``.
        waves: the same.
        terms: the same.
        turns: the same.
        last: the same.
        place: the same.
        scratch: the terms' amounts, room for twice the orders from 0 to the highest, and for the
            waves.
    """
    column = (x - place[3]) * place[4]
    if row <= 0.0 or column < 0.0 or column > sheet.shape[1] - 1.0:
        return math.inf
    base_row = int(row)
    base = min(max(int(column), 1), sheet.shape[1] - 3)
    by_row = spline_weights(row - base_row)
    by_column = spline_weights(column - base)
    if radial < 0.0:
        return read_sheet(sheet, base_row, base, by_row, by_column)
    felt = 0
    while felt < last.size and row <= last[felt] + 2.0:
        felt += 1
    weights = scratch[2][:felt]
    weigh_waves(cos, sin, terms, turns, scratch[0], scratch[1], weights)
    total = 0.0
    for m in range(4):
        line = mirrored(base_row + m - 1, sheet.shape[0])
        for n in range(4):
            total += by_row[m] * by_column[n] * read_waves(waves, line, base + n - 1, weights)
    return total

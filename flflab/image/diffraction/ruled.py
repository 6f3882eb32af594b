"""Diffracted images of targets that vary along straight lines: bars, the sine chirp, an edge.

What one kind of microlens shows of a radiance T(x') is, for a sensor point at a distance and an
angle to x' from the micro-image's centre, T filtered by one transfer function: a curve over x'. The
curves of the terms of the transfer functions' sum are made by Fourier sums, read by cubic splines,
and added up with the weights of the sensor point. The spectrum of T is exact; a target longer than
what is seen is cut, and the light of the rest, which comes by the far tails of the diffraction
pattern, is added in closed form.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy import fft

from flflab.image.diffraction.modes import Modes
from flflab.image.diffraction.table import fast_length
from flflab.targets import Bars, Chirp, Edge

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
SingleArray = npt.NDArray[np.float32]
SingleComplexArray = npt.NDArray[np.complex64]
Whole = npt.NDArray[np.int64]

# least and most pixels round the target that a curve covers; beyond, its tail is that of an
# unclipped pupil
MARGINS = (
    128.0,
    1000.0,
)
BEYOND = (64.0, 512.0)  # least and most pixels beyond the seen part of the target before it is cut
GAUSS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class Ruling:
    """A radiance along one direction as steps and points of light.

    Attributes:
        steps: positions and heights of the steps, mm, shape (2, n).
        points: positions and weights (mm) of a quadrature, shape (2, m).
        start: where the target begins, mm; may be infinite.
        end: where it ends.
        level: its mean.
    """

    steps: Array
    points: Array
    start: float
    end: float
    level: float


def profile_ruling(target: Bars | Edge, start: float, end: float, detail: float) -> Ruling:
    """The target's profile across its lines from start to end.

    Args:
        target: bars, chirp or edge.
        start: where to begin, mm.
        end: where to end.
        detail: the finest length that matters, mm; a chirp's quadrature resolves it.
    """
    if isinstance(target, Edge):
        first, last = max(start, 0.0), max(end, 0.0)
        return Ruling(np.array([[first, last], [1.0, -1.0]]), np.zeros((2, 0)), first, last, 1.0)
    first, last = max(start, -target.width / 2), min(end, target.width / 2)
    if first >= last:
        return Ruling(np.zeros((2, 0)), np.zeros((2, 0)), 0.0, 0.0, 0.5)
    low, high = (float(phase) for phase in target.phase(np.array([first, last])))
    halves = np.arange(math.floor(2 * low) + 1, math.ceil(2 * high)) / 2
    cuts = np.concatenate([[first], target.position(halves), [last]])
    if not isinstance(target, Chirp):
        lit = target.profile(target.phase((cuts[1:] + cuts[:-1]) / 2))
        return Ruling(
            np.stack([cuts, np.diff(lit, prepend=0.0, append=0.0)]),
            np.zeros((2, 0)),
            first,
            last,
            0.5,
        )
    parts = max(1, math.ceil(float(np.max(np.diff(cuts))) / detail))
    ends = np.interp(np.arange((len(cuts) - 1) * parts + 1) / parts, np.arange(len(cuts)), cuts)
    half = np.diff(ends) / 2
    places = (ends[:-1, None] + half[:, None] * (1 + GAUSS[0])).ravel()
    weights = (half[:, None] * GAUSS[1]).ravel() * target.profile(target.phase(places))
    return Ruling(np.zeros((2, 0)), np.stack([places, weights]), first, last, 0.5)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fourier_sums(places: Array, weights: Array, step: float, real: Array, imaginary: Array) -> None:
    """Add the sums of weight exp(-2 pi i k step place) for k = 0, 1, ... to two arrays."""
    for index in range(places.size):
        turn = 2.0 * math.pi * step * places[index]
        by_real, by_imaginary = math.cos(turn), -math.sin(turn)
        now_real, now_imaginary = weights[index], 0.0
        for k in range(real.size):
            real[k] += now_real
            imaginary[k] += now_imaginary
            now_real, now_imaginary = (
                now_real * by_real - now_imaginary * by_imaginary,
                now_real * by_imaginary + now_imaginary * by_real,
            )


@dataclass(frozen=True)
class Line:
    """A target's lines on an even grid of positions along x', counted in pixels of the sensor.

    Attributes:
        ruling: the radiance.
        ends: where the target begins and ends, pixels; may be infinite.
        direction: x' as a vector on the sensor: change of position on the target, mm, per pixel
            along x and along y.
        first: first position that is wanted, pixels.
        samples: positions a pixel.
        count: how many are wanted.
        length: how many the Fourier sums have.
    """

    ruling: Ruling
    ends: tuple[float, float]
    direction: Array
    first: float
    samples: float
    count: int
    length: int

    @property
    def frequency(self) -> Array:
        """Frequencies of the Fourier sums, cycles/pixel."""
        return np.arange(self.length // 2 + 1) * self.samples / self.length


def make_line(
    modes: Modes,
    samples: float,
    target: Bars | Edge,
    seen: tuple[float, float],
    direction: Array,
    tolerance: float,
) -> Line:
    """Choose the grid for a target.

    Args:
        modes: the transfer functions.
        samples: positions a pixel.
        target: the target.
        seen: lowest and highest position on the target that the sensor's pixels look at, mm.
        direction: see ``Line``.
        tolerance: largest error asked for.
    """
    scale = float(np.hypot(*direction))
    ends = (
        (0.0, np.inf)
        if isinstance(target, Edge)
        else (-target.width / (2 * scale), target.width / (2 * scale))
    )
    margin = (
        min(max(modes.core_tail / (0.4 * tolerance), MARGINS[0]), MARGINS[1]) + modes.kind.extent
    )
    low = max(seen[0] / scale - 4, ends[0] - margin)
    high = max(min(seen[1] / scale + 4, ends[1] + margin), low + 8)
    first = math.floor(low)
    count = math.ceil((high - first) * samples) + 4
    beyond = min(max(modes.core_tail / (0.2 * tolerance), BEYOND[0]), BEYOND[1]) + modes.kind.extent
    length = fast_length(count + 2 * beyond * samples)
    spare = (length - count) / (4 * samples)
    cut = (max(ends[0], first - spare), min(ends[1], first + count / samples + spare))
    detail = 1.5 / max(modes.band, 1.0)  # 8 points to so many pixels resolve the highest frequency
    ruling = profile_ruling(target, cut[0] * scale, cut[1] * scale, detail * scale)
    return Line(ruling, ends, direction, float(first), samples, count, length)


def line_spectrum(line: Line, band: float) -> ComplexArray:
    """Fourier sums of a line's spline coefficients for the frequencies below the end of the band,
    exact.

    Integral of T(x) exp(-2 pi i f x) dx, by the steps and the quadrature of T, for x in pixels from
    the first position.
    """
    scale = float(np.hypot(*line.direction))
    frequency = line.frequency[line.frequency < band]
    step = line.samples / line.length
    sums = np.zeros((2, 2, len(frequency)))
    for (places, weights), kind in ((line.ruling.points, sums[0]), (line.ruling.steps, sums[1])):
        fourier_sums(places / scale - line.first, weights, step, kind[0], kind[1])
    spectrum = (sums[0, 0] + 1j * sums[0, 1]) / scale
    spectrum[1:] += (sums[1, 0] + 1j * sums[1, 1])[1:] / (2j * np.pi * frequency[1:])
    spectrum[0] -= np.dot(line.ruling.steps[0] / scale - line.first, line.ruling.steps[1])
    prefilter = (2 + np.cos(2 * np.pi * frequency / line.samples)) / 3  # of the cubic B-spline
    return spectrum * line.samples / prefilter


@dataclass(frozen=True)
class Curves:
    """Spline coefficients of share times radiance.

    Attributes:
        core: of unclipped pupils over a pixel, shape (X,).
        part: the same over a part of a pixel.
        waves: the terms of clipped ones over a part of a pixel, for the cosine of the angle from
            x', shape (X, T), single precision.
        place: position of the first coefficient, pixels along x', and coefficients a pixel; then
            level, start, end (pixels) and decay of the light seen from beyond the curves.
    """

    core: Array
    part: Array
    waves: SingleArray
    place: tuple[float, float, float, float, float, float]


def make_curves(modes: Modes, line: Line, box: float, part: float) -> Curves:
    """Image a target's lines through every pupil of a kind.

    Args:
        modes: the transfer functions.
        line: the lines.
        box: side of the square over which a pixel gathers light, pixels.
        part: the same of a part of it.
    """
    frequency = line.frequency[line.frequency < modes.band]
    turned = frequency[:, None] * line.direction / np.hypot(*line.direction)
    spectrum = line_spectrum(line, modes.band) * modes.kind.smear.transfer(turned)
    far = _far_light(line)
    core = modes.unclipped(frequency)

    def boxed(side: float) -> ComplexArray:
        return spectrum * np.sinc(turned[:, 0] * side) * np.sinc(turned[:, 1] * side)

    def unclipped(side: float) -> Array:
        return (
            np.asarray(fft.irfft(core * boxed(side), line.length))[: line.count]
            + modes.core_tail * far
        )

    found = np.empty((len(modes.orders), len(frequency)), dtype=np.complex64)
    fill_lines(
        found, modes.orders, modes.fine, *modes.places(frequency), boxed(part).astype(np.complex64)
    )
    sums = np.asarray(fft.irfft(found, line.length, axis=-1, overwrite_x=True), dtype=np.float32)
    waves = np.empty((line.count, len(modes.orders)), dtype=np.float32)
    side_by_side(waves, sums, modes.tails, far)
    ends = (line.first, line.samples, line.ruling.level, *line.ends, modes.core_tail)
    return Curves(unclipped(box), unclipped(part), waves, ends)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_lines(
    found: SingleComplexArray,
    orders: Whole,
    tables: SingleArray,
    base: Whole,
    beyond: SingleArray,
    lines: SingleComplexArray,
) -> None:
    """Fill ``found`` (T, F) with a target's spectrum (F,) times each term's, read from the ``fine``
    tables, times i for odd orders.
    """
    turned = lines * np.complex64(1j)
    for term in range(found.shape[0]):
        spectrum, table = turned if orders[term] % 2 else lines, tables[term]
        for k in range(found.shape[1]):
            node = base[k]
            found[term, k] = spectrum[k] * (
                table[node] + beyond[k] * (table[node + 1] - table[node])
            )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def side_by_side(waves: SingleArray, sums: SingleArray, tails: Array, far: Array) -> None:
    """Fill ``waves`` (X, T) with sums (T, ...) and what comes from afar, some terms at a time: a
    line of the processor's memory.
    """
    for first in range(0, waves.shape[1], 16):
        last = min(first + 16, waves.shape[1])
        for i in range(waves.shape[0]):
            for term in range(first, last):
                waves[i, term] = sums[term, i] + tails[term] * far[i]


def _far_light(line: Line) -> Array:
    """What the parts of a target beyond its cut add on the grid, less what the copies of a Fourier
    series add; over the decay.
    """
    places = line.first + np.arange(line.count) / line.samples
    scale = float(np.hypot(*line.direction))
    start, end = line.ruling.start / scale, line.ruling.end / scale
    light = np.zeros_like(places)
    if line.ends[1] > end:
        light += 1 / (end - places) - 1 / (line.ends[1] - places)
    if line.ends[0] < start:
        light += 1 / (places - start) - 1 / (places - line.ends[0])
    for copy in range(1, 9):
        for shift in (copy * line.length / line.samples, -copy * line.length / line.samples):
            light -= np.abs(1 / (start + shift - places) - 1 / (end + shift - places))
    return line.ruling.level * light


@numba.njit(cache=True, nogil=True, error_model="numpy")
def spline_weights(part: float) -> tuple[float, float, float, float]:
    """Weights of a cubic B-spline's four coefficients around a place, ``part`` from 0 to 1 beyond
    the second.
    """
    rest = 1.0 - part
    return (
        rest * rest * rest / 6.0,
        (4.0 - 3.0 * part * part * (2.0 - part)) / 6.0,
        (4.0 - 3.0 * rest * rest * (2.0 - rest)) / 6.0,
        part * part * part / 6.0,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mirrored(index: int, count: int) -> int:
    """An index beyond either end, reflected at it."""
    if index < 0:
        return -index
    return 2 * (count - 1) - index if index >= count else index


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read_line(line: Array, place: float) -> float:
    """One curve at a place in samples."""
    base = min(max(int(place), 1), line.size - 3)
    a, b, c, d = spline_weights(place - base)
    return a * line[base - 1] + b * line[base] + c * line[base + 1] + d * line[base + 2]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def read_terms(waves: SingleArray, place: float, weights: SingleArray) -> float:
    """The weighted sum of curves, shape (X, T), at a place in samples."""
    base = min(max(int(place), 1), waves.shape[0] - 3)
    a, b, c, d = spline_weights(place - base)
    one, two, three, four = np.float32(a), np.float32(b), np.float32(c), np.float32(d)
    total = np.float32(0.0)
    for term in range(weights.size):
        near = two * waves[base, term] + three * waves[base + 1, term]
        total += weights[term] * (near + one * waves[base - 1, term] + four * waves[base + 2, term])
    return float(total)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_through(
    radial: float,
    at: float,
    line: Array,
    waves: SingleArray,
    place: tuple[float, float, float, float, float, float],
    weights: SingleArray,
) -> float:
    """What a sensor point sees at a position in pixels: by ``line`` where ``radial`` is below 0,
    else by ``waves`` so weighted.

    For the rest see ``Curves``.
    """
    sample = (at - place[0]) * place[1]
    if sample < 0.0 or sample > line.size - 1.0:
        return place[2] * place[5] * abs(1.0 / (at - place[4]) - 1.0 / (at - place[3]))
    if radial < 0.0:
        return read_line(line, sample)
    return read_terms(waves, sample, weights)

"""Transfer functions as short sums: few terms over the rim, the direction and the frequency each,
found from a table.

Of slow waves, which reach far, and of fast ones, which stay near, other terms count: a sieve says
which waves a sum is for.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage
from scipy.interpolate import make_interp_spline

from flflab.image.diffraction.kinds import Kind
from flflab.image.diffraction.shading import MEAN, ODD, Shading
from flflab.image.diffraction.table import TransferTable, transfer_table
from flflab.image.diffraction.weighted import weighted_values

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
SingleArray = npt.NDArray[np.float32]
Whole = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]

# steps of a term's table in single precision for one of a ``TransferTable``: read between its
# nodes, it is as exact
FINER = 64
NEGLIGIBLE = 1e-9  # of white: no weight counts less
QUIET = 0.1  # of what is left out, for whole orders that are too small to look into
TAIL = 1 / 64  # weight of a line's tail: light from so many pixels away
GONE, SIFTED = (
    0.9,
    1e-6,
)  # over a Gaussian's softness, from where on it keeps no wave, and what it keeps at least


@dataclass(frozen=True)
class Modes:
    """A kind's transfer functions as a short sum, for sensor points in any direction from the
    micro-image's centre.

    Share times transfer at radius r and angle phi of the sensor point, at frequency f in the
    direction alpha, is the sum over the terms of radial(r) spectrum(f) cos(order (alpha - phi)),
    times i for odd orders: a real image for each. Of pupils weighted by polynomials that change
    sign across the point's direction it is sin(order (phi - alpha)).

    Attributes:
        kind: the kind.
        band: the highest frequency in the spectra, cycles/pixel.
        orders: of the terms, rising, shape (T,).
        weights: by which polynomial of the pupil each term is weighted, see ``shading``, shape
            (T,).
        sizes: how much each changes a sine of half the full contrast at most, of white, shape (T,).
        radial: spline coefficients over twice as many steps of radius as the table has, shape (T,
            R).
        spectra: at the frequencies of a ``TransferTable``, shape (T, F).
        fine: the same at the nodes that ``places`` counts, shape (T, nodes), in single precision; 0
            at the last.
        tails: of a line's image, as those of a ``TransferTable``, shape (T,).
        core: the unclipped pupil's transfer, shape (F,).
        core_fine: the same at the nodes that ``places`` counts; 0 at the last.
        core_tail: its tail.
    """

    kind: Kind
    band: float
    orders: Whole
    weights: Whole
    sizes: Array
    radial: Array
    spectra: Array
    fine: SingleArray
    tails: Array
    core: Array
    core_fine: Array
    core_tail: float

    def but_for(self, left_out: float) -> "Modes":
        """Without the smallest terms, as many as keep the root of the sum of their squared sizes
        within ``left_out``.
        """
        kept = ~_smallest(self.sizes, left_out)
        terms = self.orders[kept], self.weights[kept], self.sizes[kept]
        parts = self.radial[kept], self.spectra[kept], self.fine[kept], self.tails[kept]
        return Modes(
            self.kind, self.band, *terms, *parts, self.core, self.core_fine, self.core_tail
        )

    def unclipped(self, frequency: Array) -> Array:
        """The unclipped pupil's transfer at frequencies of any shape."""
        base, beyond = self.places(frequency)
        return self.core_fine[base] + beyond * (self.core_fine[base + 1] - self.core_fine[base])

    def places(self, frequency: Array) -> tuple[Whole, SingleArray]:
        """Where frequencies of any shape lie in the ``fine`` tables: the node before each, and the
        part beyond it.
        """
        last = FINER * (self.spectra.shape[1] - 1)
        place = np.arccos(np.maximum(1 - 2 * frequency / self.band, -1)) * (last / np.pi)
        base = np.minimum(place.astype(np.int64), last - 1)
        return base, (place - base).astype(np.float32)


@dataclass(frozen=True)
class Sieve:
    """The frequencies that a Gaussian of ``softness`` pixels keeps, or those it does not; all with
    None.
    """

    softness: float | None = None
    slow: bool = False

    @property
    def band(self) -> float:
        """From where on nothing is kept, cycles/pixel."""
        return GONE / self.softness if self.slow and self.softness is not None else math.inf

    def keeps(self, frequency: Array) -> Array:
        """Share of what has a frequency, cycles/pixel."""
        if self.softness is None:
            return np.ones(frequency.shape)
        power = -2 * (math.pi * self.softness * frequency) ** 2
        return np.asarray(np.exp(power) if self.slow else -np.expm1(power))


ALL = Sieve()
Known = dict[tuple[float | Sieve, ...], Modes]


def shared_modes(
    known: Known,
    kind: Kind,
    samples: float,
    nodes: tuple[int, int],
    box: float,
    left_out: float,
    sieve: Sieve = ALL,
    shading: Shading = MEAN,
) -> Modes:
    """A kind's modes, for so many samples a pixel from a table of so many radii and angles; made
    once for all kinds of one pupil.
    """
    asked = (*kind.pupil, samples, *nodes, left_out, sieve, *shading.most)
    if asked not in known:
        known[asked] = find_modes(
            transfer_table(kind, min(samples, 2 * sieve.band), *nodes),
            box,
            left_out,
            sieve,
            shading,
        )
    return replace(known[asked], kind=kind)


def find_modes(
    table: TransferTable, box: float, left_out: float, sieve: Sieve = ALL, shading: Shading = MEAN
) -> Modes:
    """Turn a table into a sum, as short as what is left out allows.

    Errors of terms are as unlike each other as the terms: what many of them change together was
    measured on dots and pictures, where it was at most 1.4 times the root of the sum of their
    squared sizes.

    Args:
        table: the table.
        box: side of the square over which a pixel gathers light, pixels.
        left_out: that root at most, of white, for sines of half the full contrast behind such
            pixels.
        sieve: of these sines' frequencies.
        shading: by what the pupil's weights are multiplied at most.
    """
    core = table.values[0, 0].real
    unclipped = core, _fine_tables(core[None])[0], float(table.tails[0, 0])
    count = table.values.shape[1] - 1
    if count == 0:
        return Modes(table.kind, table.band, *_no_terms(len(core)), *unclipped)
    nodes = np.linspace(0, np.pi, len(core))
    waves_across = (
        box * table.band / 2 * (1 - np.cos(nodes))
    )  # where they are whole a pixel keeps what the rim changes within it
    kept_of_them = np.maximum(sieve.keeps(table.band / 2 * (1 - np.cos(nodes))), SIFTED)
    weight = np.append(
        kept_of_them * np.minimum(1.0, 1 / np.maximum(np.pi * waves_across, 1e-9)) / 2, TAIL
    )
    values, tails = table.values[None], table.tails[None]
    if len(shading.most) > 1:
        values, tails = (
            np.concatenate(both)
            for both in zip((values, tails), weighted_values(table), strict=True)
        )
    most = np.maximum(np.array(shading.most), NEGLIGIBLE)
    waves = np.stack(
        [_series(*given, odd=by >= ODD) for by, given in enumerate(zip(values, tails, strict=True))]
    )
    waves *= weight * most[:, None, None, None]
    whole = np.linalg.norm(waves, axis=(1, 3))
    small = _smallest(whole.ravel(), QUIET * left_out).reshape(whole.shape)
    terms: list[tuple[int, int]] = []
    sizes: list[float] = []
    radial: list[Array] = []
    spectra: list[Array] = []
    for order, by in np.argwhere(~small.T):
        left, shares, right = np.linalg.svd(waves[by, :, order], full_matrices=False)
        size = shares * np.abs(left).max(axis=0) * np.abs(right).max(axis=1)
        terms += [(int(order), int(by))] * len(size)
        sizes += list(size)
        radial.append((left * shares).T / most[by])
        spectra.append(right / weight)
    kept = ~_smallest(np.array(sizes), math.sqrt(left_out**2 - float(np.sum(whole[small] ** 2))))
    if not kept.any():
        return Modes(table.kind, table.band, *_no_terms(len(core)), *unclipped)
    found, along = np.concatenate(spectra)[kept], _twice_as_fine(np.concatenate(radial)[kept].T)
    splines = ndimage.spline_filter1d(along, axis=0, mode="mirror").T
    of_terms, weights = np.array(terms)[kept].T
    parts = (
        of_terms,
        weights,
        np.array(sizes)[kept],
        splines,
        found[:, :-1],
        _fine_tables(found[:, :-1]).astype(np.float32),
        found[:, -1],
    )
    return Modes(table.kind, table.band, *parts, *unclipped)


def _series(values: ComplexArray, tails: Array, odd: bool) -> Array:
    """Coefficients of cosines, or of sines, of the angle: of real parts for even orders, of
    imaginary ones for odd; (R, A, F + 1).
    """
    with_tails, count = np.concatenate([values, tails[..., None]], axis=2), values.shape[1] - 1
    waves = np.zeros(with_tails.shape)
    if odd:
        for start, part in ((2, with_tails.real), (1, with_tails.imag)):
            waves[:, start:-1:2] = (
                np.asarray(fft.dst(part[:, 1:-1], type=1, axis=1))[:, start - 1 :: 2] / count
            )
        return waves
    for start, part in ((0, with_tails.real), (1, with_tails.imag)):
        waves[:, start::2] = np.asarray(fft.dct(part, type=1, axis=1))[:, start::2]
    waves[:, 1:-1] *= 2
    return waves / (2 * count)


def _smallest(sizes: Array, left_out: float) -> Chosen:
    """The smallest of some, as many as have the root of the sum of their squares within
    ``left_out``.
    """
    order = np.argsort(sizes, kind="stable")
    small = np.zeros(len(sizes), dtype=np.bool_)
    small[order] = np.cumsum(sizes[order] ** 2) <= left_out**2
    return small


def _no_terms(count: int) -> tuple[Whole, Whole, Array, Array, Array, SingleArray, Array]:
    fine = np.zeros((0, FINER * (count - 1) + 1), dtype=np.float32)
    none = np.zeros(0, dtype=np.int64)
    return none, none, np.zeros(0), np.zeros((0, 1)), np.zeros((0, count)), fine, np.zeros(0)


def _fine_tables(spectra: Array) -> Array:
    """Spectra (T, F) at ``FINER`` times as many nodes, by quintic splines, and 0 from the last
    on.
    """
    count = spectra.shape[1]
    at = np.linspace(0, np.pi, FINER * (count - 1) + 1)
    tables = np.ascontiguousarray(
        make_interp_spline(np.linspace(0, np.pi, count), spectra.T, k=5)(at).T
    )
    tables[:, -1] = 0.0
    return tables


def _twice_as_fine(values: Array) -> Array:
    """Values at even steps of a cosine series' argument, from end to end, at half these steps;
    along the first axis.
    """
    waves = np.asarray(fft.dct(values, type=1, axis=0), dtype=np.float64)
    waves[-1] /= 2
    padded = np.concatenate([waves, np.zeros((len(values) - 1, *values.shape[1:]))])
    return 2 * np.asarray(fft.idct(padded, type=1, axis=0), dtype=np.float64)

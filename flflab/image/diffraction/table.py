"""The transfer functions of one kind of microlens over its micro-image, as smooth tables to be read
by cubic splines.

The pupil of a sensor point e from the micro-image's centre is clipped by a disc that lies in the
direction of e, so its transfer function depends on |e|, on the frequency, and on the angle between
e and the frequency's direction, evenly. All in the sensor's own frame: frequencies in cycles/pixel,
lengths in pixels.
"""

import bisect
import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flflab.image.diffraction.kinds import Kind
from flflab.optics.diffraction import pupil_transfer
from flflab.optics.discs import two_disc_areas

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

BLOCK, ROWS = 24, 12  # frequencies at a time, and rows of the pupil
PER_WAVE = 4.5  # samples of the shortest wave that a pupil lets pass
# of white: half of it is what splines of so many samples leave at the edge of a dot, found in light
# in focus
EXACT = 1e-4
WIDE = 8.0  # pixels; across a wider blur nothing is fine
FEW, MORE = 2.25, 4.0  # the least samples a pixel where that wave is shorter than a pixel
# frequencies at least, and for each cycle/pixel: borders read between them what a pixel leaves, too
NODES, PER_CYCLE = (
    40,
    2.0,
)
OUTERMOST = (
    1 - 1e-7
)  # the last radius, as a share of the micro-image's: beyond it there is no pupil


@dataclass(frozen=True)
class TransferTable:
    """Transfer functions of a kind at nodes.

    Attributes:
        kind: the kind.
        band: the highest frequency in the table, cycles/pixel.
        radii: distances from the micro-image's centre, pixels, shape (R,); the first is the bright
            field's edge.
        shares: part of the full pupil left there, shape (R,).
        angles: angles between e and the frequency, from 0 to pi, shape (A,).
        values: share times transfer at the radii, angles and ``frequency_nodes``, shape (R, A, F).
        tails: share times the decay of a line's image: it falls as ``tails`` over the squared
            distance in pixels, shape (R, A).
    """

    kind: Kind
    band: float
    radii: Array
    shares: Array
    angles: Array
    values: ComplexArray
    tails: Array


def samples_needed(kind: Kind, tolerance: float) -> float:
    """Samples a pixel of an image behind pixels; half of it is the highest frequency that matters,
    cycles/pixel.

    n of them leave up to 0.1 / n of a sharp edge, and (n blur)^-1.5 of that of a blurred one; a
    wide blur leaves so little of fine waves that a spline needs fewer samples, too. Splines of
    ``PER_WAVE`` samples of the shortest wave are right to half of ``EXACT``.
    """
    demand, wide = 0.1 / tolerance, 2 * abs(kind.blur)
    blurred = 1.8 * (demand * wide**-1.5) ** 0.4 if wide else math.inf
    least = (FEW if tolerance >= 1e-3 else MORE) * min(1.0, WIDE / max(wide, 1e-9))
    return min(
        PER_WAVE * max(1.0, EXACT / tolerance) ** 0.25 * kind.cutoff,
        max(least, min(demand, blurred)),
    )


def transfer_table(kind: Kind, samples: float, radii: int, angles: int) -> TransferTable:
    """Tabulate a kind for images of so many samples a pixel at so many radii and angles; one radius
    means an unclipped pupil only.

    Radii are spaced as a cosine: the clipped area grows as the 3/2 power of the distance from
    either end of the rim, which is smooth in the cosine's argument. Frequencies are spaced alike,
    dense at 0 and at the highest one.
    """
    distance = rim_radii(kind.slope, kind.reach, radii) if radii > 1 else np.zeros(1)
    clip = distance / kind.slope if radii > 1 else np.zeros(1)
    clip_radius = kind.reach / kind.slope if radii > 1 else 2.0
    beta = np.linspace(0, np.pi, angles)
    half = beta[: (angles + 1) // 2]
    band = min(kind.cutoff, samples / 2)
    count = max(NODES, math.ceil(PER_CYCLE * band)) + math.ceil(6 * abs(kind.blur) * band)
    shift = (1 - np.cos(np.linspace(0, np.pi, count))) * band / kind.cutoff
    x, y = clip[:, None, None] * np.cos(half)[:, None], clip[:, None, None] * np.sin(half)[:, None]
    waves = kind.blur * kind.cutoff / 2 * shift
    shares = pupil_share(clip, clip_radius)
    blocks = np.array_split(
        np.arange(count), math.ceil(count / BLOCK)
    )  # low frequencies need few rows
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = pool.map(
            lambda some: pupil_transfer(shift[some], waves[some], x, y, clip_radius, ROWS), blocks
        )
        values = np.concatenate(list(parts), axis=2)
    small = 1e-4
    slope: ComplexArray = (
        1 - pupil_transfer(small, 0.0, x[..., 0], y[..., 0], clip_radius)
    ) / small
    values = np.concatenate([values, slope[..., None]], axis=2) * shares[:, None, None]
    values = np.concatenate(
        [values, values[:, : angles // 2][:, ::-1].conj()], axis=1
    )  # transfers of mirrored pupils are conjugate
    tails = np.asarray(values[..., -1].real, dtype=np.float64) / (math.pi**2 * kind.cutoff)
    return TransferTable(kind, band, distance, shares, beta, values[..., :-1], tails)


def rim_radii(slope: float, reach: float, count: int) -> Array:
    """Distances from the micro-image's centre over its rim, from the inner edge to the outer, as a
    cosine.
    """
    return np.minimum(
        max(0.0, reach - slope) + slope * (1 - np.cos(np.linspace(0, np.pi, count))),
        (reach + slope) * OUTERMOST,
    )


def pupil_share(clip: Array, clip_radius: float) -> Array:
    """Part of the full pupil left by a disc at these distances."""
    return two_disc_areas(1.0, clip_radius, clip) / math.pi


SMOOTH = sorted(2**a * 3**b * 5**c for a in range(27) for b in range(17) for c in range(12))


def fast_length(least: float) -> int:
    """The smallest length from ``least`` up without prime factors beyond 5: fast to transform."""
    return SMOOTH[bisect.bisect_left(SMOOTH, least)]

"""Transfer function of a clipped, defocused pupil for incoherent light of one wavelength: what diffraction leaves of a sine.

The pupil P is the part of the unit disc |t| <= 1 that lies in a second disc, as in ``lens_chord``. Its transfer function along x,

    H(s, w) = 1/|P| integral over {t: t - s/2 and t + s/2 in P} of exp(2 pi i w t_x) dt,

is the autocorrelation of P under its defocus: ``shift`` s is the frequency in units of half the cutoff of the whole disc, and
``waves`` w the frequency times the geometric blur's radius. Along a row of chord c round m the integral is exact,
(c - s) sinc(w (c - s)) exp(2 pi i w m): the image through a slit. As the wavelength falls, s goes to 0 and H to the mean of
exp(2 pi i w t_x) over P, the transfer function of the geometric blur. Source: H. H. Hopkins, Proc. R. Soc. A 231 (1955) 91.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

from flflab.errors import InputError
from flflab.optics.discs import lens_chord, lens_rows, two_disc_area

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

WHOLE = (0.0, 0.0, 2.0)  # a second disc that clips nothing
ROWS_AT_LEAST, ROWS_PER_WAVE, ROWS_AT_MOST = 16, 4.0, 400


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shifted_rows(x: float, y: float, radius: float, shift: float) -> tuple[float, float]:
    """Lowest and highest row in which the pupil's chord is longer than ``shift``; empty if low >= high.

    The chord of two discs is the least of four lengths, one for each pair of arcs; each asks that two discs overlap in the row.
    """
    room = (1.0 - 0.5 * shift) * (1.0 + 0.5 * shift)
    other = (radius - 0.5 * shift) * (radius + 0.5 * shift)
    if room <= 0.0 or other <= 0.0:
        return 0.0, 0.0
    low1, high1 = lens_rows(min(x - shift, 0.0), y, radius)
    low2, high2 = lens_rows(max(x + shift, 0.0), y, radius)
    if low1 >= high1 or low2 >= high2:
        return 0.0, 0.0
    low = max(max(low1, low2), max(-math.sqrt(room), y - math.sqrt(other)))
    high = min(min(high1, high2), min(math.sqrt(room), y + math.sqrt(other)))
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def clipped_transfer(x: float, y: float, radius: float, shift: float, waves: float, nodes: Array) -> tuple[float, float]:
    """Real and imaginary part of H for one pupil; 1 at no shift and no waves, 0 where the pupil is empty.

    Args:
        x: centre of the clipping disc, in radii of the pupil.
        y: the same along y.
        radius: its radius.
        shift: s, from 0 up.
        waves: w, of either sign.
        nodes: rows and weights on (-1, 1) for functions with roots at both ends, see ``row_nodes``.
    """
    area = two_disc_area(1.0, radius, math.hypot(x, y))
    low, high = shifted_rows(x, y, radius, shift)
    if area <= 0.0 or low >= high:
        return 0.0, 0.0
    distance = math.hypot(x, y)
    first, second = low, low  # the corners' rows, where the chord has kinks
    if distance + 1.0 > radius and distance + radius > 1.0:
        along = (1.0 + (distance - radius) * (distance + radius)) / (2.0 * distance)
        across = math.sqrt(max(0.0, 1.0 - along * along))
        one = (along * y + across * x) / distance
        two = (along * y - across * x) / distance
        first = min(max(min(one, two), low), high)
        second = min(max(max(one, two), low), high)
    real = 0.0
    imaginary = 0.0
    for piece in range(3):
        start = low if piece == 0 else (first if piece == 1 else second)
        end = first if piece == 0 else (second if piece == 1 else high)
        if end - start <= 0.0:
            continue
        for index in range(nodes.shape[1]):
            left, right = lens_chord(x, y, radius, 0.5 * (start + end) + 0.5 * (end - start) * nodes[0, index])
            kept = right - left - shift
            if kept > 0.0:
                angle = math.pi * waves * kept
                weight = 0.5 * (end - start) * nodes[1, index] * kept
                if abs(angle) > 1e-4:
                    weight *= math.sin(angle) / angle
                else:
                    weight *= 1.0 - angle * angle / 6.0
                turn = math.pi * waves * (left + right)
                real += weight * math.cos(turn)
                imaginary += weight * math.sin(turn)
    return real / area, imaginary / area


def row_nodes(waves: float, least: int) -> Array:
    """Rows and weights on (-1, 1) for a piece of a pupil with up to so many waves of defocus, shape (2, n)."""
    count = min(least + math.ceil(ROWS_PER_WAVE * abs(waves)), ROWS_AT_MOST)
    places, weights = np.polynomial.legendre.leggauss(count)
    return np.stack([np.sin(np.pi / 2 * places), weights * np.pi / 2 * np.cos(np.pi / 2 * places)])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _transfers(x: Array, y: Array, radius: Array, shift: Array, waves: Array, nodes: Array, real: Array, imaginary: Array) -> None:
    for index in range(shift.size):
        real[index], imaginary[index] = clipped_transfer(x[index], y[index], radius[index], shift[index], waves[index], nodes)


def pupil_transfer(
    shift: npt.ArrayLike,
    waves: npt.ArrayLike,
    clip_x: npt.ArrayLike = 0.0,
    clip_y: npt.ArrayLike = 0.0,
    clip_radius: npt.ArrayLike = 2.0,
    rows: int = ROWS_AT_LEAST,
) -> ComplexArray:
    """H(s, w) along x of a disc clipped by another, element by element of broadcast arrays.

    Args:
        shift: frequency over half the cutoff, from 0 up; from 2 up nothing is left.
        waves: frequency times the radius of the geometric blur, signed.
        clip_x: centre of the clipping disc in radii of the pupil, against the direction of the frequency.
        clip_y: the same across it.
        clip_radius: its radius; centre 0 and a radius from 1 up clip nothing.
        rows: over how many each piece of the pupil is summed where there is no defocus; 16 leave 2e-7, 10 leave 5e-6.

    Returns:
        Complex transfer: image of exp(2 pi i nu x) over the object's, 1 at frequency 0.

    Raises:
        InputError: a number is not finite, or a shift or radius is negative.
    """
    given = np.broadcast_arrays(*(np.asarray(part, dtype=np.float64) for part in (clip_x, clip_y, clip_radius, shift, waves)))
    for name, part in zip(("clip_x", "clip_y", "clip_radius", "shift", "waves"), given, strict=True):
        if not np.all(np.isfinite(part)) or (name in ("clip_radius", "shift") and np.any(part < 0)):
            raise InputError(
                f"pupil_transfer: {name} holds a negative or not finite number; finite ones are due, shift and radius from 0 up"
            )
    x, y, radius, shifts, defocus = (np.array(part).ravel() for part in given)
    real, imaginary = np.empty(x.size), np.empty(x.size)
    _transfers(x, y, radius, shifts, defocus, row_nodes(float(np.max(np.abs(defocus), initial=0.0)), rows), real, imaginary)
    return (real + 1j * imaginary).reshape(given[0].shape)

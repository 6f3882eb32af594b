"""A chirp of bars or of a sine seen through a pixel and a disc of blur.

Every edge of a bar is an edge seen through both, in closed form. A sine is multiplied by the
transfer at its frequency.
"""

import numba
import numpy as np
import numpy.typing as npt
from scipy.special import j1, jv

from flflab.targets import Bars

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

MORE_BLUR = 0.3  # px, added in squares: how what blur does is found, in few runs at bars' corners


def seen_through(
    target: Bars, x: Array, pixel: float, squares: Array
) -> tuple[Array, Array, Array]:
    """The target of amplitude 1 at x mm through a pixel and discs of blur, its slope, 1/mm, and its
    growth with the square of the disc, 1/mm^2.

    Args:
        target: of bars or of a sine.
        x: places on the target, mm, shape (n,).
        pixel: mm on the target.
        squares: of the discs' diameters there, mm^2, shape (n,).
    """
    if target.kind == "bars":
        edges = target.position(np.arange(2 * target.cycles + 1) / 2)
        first = np.maximum(np.floor(2 * target.phase(x - _reach(pixel, squares))), 0)
        return _bars(x, first.astype(np.int64), np.asarray(edges), pixel, squares)
    nu, turn = target.frequency(x), 2 * np.pi * target.phase(x)
    left, sine = transfer(nu, pixel, squares), np.sin(turn)
    return left * sine, left * np.cos(turn) * 2 * np.pi * nu, widened(nu, pixel, squares) * sine


def _reach(pixel: float, squares: Array) -> Array:
    """How far from a place an edge may be that is seen there, mm."""
    return (np.sqrt(squares + (MORE_BLUR * pixel) ** 2) + pixel) / 2


def transfer(frequency: Array, pixel: float, squares: Array) -> Array:
    """Of a pixel and discs of so large squares of their diameters, mm^2, at frequencies in
    cycles/mm.
    """
    z = np.pi * np.sqrt(squares) * np.abs(frequency) + 1e-9
    return np.sinc(frequency * pixel) * 2 * j1(z) / z


def widened(frequency: Array, pixel: float, squares: Array) -> Array:
    """Growth of ``transfer`` with the square of the disc, 1/mm^2."""
    z = np.pi * np.sqrt(squares) * np.abs(frequency) + 1e-3
    return -np.sinc(frequency * pixel) * (np.pi * frequency / z) ** 2 * jv(2, z)


@numba.njit(nogil=True, cache=True)
def _through_disc(
    u: float, radius: float
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """A sharp edge through a disc: its integral up to u, the edge there, and how the integral grows
    with the square of the radius.
    """
    z = u / radius
    if z <= -1.0:
        return 0.0, 0.0, 0.0
    if z >= 1.0:
        return u, 1.0, 0.0
    root, turn = np.sqrt(1.0 - z * z), np.arcsin(z)
    edge = 0.5 + (z * root + turn) / np.pi
    whole = z / 2 + (z * turn + root - root**3 / 3) / np.pi
    return radius * whole, edge, (whole - z * edge) / (2 * radius)


@numba.njit(nogil=True, cache=True)
def _bars(
    x: Array, first: Whole, edges: Array, pixel: float, squares: Array
) -> tuple[Array, Array, Array]:  # pragma: no cover - compiled
    """``first``: bar, from the left, in which what is seen at each place begins."""
    seen, slope, growth = np.zeros(len(x)), np.zeros(len(x)), np.zeros(len(x))
    for n in range(len(x)):
        radius = max(np.sqrt(squares[n]) / 2, 1e-4 * pixel)
        larger = np.sqrt(radius**2 + (MORE_BLUR * pixel / 2) ** 2)
        bright = 1.0 - 2.0 * (first[n] % 2)
        seen[n] = bright
        for k in range(first[n] + 1, len(edges)):
            away = x[n] - edges[k]
            if away < -larger - pixel / 2:
                break
            bright = -bright
            right, there, _ = _through_disc(away + pixel / 2, radius)
            left, here, _ = _through_disc(away - pixel / 2, radius)
            _, _, wider = _through_disc(away + pixel / 2, larger)
            _, _, narrower = _through_disc(away - pixel / 2, larger)
            seen[n] += 2 * bright * (right - left) / pixel
            slope[n] += 2 * bright * (there - here) / pixel
            growth[n] += 2 * bright * (wider - narrower) / pixel / 4
    return seen, slope, growth

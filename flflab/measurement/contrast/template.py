"""Square bars seen through a pixel and a disc of blur, exactly, however fast their frequency
changes.

The edge spread of a box of width w and a disc of diameter B, both in mm on the target, is S(t) =
(H(t + w/2) - H(t - w/2))/w with H(t) = (B/2) (z/2 + (z asin z + sqrt(1 - z^2) - (1 -
z^2)^(3/2)/3)/pi) for z = 2t/B within (-1, 1) and max(t, 0) beyond: the second integral of the
disc's line spread. H(t) is max(t, 0) and, where |z| < 1, B/2 of a function of |z| alone, of which
one table serves every disc. Bars are a sum of such edges, rising and falling in turn.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.optics.contrast import disc_transfer
from flflab.targets import Bars

Array = npt.NDArray[np.float64]
ENTRIES = 2048


def _roundings() -> Array:
    """What a disc of diameter 2 adds to max(z, 0), and its slope, at ENTRIES + 1 even places z from
    0 to 1, shape (ENTRIES + 1, 2).
    """
    z = np.linspace(0.0, 1.0, ENTRIES + 1)
    root = np.sqrt(1 - z * z)
    return np.stack(
        [
            z / 2 + (z * np.arcsin(z) + root - root**3 / 3) / np.pi - z,
            (z * root + np.arcsin(z)) / np.pi - 0.5,
        ],
        axis=1,
    )


ROUNDINGS = _roundings()


@dataclass(frozen=True)
class Template:
    """A pixel and a disc of blur, both in mm on the target."""

    pixel: float
    blur: float

    def transfer(self, frequency: Array) -> Array:
        """Transfer at frequencies in cycles/mm."""
        nu = np.asarray(frequency, dtype=np.float64)
        return np.sinc(nu * self.pixel) * disc_transfer(self.blur, nu)

    def through(self, wider: Array, frequency: Array) -> Array:
        """Transfer at K frequencies of discs whose squares are so much larger, mm^2, shape (n,);
        shape (n, K).
        """
        discs = np.sqrt(np.maximum(self.blur**2 + np.asarray(wider), 0.0))
        return np.sinc(frequency * self.pixel) * disc_transfer(discs[:, None], frequency)

    @property
    def reach(self) -> float:
        """How far from an edge it is seen, mm."""
        return (self.pixel + self.blur) / 2

    def _spread(self, t: Array) -> tuple[Array, Array]:
        """Edge and line spread t mm behind an edge."""
        ends = [self._integrals(t + side * self.pixel / 2) for side in (1, -1)]
        return (ends[0][0] - ends[1][0]) / self.pixel, (ends[0][1] - ends[1][1]) / self.pixel

    def _integrals(self, t: Array) -> tuple[Array, Array]:
        """Second and first integral of the disc's line spread."""
        if self.blur < 1e-6 * self.pixel:
            return np.maximum(t, 0.0), np.heaviside(t, 0.5)
        z = np.clip(2 * t / self.blur, -1.0, 1.0)
        root = np.sqrt(1 - z * z)
        twice = self.blur / 2 * (z / 2 + (z * np.arcsin(z) + root - root**3 / 3) / np.pi)
        return np.where(np.abs(z) < 1, twice, np.maximum(t, 0.0)), 0.5 + (
            z * root + np.arcsin(z)
        ) / np.pi

    def bars(self, phase: Array, frequency: float) -> Array:
        """Bars of one frequency and amplitude 1 at phases in cycles, rising at phase 0."""
        beyond = 2 * int(np.ceil(frequency * self.reach)) + 2
        number = np.arange(
            -beyond, 2 * int(np.ceil(phase.max())) + beyond + 1
        )  # even ones rise; the first does
        seen, _ = self._spread((phase[:, None] - number / 2) / frequency)
        return -1 + 2 * seen @ np.where(number % 2 == 0, 1.0, -1.0)


def edges_of(target: Bars) -> Array:
    """Places of the bars' edges, mm from the target's centre, the first rising, every second
    falling.
    """
    return target.position(np.arange(np.floor(2 * target.cycles) + 1) / 2)


@numba.njit(nogil=True, cache=True)
def _ramp(t: float, disc: float) -> tuple[float, float]:  # pragma: no cover - compiled
    """Second and first integral of a disc's line spread at t mm."""
    sharp = (t, 1.0) if t > 0.0 else (0.0, 0.0)
    if 2.0 * abs(t) >= disc:
        return sharp
    at = 2.0 * abs(t) / disc * ENTRIES
    n = min(int(at), ENTRIES - 1)
    share = at - n
    more = (1.0 - share) * ROUNDINGS[n, 0] + share * ROUNDINGS[n + 1, 0]
    steeper = (1.0 - share) * ROUNDINGS[n, 1] + share * ROUNDINGS[n + 1, 1]
    return sharp[0] + disc / 2.0 * more, sharp[1] + (steeper if t > 0.0 else -steeper)


@numba.njit(nogil=True, cache=True)
def _edge(
    t: float, pixel: float, disc: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Edge spread (0 to 1) and line spread (1/mm) t mm behind an edge."""
    ahead, behind = _ramp(t + pixel / 2.0, disc), _ramp(t - pixel / 2.0, disc)
    return (ahead[0] - behind[0]) / pixel, (ahead[1] - behind[1]) / pixel


@numba.njit(nogil=True, cache=True)
def bars_at(
    x: float, phase: float, edges: Array, pixel: float, disc: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Bars of amplitude 1 seen through a pixel and a disc at x, and their slope by x (1/mm)."""
    half = int(np.floor(2.0 * phase))
    wave = 1.0 if half % 2 == 0 else -1.0
    slope, reach = 0.0, (pixel + disc) / 2.0
    k = min(half, len(edges) - 1)
    while k >= 0 and x - edges[k] < reach:
        seen, spread = _edge(x - edges[k], pixel, disc)
        sign = 2.0 if k % 2 == 0 else -2.0
        wave += sign * (seen - 1.0)
        slope += sign * spread
        k -= 1
    k = max(half + 1, 0)
    while k < len(edges) and edges[k] - x < reach:
        seen, spread = _edge(x - edges[k], pixel, disc)
        sign = 2.0 if k % 2 == 0 else -2.0
        wave += sign * seen
        slope += sign * spread
        k += 1
    return wave, slope


@numba.njit(nogil=True, cache=True)
def _dimming_edge(t: float, disc: float) -> float:  # pragma: no cover - compiled
    """Edge spread (0 to 1) t mm behind an edge of a disc of light 1 - (r / R)^2: of its line spread
    8 (1 - z^2)^(3/2) / (3 pi).
    """
    if 2.0 * abs(t) >= disc:
        return 1.0 if t > 0.0 else 0.0
    z = 2.0 * t / disc
    root = np.sqrt((1.0 - z) * (1.0 + z))
    return 0.5 + (2.0 * z * root**3 / 3.0 + z * root + np.arcsin(z)) / np.pi


@numba.njit(nogil=True, cache=True)
def dimming_slope_at(
    x: float, phase: float, edges: Array, pixel: float, disc: float
) -> float:  # pragma: no cover - compiled
    """Slope at x (1/mm) of bars of amplitude 1 seen through a pixel and a disc that dims to 0 at
    its rim.
    """
    half, reach = int(np.floor(2.0 * phase)), (pixel + disc) / 2.0
    first, slope = min(half, len(edges) - 1), 0.0
    while first > 0 and x - edges[first - 1] < reach:
        first -= 1
    for k in range(max(first, 0), len(edges)):
        if edges[k] - x >= reach:
            break
        spread = (
            _dimming_edge(x - edges[k] + pixel / 2.0, disc)
            - _dimming_edge(x - edges[k] - pixel / 2.0, disc)
        ) / pixel
        slope += 2.0 * spread if k % 2 == 0 else -2.0 * spread
    return slope

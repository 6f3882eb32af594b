"""Square bars seen through a pixel and a disc of blur, exactly, however fast their frequency changes.

The edge spread of a box of width w and a disc of diameter B, both in mm on the target, is S(t) = (H(t + w/2) - H(t - w/2))/w with
H(t) = (B/2) (z/2 + (z asin z + sqrt(1 - z^2) - (1 - z^2)^(3/2)/3)/pi) for z = 2t/B within (-1, 1) and max(t, 0) beyond: the second
integral of the disc's line spread. Bars are a sum of such edges, rising and falling in turn.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from flflab.optics.contrast import disc_transfer
from flflab.targets import Bars

Array = npt.NDArray[np.float64]
ENTRIES = 2048


@dataclass(frozen=True)
class Template:
    """A pixel and a disc of blur, both in mm on the target."""

    pixel: float
    blur: float

    def transfer(self, frequency: Array) -> Array:
        """Transfer at frequencies in cycles/mm."""
        nu = np.asarray(frequency, dtype=np.float64)
        return np.sinc(nu * self.pixel) * disc_transfer(self.blur, nu)

    @property
    def reach(self) -> float:
        """How far from an edge it is seen, mm."""
        return (self.pixel + self.blur) / 2

    def edge(self) -> Array:
        """Edge spread (0 to 1) and line spread (1/mm) at ENTRIES + 1 even places from -reach to reach, shape (ENTRIES + 1, 2)."""
        return np.stack(self._spread(np.linspace(-self.reach, self.reach, ENTRIES + 1)), axis=1)

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
        return np.where(np.abs(z) < 1, twice, np.maximum(t, 0.0)), 0.5 + (z * root + np.arcsin(z)) / np.pi

    def bars(self, phase: Array, frequency: float) -> Array:
        """Bars of one frequency and amplitude 1 at phases in cycles, rising at phase 0."""
        beyond = 2 * int(np.ceil(frequency * self.reach)) + 2
        number = np.arange(-beyond, 2 * int(np.ceil(phase.max())) + beyond + 1)  # even ones rise; the first does
        seen, _ = self._spread((phase[:, None] - number / 2) / frequency)
        return -1 + 2 * seen @ np.where(number % 2 == 0, 1.0, -1.0)


def edges_of(target: Bars) -> Array:
    """Places of the bars' edges, mm from the target's centre, the first rising, every second falling."""
    return target.position(np.arange(np.floor(2 * target.cycles) + 1) / 2)


@numba.njit(nogil=True, cache=True)
def bars_at(x: float, phase: float, edges: Array, table: Array, reach: float) -> tuple[float, float]:  # pragma: no cover - compiled
    """Bars of amplitude 1 seen through the template at x, and their slope by x (1/mm)."""
    half = int(np.floor(2.0 * phase))
    wave = 1.0 if half % 2 == 0 else -1.0
    slope = 0.0
    per_mm = (len(table) - 1) / (2.0 * reach)
    k = min(half, len(edges) - 1)
    while k >= 0 and x - edges[k] < reach:
        at = (x - edges[k] + reach) * per_mm
        n = min(int(at), len(table) - 2)
        t = at - n
        sign = 2.0 if k % 2 == 0 else -2.0
        wave += sign * ((1.0 - t) * table[n, 0] + t * table[n + 1, 0] - 1.0)
        slope += sign * ((1.0 - t) * table[n, 1] + t * table[n + 1, 1])
        k -= 1
    k = max(half + 1, 0)
    while k < len(edges) and edges[k] - x < reach:
        at = max((x - edges[k] + reach) * per_mm, 0.0)
        n = min(int(at), len(table) - 2)
        t = at - n
        sign = 2.0 if k % 2 == 0 else -2.0
        wave += sign * ((1.0 - t) * table[n, 0] + t * table[n + 1, 0])
        slope += sign * ((1.0 - t) * table[n, 1] + t * table[n + 1, 1])
        k += 1
    return wave, slope

"""How noisy one pixel of a picture is."""

import itertools
import math
from dataclasses import astuple, dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, MeasurementError

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

ENOUGH = 500_000  # squares that are looked at, or up to four times as many
FEWEST = 30  # squares, for a variance
DIM = 0.01  # of the range of brightness: gaps are as dark, and noise besides
FLATTEST = 0.1  # of the squares of one brightness
# of the squares, without warm pixels and dust; and the share of the variance that they hold
USUAL, OF_USUAL = 0.99, 0.9155
STEPS = 12  # of brightness
# of the gains, by light: what is sharp has squares of every brightness on its edges, and none that
# are flat
LOWER = 0.25


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor that counts electrons and adds read noise.

    Attributes:
        dn_per_electron: digital numbers one electron makes (gain), DN.
        read_noise_dn: standard deviation of a dark pixel before quantisation, DN.
        offset_dn: what a pixel without light reads, DN.
        full_scale_dn: the largest value a pixel can read, DN; pixels at or above it count as
            saturated.
    """

    dn_per_electron: float
    read_noise_dn: float
    offset_dn: float
    full_scale_dn: float

    def __post_init__(self) -> None:
        """Refuse what no sensor has.

        Raises:
            InputError: a number is not finite, gain not above 0, noise below 0, or full scale not
                above the offset.
        """
        if not all(math.isfinite(value) for value in astuple(self)):
            raise InputError(f"sensor noise: every number must be finite, not {self}")
        if self.dn_per_electron <= 0 or self.read_noise_dn < 0:
            raise InputError(
                "sensor noise: dn_per_electron above 0 and read_noise_dn from 0 up are due, not"
                f" {self}"
            )
        if self.full_scale_dn <= self.offset_dn:
            raise InputError(
                f"sensor noise: full_scale_dn {self.full_scale_dn:g} must lie above offset_dn"
                f" {self.offset_dn:g}"
            )

    @property
    def dark_variance(self) -> float:
        """Variance of a dark pixel, DN^2: read noise and the 1/12 of rounding to whole numbers."""
        return self.read_noise_dn**2 + 1 / 12

    def variance(self, dn: npt.ArrayLike) -> Array:
        """Variance in DN^2 of pixels that read ``dn`` on average: shot, read and quantisation
        noise.
        """
        light = np.maximum(np.asarray(dn, dtype=np.float64) - self.offset_dn, 0.0)
        return self.dark_variance + light * self.dn_per_electron

    def of_mean(self, frames: int) -> "SensorNoise":
        """The noise of a mean of several frames."""
        return replace(
            self,
            dn_per_electron=self.dn_per_electron / frames,
            read_noise_dn=self.read_noise_dn / frames**0.5,
        )

    @property
    def saturated_dn(self) -> np.float32:
        """Full scale in single precision, rounded up: what is rounded down would not be
        saturated.
        """
        near = np.float32(self.full_scale_dn)
        return near if float(near) >= self.full_scale_dn else np.nextafter(near, np.float32(np.inf))

    def saturated(self, dn: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which pixels read full scale."""
        return np.greater_equal(np.asarray(dn, dtype=np.float64), self.full_scale_dn)


def estimate_noise(
    picture: npt.NDArray[np.generic], full_scale_dn: float | None = None
) -> SensorNoise:
    """Noise of a picture of which nothing else is known, from the differences of neighbouring
    pixels at each brightness.

    Of four pixels a square the difference of the diagonals' sums tells the noise. Those along the
    diagonals are independent of it where there is nothing but noise, so the squares in which these
    are smallest are as noisy as all, and lie on no edge. What is left of the picture's own
    structure can only enlarge the result. The offset is the level of the dark gaps where there are
    some, else 0.

    Args:
        picture: DN, [row, col].
        full_scale_dn: what saturated pixels read, which count nothing; None: there are none.

    Raises:
        MeasurementError: fewer than 3 x 3 pixels.
    """
    values = np.asarray(picture)
    top = float(values.max(initial=0.0))
    full = max(2 * top, 1.0) if full_scale_dn is None else full_scale_dn
    if values.ndim != 2 or min(values.shape) < 3:
        raise MeasurementError(f"picture: at least 3 x 3 pixels are due, not shape {values.shape}")
    every = max(1, int(math.sqrt(values.size / ENOUGH)))
    corners = itertools.product((values[:-1], values[1:]), (slice(None, -1), slice(1, None)))
    squares = np.stack([rows[::every, columns][:, ::every] for rows, columns in corners])
    seen = squares.max(axis=0) < full
    here, right, below, across = squares[:, seen if seen.any() else ~seen].astype(np.float64)
    mean = (here + right + below + across) / 4
    square = (across - below - right + here) ** 2 / 4
    steep = (across - here) ** 2 + (below - right) ** 2
    # dots may cover less than a thousandth
    low, high = (float(level) for level in np.quantile(mean, [0.001, 0.9999]))
    dimmest = mean <= low + DIM * (high - low)
    gaps = mean <= low + 3 * math.sqrt(float(np.median(square[dimmest])))
    offset = float(np.median(mean[gaps])) if low < 0.2 * high else 0.0
    dark, gain = _line(mean - offset, square, steep, gaps, high - offset)
    return SensorNoise(
        max(gain, 1e-9 * max(top, 1.0)),
        math.sqrt(max(dark - 1 / 12, 0.0)),
        offset,
        max(full, offset + 1.0),
    )


def _line(
    level: Array, square: Array, steep: Array, gaps: Flags, high: float
) -> tuple[float, float]:
    """Variance in the dark, from 0 up, and by how much it grows with the light; see
    ``estimate_noise``.

    Args:
        level: of each square above the offset, DN.
        square: of the difference of its diagonals' sums over two.
        steep: sum of squares of the differences along both diagonals.
        gaps: the darkest squares.
        high: brightest level.
    """
    dim, dark = float(np.median(level[gaps])), _variance(square[gaps])
    step = np.where(gaps, 0, np.searchsorted(np.linspace(dim, high, STEPS + 1), level))
    gains, weights = list[float](), list[float]()
    for n in range(1, STEPS + 1):
        part = step == n
        if np.count_nonzero(part) * FLATTEST >= FEWEST:
            flat = part & (steep <= np.quantile(steep[part], FLATTEST))
            above = float(np.median(level[flat])) - dim
            gains.append((_variance(square[flat]) - dark) / above)
            weights.append(above * np.count_nonzero(flat))
    if not gains:
        return dark, 0.0
    order = np.argsort(gains)
    half = np.searchsorted(np.cumsum(np.array(weights)[order]), sum(weights) * LOWER)
    gain = gains[order[half]]
    return max(dark - gain * dim, 0.0), gain


def _variance(squares: Array) -> float:
    """Mean of squares of normal deviates, whatever the largest are."""
    most = math.ceil(len(squares) * USUAL)
    return float(np.mean(np.partition(squares, most - 1)[:most])) / OF_USUAL

"""How noisy one pixel of a picture is."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from flflab.errors import InputError, MeasurementError

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

ENOUGH = 1_000_000  # squares that are looked at, or up to four times as many
FEWEST = 100  # pixels of one brightness, for a variance
# squares in the light, for the noise of flat ones: it is known to 9 per cent then, and half of it
# would be too little
FEWEST_FLAT = 400
# variances, of the two differences of sides together: one in seven squares of nothing but noise is
# steeper
STEEPEST = 4.0
ROUNDS, SETTLED = 6, 0.01  # of finding which squares are flat, until the gain moves by less
STEPS = 12  # of brightness
FULL_SCALES = tuple(2.0**bits - 1 for bits in (8, 10, 12, 14, 16))


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
        if not all(
            math.isfinite(value)
            for value in (
                self.dn_per_electron,
                self.read_noise_dn,
                self.offset_dn,
                self.full_scale_dn,
            )
        ):
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


def _level_and_variance(mean: Array, rough: Array) -> tuple[float, float]:
    """Median brightness and variance of like pixels, from the value below which a quarter of their
    absolute differences lie.

    Where numbers are whole many are equal to it, of which half are counted. In darkness that is cut
    at 0, and where steps are coarse, a quarter of them are 0 but for rounding; then three quarters
    count.
    """
    quarter, most = np.quantile(rough, [0.25, 0.75])
    value = quarter if quarter > 1e-9 * most else most
    share = (np.mean(rough < value) + np.mean(rough <= value)) / 2
    return float(np.median(mean)), float(value / ndtri((1 + min(share, 0.99)) / 2)) ** 2


def _in_steps(mean: Array, rough: Array, edges: Array) -> Array:
    """Level, variance and number of the pixels from each edge of brightness to the next; of 100
    pixels at least; shape (n, 3).
    """
    step = np.searchsorted(edges, mean)
    parts = [step == n for n in range(1, len(edges))]
    found = [
        (*_level_and_variance(mean[part], rough[part]), np.count_nonzero(part))
        for part in parts
        if np.count_nonzero(part) >= FEWEST
    ]
    return np.array(found).reshape(-1, 3)


def _line(
    level: Array, rough: Array, steep: Array, gaps: Flags, high: float
) -> tuple[float, float]:
    """Variance in the dark, and by how much it grows with the light, from the squares that are
    flat; see ``estimate_noise``.

    Args:
        level: of each square above the offset, DN.
        rough: difference of its diagonals' sums over two.
        steep: half the sum of squares of the differences along both diagonals.
        gaps: the darkest squares.
        high: brightest level.
    """
    edges = np.linspace(float(level[gaps].max()), high, STEPS + 1)
    dim = np.array([[*_level_and_variance(level[gaps], rough[gaps]), np.count_nonzero(gaps)]])
    dim = dim[dim[:, 2] >= FEWEST]
    lit, apart, steep = level[~gaps], rough[~gaps], steep[~gaps]
    found = np.vstack([dim, _in_steps(lit, apart, edges)])
    if len(found) < 2:
        return float(found[0, 1] if len(found) else _level_and_variance(level, rough)[1]), 0.0
    # relative: where structure enlarges a variance it counts for little
    dark, gain = _fitted(found, 1 / (found[:, 1] + np.median(found[:, 1]) / 100 + 1e-12))
    for _ in range(ROUNDS):
        flat = steep <= STEEPEST * (dark + gain * lit)
        bright = _in_steps(lit[flat], apart[flat], edges)
        found = np.vstack([dim, bright])
        if len(found) < 2 or bright[:, 2].sum() < FEWEST_FLAT or gain <= 0:
            break
        # by the noise expected: by the noise found, what is found too small would count most
        before = gain
        dark, gain = _fitted(
            found, np.sqrt(found[:, 2]) / (dark + gain * np.maximum(found[:, 0], 0.0) + 1e-12)
        )
        if abs(gain - before) < SETTLED * before:
            break
    return dark, gain


def _fitted(found: Array, weight: Array) -> tuple[float, float]:
    """The line variance = dark + gain level, its dark from 0 up, by weighted least squares."""
    design = np.stack([np.ones(len(found)), found[:, 0]], axis=1) * weight[:, None]
    dark, gain = np.linalg.lstsq(design, found[:, 1] * weight, rcond=None)[0]
    return max(float(dark), 0.0), float(gain)


def estimate_noise(picture: npt.NDArray[np.generic]) -> SensorNoise:
    """Noise of a picture of which nothing else is known, from the differences of neighbouring
    pixels at each brightness.

    Of four pixels a square the difference of the diagonals' sums tells the noise. Those of its
    sides' sums are independent of it where there is nothing but noise: squares in which they are
    larger than noise makes them lie on an edge, and are left out. What is left of the picture's own
    structure can only enlarge the result. The offset is the level of the dark gaps where there are
    some, else 0.

    Raises:
        MeasurementError: fewer than 3 x 3 pixels, or not finite.
    """
    values = np.asarray(picture, dtype=np.float64)
    if values.ndim != 2 or min(values.shape) < 3 or not np.isfinite(values).all():
        raise MeasurementError(
            f"picture: at least 3 x 3 finite pixels are due, not shape {values.shape}"
        )
    every = max(1, int(math.sqrt(values.size / ENOUGH)))
    corners = itertools.product((values[:-1], values[1:]), (slice(None, -1), slice(1, None)))
    here, right, below, across = (rows[::every, columns][:, ::every] for rows, columns in corners)
    mean = (here + right + below + across) / 4
    rough = np.abs(across - below - right + here) / 2
    # half the sum of squares along both diagonals: twice the variance where there is noise alone
    steep = ((across - here) ** 2 + (below - right) ** 2) / 2
    low, high = (
        float(value) for value in np.quantile(mean, [0.001, 0.9999])
    )  # dots may cover less than a thousandth
    gaps = mean <= low + 0.01 * (high - low) + 3 * float(
        np.median(rough[mean <= low + 0.01 * (high - low)])
    )
    offset = float(np.median(mean[gaps])) if low < 0.2 * high else 0.0
    dark, gain = _line(mean - offset, rough, steep, gaps, high - offset)
    top = float(values.max())
    whole = np.asarray(picture).dtype.kind == "u"
    full_scale = top if whole and top in FULL_SCALES else max(2 * top, offset + 1.0)
    return SensorNoise(
        max(float(gain), 1e-9 * max(top, 1.0)),
        math.sqrt(max(float(dark) - 1 / 12, 0.0)),
        offset,
        full_scale,
    )

"""How noisy one pixel of a picture is."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, MeasurementError

Array = npt.NDArray[np.float64]

FULL_SCALES = tuple(2.0**bits - 1 for bits in (8, 10, 12, 14, 16))


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor that counts electrons and adds read noise.

    Attributes:
        dn_per_electron: digital numbers one electron makes (gain), DN.
        read_noise_dn: standard deviation of a dark pixel before quantisation, DN.
        offset_dn: what a pixel without light reads, DN.
        full_scale_dn: the largest value a pixel can read, DN; pixels at or above it count as saturated.
    """

    dn_per_electron: float
    read_noise_dn: float
    offset_dn: float
    full_scale_dn: float

    def __post_init__(self) -> None:
        """Refuse what no sensor has.

        Raises:
            InputError: a number is not finite, gain not above 0, noise below 0, or full scale not above the offset.
        """
        if not all(math.isfinite(value) for value in (self.dn_per_electron, self.read_noise_dn, self.offset_dn, self.full_scale_dn)):
            raise InputError(f"sensor noise: every number must be finite, not {self}")
        if self.dn_per_electron <= 0 or self.read_noise_dn < 0:
            raise InputError(f"sensor noise: dn_per_electron above 0 and read_noise_dn from 0 up are due, not {self}")
        if self.full_scale_dn <= self.offset_dn:
            raise InputError(f"sensor noise: full_scale_dn {self.full_scale_dn:g} must lie above offset_dn {self.offset_dn:g}")

    @property
    def dark_variance(self) -> float:
        """Variance of a dark pixel, DN^2: read noise and the 1/12 of rounding to whole numbers."""
        return self.read_noise_dn**2 + 1 / 12

    def variance(self, dn: npt.ArrayLike) -> Array:
        """Variance in DN^2 of pixels that read ``dn`` on average: shot, read and quantisation noise."""
        light = np.maximum(np.asarray(dn, dtype=np.float64) - self.offset_dn, 0.0)
        return self.dark_variance + light * self.dn_per_electron

    def of_mean(self, frames: int) -> "SensorNoise":
        """The noise of a mean of several frames."""
        return replace(self, dn_per_electron=self.dn_per_electron / frames, read_noise_dn=self.read_noise_dn / frames**0.5)

    def saturated(self, dn: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which pixels read full scale."""
        return np.greater_equal(np.asarray(dn, dtype=np.float64), self.full_scale_dn)


def _bins(mean: Array, gaps: npt.NDArray[np.bool_], high: float) -> list[npt.NDArray[np.bool_]]:
    """Pixels of like brightness: the darkest, then equal steps up to the brightest; only those of 100 pixels at least."""
    edges = np.linspace(float(mean[gaps].max()), high, 13)
    parts = [gaps, *((mean > start) & (mean <= end) for start, end in pairwise(edges.tolist()))]
    return [part for part in parts if np.count_nonzero(part) >= 100] or [np.ones_like(gaps)]


def _level_and_variance(mean: Array, rough: Array) -> tuple[float, float]:
    """Median brightness and variance of like pixels; a quarter of normal deviates lie within 0.3186 standard deviations.

    In darkness that is cut at 0, and where steps are coarse, a quarter of them are 0 but for rounding; then three quarters within 1.1503
    count.
    """
    quarter, most = np.quantile(rough, [0.25, 0.75])
    return float(np.median(mean)), float(quarter / 0.3186 if quarter > 1e-9 * most else most / 1.1503) ** 2


def estimate_noise(picture: npt.NDArray[np.generic]) -> SensorNoise:
    """Noise of a picture of which nothing else is known, from the differences of neighbouring pixels at each brightness.

    The picture's own structure can only enlarge the result. The offset is the level of the dark gaps where there are some, else 0.

    Raises:
        MeasurementError: fewer than 3 x 3 pixels, or not finite.
    """
    values = np.asarray(picture, dtype=np.float64)
    if values.ndim != 2 or min(values.shape) < 3 or not np.isfinite(values).all():
        raise MeasurementError(f"picture: at least 3 x 3 finite pixels are due, not shape {values.shape}")
    mean = (values[1:, 1:] + values[1:, :-1] + values[:-1, 1:] + values[:-1, :-1]) / 4
    rough = np.abs(values[1:, 1:] - values[1:, :-1] - values[:-1, 1:] + values[:-1, :-1]) / 2
    low, high = (float(value) for value in np.quantile(mean, [0.001, 0.9999]))  # dots may cover less than a thousandth
    gaps = mean <= low + 0.01 * (high - low) + 3 * float(np.median(rough[mean <= low + 0.01 * (high - low)]))
    offset = float(np.median(mean[gaps])) if low < 0.2 * high else 0.0
    level, variance = np.array([[_level_and_variance(mean[inside], rough[inside]) for inside in _bins(mean, gaps, high)]]).reshape(-1, 2).T
    level = level - offset
    weight = 1 / (variance + np.median(variance) / 100 + 1e-12)  # relative: where structure enlarges a variance it counts for little
    design = np.stack([np.ones(len(level)), level], axis=1) * weight[:, None]
    dark, gain = np.linalg.lstsq(design, variance * weight, rcond=None)[0] if len(level) > 1 else (variance.sum(), 0.0)
    top = float(values.max())
    whole = np.asarray(picture).dtype.kind == "u"
    full_scale = top if whole and top in FULL_SCALES else max(2 * top, offset + 1.0)
    return SensorNoise(max(float(gain), 1e-9 * max(top, 1.0)), math.sqrt(max(float(dark) - 1 / 12, 0.0)), offset, full_scale)

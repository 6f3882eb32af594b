"""Gain and read noise of a sensor from pairs of equal frames: how the scatter of pixels grows with
their light.

The difference of two equal frames knows nothing of what the picture shows, so any picture serves, a
white one of micro-images best: it has every brightness at once. E[(a - b)^2 / 2] = dark variance +
gain x light (EMVA 1288, photon transfer); sum and difference of a pair are independent, so the
light may be read from the same pair.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter

from flflab.errors import InputError, MeasurementError
from flflab.measurement.sensor.noise import SensorNoise

Array = npt.NDArray[np.float64]
Pair = tuple[npt.NDArray[np.generic], npt.NDArray[np.generic]]

FEWEST_PIXELS = 1000
NEAR_FULL_SCALE = 0.98  # of full scale: beyond it the noise is cut off
ROUNDS = 4
BLOCK = 5  # pixels a side of a pixel's neighbourhood
LIT = 5.0  # standard deviations of a dark pixel
DRIFTED = 0.2  # relative difference of the light of a pair


@dataclass(frozen=True)
class PhotonTransfer:
    """What pairs of frames say of a sensor.

    Attributes:
        noise: gain, read noise, offset and full scale.
        gain_uncertainty: standard uncertainty of the gain, DN/electron.
        dark_variance: of a dark pixel, rounding included, DN^2.
        dark_uncertainty: its standard uncertainty, DN^2.
        offset_uncertainty: of the offset, DN.
        correlation: of gain and dark variance.
        chi2_per_pixel: mean square of the pairs' scatter over what the line says, in units of its
            own; about 1.
        pixels: number of pixels used.
    """

    noise: SensorNoise
    gain_uncertainty: float
    dark_variance: float
    dark_uncertainty: float
    offset_uncertainty: float
    correlation: float
    chi2_per_pixel: float
    pixels: int


def photon_transfer(pairs: Sequence[Pair], dark: Pair, full_scale_dn: float) -> PhotonTransfer:
    """Measure gain and read noise.

    Args:
        pairs: frames of unchanged scenes with light, two of each, [row, col], DN.
        dark: two frames without light at the same exposure time.
        full_scale_dn: largest number of the sensor; pixels near it are left out.

    Raises:
        InputError: frames of different shapes, not finite, or no pair.
        MeasurementError: too few pixels with light, or the light of a pair changed.
    """
    if not pairs:
        raise InputError(
            "photon transfer: no pair of frames was given; two frames of one scene with light are"
            " needed at least"
        )
    offset, offset_uncertainty = _offset(dark)
    still = (
        np.asarray(dark[0], dtype=np.float64) - np.asarray(dark[1], dtype=np.float64)
    ).ravel() ** 2 / 2
    light, around, scatter = [np.zeros(still.size)], [np.zeros(still.size)], [still]
    for pair in pairs:
        if pair[0].shape != dark[0].shape:
            raise InputError(
                f"photon transfer: a frame of shape {pair[0].shape} beside dark ones of"
                f" {dark[0].shape}; all must be alike"
            )
        seen, near, half = _scatter(pair, offset, full_scale_dn, math.sqrt(still.mean()))
        light.append(seen)
        around.append(near)
        scatter.append(half)
    x, smooth, y = np.concatenate(light), np.concatenate(around), np.concatenate(scatter)
    dark_variance, gain = (
        float(scatter[0].mean()),
        float(max((y.mean() - scatter[0].mean()) / x.mean(), 1e-12)),
    )
    inverse, weight = np.zeros((2, 2)), np.ones_like(x)
    for _ in range(ROUNDS):
        weight = 1 / (
            2 * np.maximum(dark_variance + gain * smooth, 1e-12) ** 2
        )  # a squared normal deviate scatters by root two of its mean
        # the neighbours' light stands in for the pixel's own, whose noise would flatten the line
        by_light = weight * smooth
        inverse = np.linalg.inv(
            np.array([[weight.sum(), (weight * x).sum()], [by_light.sum(), (by_light * x).sum()]])
        )
        dark_variance, gain = (
            float(value) for value in inverse @ np.array([(weight * y).sum(), (by_light * y).sum()])
        )
    if not (gain > 0 and dark_variance > 0):
        raise MeasurementError(
            "photon transfer: the scatter does not grow with the light; were the frames averaged,"
            " or cut off?"
        )
    rest = (y - dark_variance - gain * x) ** 2
    both = (weight**2 * rest * smooth).sum()
    spread = np.array(
        [[(weight**2 * rest).sum(), both], [both, (weight**2 * rest * smooth**2).sum()]]
    )
    covariance = inverse @ spread @ inverse.T
    expected = 2 * np.maximum(dark_variance + gain * x, dark_variance) ** 2
    return PhotonTransfer(
        noise=SensorNoise(gain, math.sqrt(max(dark_variance - 1 / 12, 0.0)), offset, full_scale_dn),
        gain_uncertainty=math.sqrt(covariance[1, 1]),
        dark_variance=dark_variance,
        dark_uncertainty=math.sqrt(covariance[0, 0]),
        offset_uncertainty=offset_uncertainty,
        correlation=float(covariance[0, 1] / math.sqrt(covariance[0, 0] * covariance[1, 1])),
        chi2_per_pixel=float((rest / expected).mean()),
        pixels=len(x),
    )


def _offset(dark: Pair) -> tuple[float, float]:
    """Mean of the dark frames and its standard uncertainty, DN."""
    frames = [np.asarray(frame, dtype=np.float64) for frame in dark]
    if frames[0].shape != frames[1].shape or frames[0].size < FEWEST_PIXELS:
        raise InputError(
            f"photon transfer: dark frames of shapes {frames[0].shape} and {frames[1].shape}; two"
            " alike of 1000 pixels are due"
        )
    if not all(np.isfinite(frame).all() for frame in frames):
        raise InputError("photon transfer: every pixel of the dark frames must be a finite number")
    mean = (frames[0] + frames[1]) / 2
    return float(mean.mean()), float(mean.std()) / math.sqrt(mean.size)


def _scatter(
    pair: Pair, offset: float, full_scale_dn: float, dark_deviation: float
) -> tuple[Array, Array, Array]:
    """Light of every unsaturated pixel above the offset, that of its neighbours, and half the
    squared difference at equal light.

    The neighbours' light decides on weights: a pixel's own would weigh its noise with its noise.
    """
    first, second = (np.asarray(frame, dtype=np.float64) - offset for frame in pair)
    if first.shape != second.shape or not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise InputError(
            "photon transfer: the two frames of a pair must be alike in shape, every pixel a finite"
            " number"
        )
    kept = np.maximum(first, second) < NEAR_FULL_SCALE * full_scale_dn - offset
    light = (first + second) / 2
    around = np.maximum(
        (BLOCK**2 * uniform_filter(light, BLOCK, mode="mirror") - light) / (BLOCK**2 - 1), 0.0
    )
    first, second, light, around = (part[kept] for part in (first, second, light, around))
    lit = int(np.count_nonzero(light > LIT * dark_deviation))
    if lit < FEWEST_PIXELS:
        raise MeasurementError(
            f"photon transfer: {lit} pixels with light below saturation; at least {FEWEST_PIXELS}"
            " are needed"
        )
    ratio = float(second.sum() / first.sum())
    if abs(ratio - 1) > DRIFTED:
        raise MeasurementError(
            f"photon transfer: the light of a pair changed by {100 * (ratio - 1):.0f} %; keep the"
            " lamp steady"
        )
    return light, around, (first * math.sqrt(ratio) - second / math.sqrt(ratio)) ** 2 / 2
